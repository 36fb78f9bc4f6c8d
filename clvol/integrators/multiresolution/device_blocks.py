"""Blocks of a volume on a device, each at its own level, and the index by which rays find them."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from typing import Any, cast

import numpy as np

from clvol.device.memory import ValueMap, value_map, voxel_switches
from clvol.errors import RenderError
from clvol.features.vocabulary import BLOCK_CODECS, CODE_DROPPED
from clvol.integrators.multiresolution.block_decoder import BlockDecoder
from clvol.integrators.multiresolution.coded_source import CodedSource, is_coded
from clvol.integrators.multiresolution.loader import CodedPiece, Loader, Piece, requests
from clvol.integrators.multiresolution.sample_allocator import (
    SPARE_BYTES,
    Packing,
    buffer_samples,
    overhead_bytes,
    sample_dtype,
    staging_bytes,
)
from clvol.opencl.arguments import RAW, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.opencl.structs import BLOCK_PAYLOAD
from clvol.store.source import DROPPED, BlockSource

CODE_ONE = 1  # a block of one sample, which is stored in the index

_GROUP = 64  # work-items per group: always the same number, since PoCL compiles anew for each other one
_FEW = 64  # if at most one block in 64 changes, only the words of those blocks are written to the index
_WINDOW_BYTES = 16 * 2**20  # blocks are read in the order of their errors, but by level within windows of this size


class DeviceBlocks:
    """Samples, index and corners on one device; blocks are dropped until they are loaded.

    samples   one to four arrays of samples, in the volume's type (float32 for float64, with
              ``value_map`` applied); those of a block are contiguous [s, s, s] (z, y, x), at a
              multiple of s^3
    index     int32 [blocks, 2]. Word 1: bits 0 to 3 a code c, bits 4 and 5 the number of the
              sample buffer, others 0. c = 1 + log2(samples per axis), or 15 for a dropped block.
              Word 0: for c >= 2 the offset of the first sample in its buffer, else the bits of a
              float32: the block's one value, ``value_map`` applied
    corners   uint32 [bz + 1, by + 1, bx + 1]: the codes of the eight blocks around each corner, 4
              bits each; nibble dx + 2 dy + 4 dz is block (z - 1 + dz, y - 1 + dy, x - 1 + dx), or
              the nearest one that exists

    Blocks that change are read by a thread (``start``) and put in place by ``commit``. Both are
    called by the thread that renders, between frames: after them samples, index and corners agree.
    Blocks that shrink come first, so that there is always room for the next one.

    ``memory_bytes``: budget for all of it and the map of empty space; SceneError where it does not even suffice for
    everything except samples. ``largest_buffer``: bytes, if less than the device allows.
    """

    def __init__(
        self,
        context: DeviceContext,
        source: BlockSource,
        memory_bytes: int,
        *,
        largest_buffer: int | None = None,
    ) -> None:
        self._context, self._source = context, source
        self.blocks = source.blocks
        self.memory_bytes = memory_bytes
        self.value_map: ValueMap = value_map(source)
        largest = int(context.device.max_mem_alloc_size)
        largest = min(largest, largest_buffer or largest)
        held = sample_dtype(source.dtype)
        sizes = buffer_samples(self.blocks, source.dtype, memory_bytes, largest)
        spare = -(-SPARE_BYTES // held.itemsize)
        self.samples: list[DeviceArray] = [context.resident(held, (n + spare,)) for n in sizes]
        self._each = max(sizes[0], 1)
        count, counts = self.blocks.count, self.blocks.counts
        self.index: DeviceArray = context.empty(np.int32, (count, 2))
        self.corners: DeviceArray = context.empty(np.uint32, tuple(n + 1 for n in counts))
        self._packing = Packing(count, self.blocks.edge, sum(sizes))
        self._levels = np.full(count, DROPPED, np.uint8)
        self._words = np.zeros((count, 2), np.int32)
        self._words[:, 1] = CODE_DROPPED
        self._prepare_decoder()
        self._write_index(0, counts[0])
        self._means = np.zeros(count, np.float32)
        self._goal = self._levels.copy()
        self._instant = np.zeros(0, np.int64)  # blocks that change without being read
        self._missing = 0  # blocks to be read
        self._changed = False
        converts = held != source.dtype and not context.has_double
        self._loader = Loader(source, self._to_float if converts else None)
        self._close = weakref.finalize(self, self._loader.close)

    # Current state

    @property
    def levels(self) -> np.ndarray:
        """uint8 [blocks]: levels on the device now; DROPPED for blocks that are not on it."""
        return self._levels.copy()

    @property
    def goal(self) -> np.ndarray:
        """uint8 [blocks]: the levels that were requested last."""
        return self._goal.copy()

    @property
    def switches(self) -> dict[str, int]:
        """The switches (-D) of kernels that read ``samples``."""
        switches = voxel_switches(self._source, self.value_map, pairs=False)
        if switches["VOXEL_BITS"] == 64:
            switches |= {"VOXEL_BITS": 32, "VOXEL_SCALED": 0}
        return switches | {"SAMPLE_BUFFERS": len(self.samples)}

    @property
    def device_bytes(self) -> int:
        """Bytes of all allocations."""
        arrays = [*self.samples, self.index, self.corners, self._staging, self._payloads]
        return sum(array.nbytes for array in arrays)

    @property
    def sample_bytes(self) -> int:
        """Bytes that blocks of two and more samples per axis can take together."""
        return self._packing.capacity * self.samples[0].dtype.itemsize

    @property
    def used_bytes(self) -> int:
        """Bytes that they take now."""
        return self._packing.used * self.samples[0].dtype.itemsize

    overhead_bytes = staticmethod(overhead_bytes)

    @property
    def pending(self) -> int:
        """Number of blocks that are not yet at the requested level."""
        return self._missing + len(self._instant)

    def boxes(self) -> Iterator[tuple[tuple[int, int, int], tuple[int, int, int]]]:
        """(first, count) in blocks (x, y, z): parts of the volume that are resident while each is looked at, together
        with the blocks beside it. Here: all at once."""
        bz, by, bx = self.blocks.counts
        yield (0, 0, 0), (bx, by, bz)

    # Requests

    def load(
        self,
        levels: np.ndarray,
        means: np.ndarray,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """``start`` and ``wait`` in one, reading level by level."""
        self._ask(levels, means, None, len(self._levels) * self.blocks.edge**3)
        try:
            self.wait(progress)
        except BaseException:
            self._abandon()
            raise

    def start(
        self, levels: np.ndarray, means: np.ndarray, priority: np.ndarray | None = None
    ) -> None:
        """Requests ``levels`` (uint8 [blocks], or DROPPED), which replaces all earlier requests.

        ``means`` float [blocks]: one value per block, NaN where it has none; it represents blocks of one
        sample, and blocks that are no longer dropped until they are read. ``priority`` float
        [blocks] (their errors, for example): of the blocks that grow, those of highest priority come first; without it
        they come in order. RenderError if the samples take more than ``sample_bytes``.
        """
        window = _WINDOW_BYTES // self._source.dtype.itemsize
        self._ask(levels, means, priority, window)

    def commit(self) -> bool:
        """Puts the blocks in place that have arrived, and returns whether anything changed since the last call.

        Raises the error of reading, if there was one (VolumeError names the block): then no more blocks arrive
        until the next ``start``, and those on the device remain usable.
        """
        error = self._advance()
        if error is not None:
            self._abandon()
            raise error
        changed, self._changed = self._changed, False
        return changed

    def wait(self, progress: Callable[[int, int], None] | None = None) -> bool:
        """Commits until all blocks have arrived; returns as ``commit``. ``progress(done, total)`` counts blocks."""
        total, changed = self.pending, False
        while self.pending:
            changed |= self.commit()
            if progress is not None:
                progress(total - self.pending, total)
            if self._missing:
                self._loader.wait()
        return self.commit() or changed

    def close(self) -> None:
        """Ends the thread; the blocks on the device stay."""
        self._abandon()
        self._close()

    def _abandon(self) -> None:
        self._loader.ask(())
        self._missing, self._instant = 0, self._instant[:0]

    def _ask(
        self, levels: np.ndarray, means: np.ndarray, priority: np.ndarray | None, window: int
    ) -> None:
        goal = self._checked(levels)
        self._advance()  # blocks that have arrived are kept; an error belongs to a request that is replaced
        self._loader.ask(())
        means = np.asarray(means, np.float64)
        with np.errstate(over="ignore"):
            self._means = self.value_map(means).astype(np.float32)
        self._goal = goal
        sizes = self._sample_counts(goal)
        now = self._packing.size
        one = (self._words[:, 1] & 15 == CODE_ONE) | (self._levels == DROPPED)
        stale = one & (self._words[:, 0] != self._means.view(np.int32))
        falls = np.where(sizes > 0, self._levels == DROPPED, (self._levels != goal) | stale)
        self._instant = np.flatnonzero(falls)
        wanted = (sizes > 0) & (self._levels != goal)
        shrink = np.flatnonzero(wanted & (sizes < now))
        grow = np.flatnonzero(wanted & (sizes > now))
        if priority is not None:
            grow = grow[np.argsort(-np.asarray(priority)[grow], kind="stable")]
        self._missing = len(shrink) + len(grow)
        most = self._staging.shape[0], self._payloads.shape[0] // BLOCK_PAYLOAD.itemsize
        pieces = []
        for blocks in (shrink, grow):
            pieces += requests(blocks, goal[blocks], self.blocks.edge, *most, window)
        self._loader.ask(pieces)

    def _checked(self, levels: np.ndarray) -> np.ndarray:
        where, count, least = "levels of blocks", self.blocks.count, self.blocks.levels - 1
        levels = np.asarray(levels)
        if levels.shape != (count,):
            raise RenderError(where, f"shape {levels.shape}", f"{(count,)}")
        unknown = ~np.isin(levels, (*range(least + 1), DROPPED))
        if unknown.any():
            raise RenderError(where, f"{levels[unknown][0]}", f"0 to {least}, or {DROPPED}")
        levels = levels.astype(np.uint8)
        wanted = int(self._sample_counts(levels).sum())
        if wanted > self._packing.capacity:
            size = self.samples[0].dtype.itemsize
            raise RenderError(where, f"{wanted * size} bytes", f"at most {self.sample_bytes}")
        return levels

    def _sample_counts(self, levels: np.ndarray) -> np.ndarray:
        """int64: number of samples in the buffers of blocks at ``levels``."""
        edge = self.blocks.edge
        axis = np.where(levels == DROPPED, 0, edge >> np.minimum(levels, 31).astype(np.int64))
        return np.where(axis > 1, axis**3, 0)

    # Arrivals

    def _advance(self) -> Exception | None:
        """Puts the blocks in place that have arrived; returns the error of reading, if there was one."""
        pieces, error = self._loader.take()
        changed = [self._set_means(self._instant)]
        self._instant = self._instant[:0]
        for piece in pieces:
            changed += self._place(piece)
            if isinstance(piece, CodedPiece):
                self._decode_codes(piece)
            else:
                self._decode(piece)
                self._check_fault()
            self._missing -= len(piece.blocks)
        blocks = np.concatenate(changed)
        if len(blocks):
            self._changed = True
            self._update_index(np.sort(blocks))
        return error

    def _set_means(self, blocks: np.ndarray) -> np.ndarray:
        """Represents each of ``blocks`` by one value."""
        self._packing.place(blocks, np.zeros(len(blocks), np.int64))
        dropped = self._goal[blocks] == DROPPED
        self._levels[blocks] = np.where(dropped, DROPPED, self.blocks.levels - 1)
        self._words[blocks, 0] = self._means[blocks].view(np.int32)
        self._words[blocks, 1] = np.where(dropped, CODE_DROPPED, CODE_ONE)
        return blocks

    def _place(self, piece: Piece | CodedPiece) -> list[np.ndarray]:
        """Allocates slots for the piece's blocks; returns all blocks whose samples have moved."""
        side = self.blocks.samples(piece.level)
        moves = self._packing.place(piece.blocks, np.full(len(piece.blocks), side**3))
        for move in moves:
            (source, old), (target, new) = (divmod(at, self._each) for at in (move.old, move.new))
            self._context.copy(self.samples[source], old, self.samples[target], new, move.size)
        self._levels[piece.blocks] = piece.level
        moved = np.unique(np.array([move.block for move in moves], np.int64))
        for blocks in (piece.blocks, moved):
            buffers, places = np.divmod(self._packing.start[blocks], self._each)
            codes = self.blocks.levels - self._levels[blocks]
            self._words[blocks, 0] = places
            self._words[blocks, 1] = codes | buffers << 4
        return [piece.blocks, moved]

    def _prepare_decoder(self) -> None:
        context, source = self._context, self._source
        held = self.samples[0].dtype
        double = source.dtype == np.float64 and context.has_double
        staged, payloads = staging_bytes(self.blocks)
        self._block_decoder: BlockDecoder | None = None
        if is_coded(source):  # these are staged in buffers of their own, no larger than samples
            self._block_decoder, staged = BlockDecoder(context, cast(CodedSource, source)), staged // 2
        dtype = np.dtype(np.float64) if double else held
        self._staging = context.empty(dtype, (staged // dtype.itemsize,))
        self._payloads = context.empty(np.uint8, (payloads,))
        self._fault = context.upload(np.full(1, -1, np.int32), writable=True)
        values = (value("bias", np.float64), value("gain", np.float64)) if double else ()
        scale = {"bias": self.value_map.bias, "gain": self.value_map.gain}
        self._values: dict[str, Any] = scale if double else {}
        switches = {"VOXEL_BITS": held.itemsize * 8, "VOXEL_SIGNED": int(held.kind == "i")}
        switches["STAGED_DOUBLE"] = int(double)
        self._decoder = context.kernel(
            "decode_blocks.cl",
            "decode_blocks",
            (
                reads("payloads", np.uint8, "count", BLOCK_PAYLOAD.itemsize),
                value("count", np.int32),
                reads("staged", dtype),
                *values,
                writes("samples", held),
                writes("fault", np.int32),
            ),
            switches,
        )
        declared = (
            reads("changes", np.uint8, "count", 8), value("count", np.int32), writes("words", RAW)
        )  # fmt: skip
        self._put = context.kernel("decode_blocks.cl", "put_words", declared, switches)

    def _decode(self, piece: Piece) -> None:
        context = self._context
        context.write(self._staging, piece.staged)
        buffers, places = np.divmod(self._packing.start[piece.blocks], self._each)
        side = self.blocks.samples(piece.level)
        for buffer, array in enumerate(self.samples):
            if not (those := buffers == buffer).any():
                continue
            payloads = np.empty(np.count_nonzero(those), BLOCK_PAYLOAD)
            payloads["from"], payloads["to"] = piece.first[those], places[those]
            payloads["size"], payloads["codec"] = side, piece.codec[those]
            context.write(self._payloads, payloads.view(np.uint8))
            self._decoder(
                context.queue,
                (_padded(len(payloads)), side),
                (_GROUP, 1),
                payloads=self._payloads,
                count=len(payloads),
                staged=self._staging,
                samples=array,
                fault=self._fault,
                **self._values,
            )

    def _check_fault(self) -> None:
        """RenderError if the kernel met a codec that it does not know."""
        codec = int(self._context.read(self._fault)[0])
        if codec >= 0:
            self._context.write(self._fault, np.full(1, -1, np.int32))
            raise RenderError(self._source.name, f"blocks of codec {codec}", f"one of {sorted(BLOCK_CODECS.values())}")

    def _decode_codes(self, piece: CodedPiece) -> None:
        assert self._block_decoder is not None
        held = self._block_decoder.hold(piece.coded, piece.level)
        buffers, places = np.divmod(self._packing.start[piece.blocks], self._each)
        for buffer, array in enumerate(self.samples):
            those = np.flatnonzero(buffers == buffer)
            if len(those):
                self._block_decoder.decode(held, those, piece.blocks[those], piece.level, array, places[those])

    def _to_float(self, samples: np.ndarray) -> np.ndarray:
        """Converts float64 samples for a device without that type."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.value_map(samples).astype(np.float32)

    def _update_index(self, blocks: np.ndarray) -> None:
        """Writes index and corners of ``blocks``, which ascend."""
        if len(blocks) * _FEW > self.blocks.count:
            slab = self.blocks.counts[1] * self.blocks.counts[2]
            self._write_index(int(blocks[0]) // slab, int(blocks[-1]) // slab + 1)
            return
        at = 2 * blocks[:, None] + np.arange(2)
        self._put_words(self.index, at.ravel(), self._words[blocks].ravel())
        corners = corners_of(self.blocks.places(blocks), self.blocks.counts)
        at = np.ravel_multi_index(corners.T, self.corners.shape)
        self._put_words(self.corners, at, corner_codes_at(self._codes(), corners).view(np.int32))

    def _put_words(self, array: DeviceArray, at: np.ndarray, words: np.ndarray) -> None:
        changes = np.stack([at, words], axis=-1).astype(np.int32)
        most = self._payloads.shape[0] // changes[0].nbytes
        for first in range(0, len(changes), most):
            part = changes[first : first + most]
            self._context.write(self._payloads, part.view(np.uint8).ravel())
            self._put(
                self._context.queue,
                (_padded(len(part)),),
                (_GROUP,),
                changes=self._payloads,
                count=len(part),
                words=array,
            )

    def _codes(self) -> np.ndarray:
        """The codes of all blocks, uint8 [bz, by, bx]."""
        codes = np.where(self._levels == DROPPED, CODE_DROPPED, self.blocks.levels - self._levels)
        return codes.reshape(self.blocks.counts)

    def _write_index(self, first: int, last: int) -> None:
        """Writes index and corners of the slabs ``first`` <= bz < ``last``."""
        slab = self.blocks.counts[1] * self.blocks.counts[2]
        self._context.write(self.index, self._words[first * slab : last * slab], 2 * first * slab)
        corners = corner_codes(self._codes(), first, last)
        self._context.write(self.corners, corners, first * corners[0].size)


def _padded(count: int) -> int:
    return -(-count // _GROUP) * _GROUP


def corner_codes(codes: np.ndarray, first: int, last: int) -> np.ndarray:
    """uint32 [last - first + 1, by + 1, bx + 1]: ``corners`` of ``DeviceBlocks`` that touch the
    slabs ``first`` <= bz < ``last``, from codes [bz, by, bx]."""
    nz, ny, nx = codes.shape
    z = np.clip(np.arange(first - 1, last + 1), 0, nz - 1)
    around = np.pad(codes[z], ((0, 0), (1, 1), (1, 1)), mode="edge").astype(np.uint32)
    found = np.zeros((last - first + 1, ny + 1, nx + 1), np.uint32)
    for j in range(8):
        dz, dy, dx = j >> 2, j >> 1 & 1, j & 1
        codes_there = around[dz : dz + len(found), dy : dy + ny + 1, dx : dx + nx + 1]
        found |= codes_there << np.uint32(4 * j)
    return found


def corners_of(places: np.ndarray, counts: tuple[int, int, int]) -> np.ndarray:
    """int64 [k, 3]: the corners (z, y, x) of the blocks ``places`` int64 [n, 3]."""
    near = places[:, None] + np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1)
    shape = tuple(n + 1 for n in counts)
    at = np.sort(np.ravel_multi_index(near.reshape(-1, 3).T, shape))
    at = at[np.diff(at, prepend=-1) > 0]
    return np.stack(np.unravel_index(at, shape), axis=-1)


def corner_codes_at(codes: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """uint32 [k]: the codes around ``corners`` int64 [k, 3], as in ``corner_codes``."""
    found = np.zeros(len(corners), np.uint32)
    for j in range(8):
        around = corners - 1 + np.array([j >> 2, j >> 1 & 1, j & 1])
        around = np.clip(around, 0, np.array(codes.shape) - 1)
        found |= codes[tuple(around.T)].astype(np.uint32) << np.uint32(4 * j)
    return found
