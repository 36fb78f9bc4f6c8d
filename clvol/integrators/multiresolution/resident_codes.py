"""Blocks on a device as codes, with a pool of decoded ones: each at a level, cut after some stage."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clvol.device.code_decoder import HeldCodes
from clvol.device.memory import ValueMap, value_map, voxel_switches
from clvol.errors import SceneError
from clvol.features.vocabulary import CODE_DROPPED
from clvol.integrators.multiresolution.block_decoder import BlockDecoder
from clvol.integrators.multiresolution.coded_source import CodedSource, codes_at
from clvol.integrators.multiresolution.device_blocks import CODE_ONE, corner_codes
from clvol.integrators.multiresolution.sample_allocator import SPARE_BYTES, Packing, map_cells, map_shift
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.opencl.structs import CODED_BLOCK
from clvol.store.codecs.coded_blocks import CodedBlocks
from clvol.store.source import DROPPED
from clvol.volume.voxel_layout import LARGEST_OFFSET

_BOX = 4  # blocks per axis of the parts in which all are looked at


@dataclass(frozen=True, eq=False)
class Wanted:
    """What is to be held: of n blocks ``level`` (uint8, DROPPED for none) and ``depth`` (stages) each, and the ``size``
    of its codes in bytes, int64."""

    level: np.ndarray
    depth: np.ndarray
    size: np.ndarray


class ResidentCodes:
    """As ``DeviceBlocks``, for a source of codes. ``hold`` decodes blocks into a pool of samples; those that were not
    used for the longest time go first. In ``index``, blocks that are not decoded have their level, but no place.

    ``samples``: the pool, an array in a list. ``decoded_samples``: how many ``hold`` has decoded.
    """

    pending = 0  # codes are read at once

    def __init__(self, context: DeviceContext, source: CodedSource, memory_bytes: int) -> None:
        self._context, self._source = context, source
        self.blocks = source.blocks
        self.memory_bytes = memory_bytes
        self.value_map: ValueMap = value_map(source)
        self._decoder = BlockDecoder(context, source)
        self.dtype = self._decoder.dtype
        count, counts = self.blocks.count, self.blocks.counts
        self.index: DeviceArray = context.empty(np.int32, (count, 2))
        self.corners: DeviceArray = context.empty(np.uint32, tuple(n + 1 for n in counts))
        self._levels = np.full(count, DROPPED, np.uint8)
        self._depths = np.zeros(count, np.int64)
        self._words = np.zeros((count, 2), np.int32)
        self._place = np.zeros(count, np.int64)  # of a block among the codes of its level
        self._held: dict[int, HeldCodes] = {}
        self._used = np.zeros(count, np.int64)  # when it was used last
        self._clock = 0
        self.decoded_samples = self._reported = 0
        self._make_pool(0)

    # What kernels and casters ask for

    @property
    def levels(self) -> np.ndarray:
        """uint8 [blocks]; DROPPED for blocks that are not there."""
        return self._levels.copy()

    goal = levels

    @property
    def depths(self) -> np.ndarray:
        """int64 [blocks]: the stages that each is cut after."""
        return self._depths.copy()

    @property
    def switches(self) -> dict[str, int]:
        """The switches (-D) of kernels that read ``samples``."""
        return voxel_switches(self._source, self.value_map, pairs=False) | {"SAMPLE_BUFFERS": 1}

    @property
    def code_bytes(self) -> int:
        """Bytes of the blocks' codes and of codebooks."""
        return sum(held.nbytes for held in self._held.values()) + self._decoder.nbytes

    @property
    def device_bytes(self) -> int:
        """Bytes of all allocations."""
        return self.code_bytes + self.samples[0].nbytes + self.index.nbytes + self.corners.nbytes

    @property
    def used_bytes(self) -> int:
        """Bytes of the samples that are decoded now."""
        return self._packing.used * self.dtype.itemsize

    @property
    def pool_bytes(self) -> int:
        """Bytes of samples that can be decoded at a time."""
        return self._packing.capacity * self.dtype.itemsize

    @property
    def overhead_bytes(self) -> int:
        """Bytes for everything but codes and samples: index, corners, codebooks, the map of empty space with two copies
        while it is made, and the records of a launch that decodes."""
        return self.overhead_within(self.memory_bytes)

    def overhead_within(self, memory_bytes: int) -> int:
        """The same with ``memory_bytes`` in all: the map is the finer the more there is."""
        cells = map_cells(self.blocks, map_shift(self.blocks, memory_bytes))
        launch = CODED_BLOCK.itemsize * min(self.blocks.count, 4096)
        spare = SPARE_BYTES * (self.blocks.levels + 1)
        return self.index.nbytes + self.corners.nbytes + self._decoder.nbytes + 3 * cells + launch + spare

    def sample_bytes(self, levels: np.ndarray) -> np.ndarray:
        """int64 [n]: bytes that blocks of ``levels`` take decoded; single samples are in the index."""
        axis = np.where(levels == DROPPED, 0, self.blocks.edge >> np.minimum(levels, 31).astype(np.int64))
        return np.where(axis > 1, axis**3, 0) * self.dtype.itemsize

    def take_decoded(self) -> int:
        """Samples that were decoded since the last call."""
        before, self._reported = self._reported, self.decoded_samples
        return self.decoded_samples - before

    # Codes

    def set_codes(self, wanted: Wanted, means: np.ndarray, pool_bytes: int) -> None:
        """Reads the codes of all blocks that are wanted, and makes room for ``pool_bytes`` of samples. ``means``: a
        value per block, for those of one sample and those that are dropped; NaN where there is none."""
        self._held = {}  # makes room first
        self._make_pool(pool_bytes)
        self._levels, self._depths = wanted.level.astype(np.uint8), wanted.depth.astype(np.int64)
        with np.errstate(over="ignore"):
            ones = self.value_map(np.asarray(means, np.float64)).astype(np.float32)
        last = self.blocks.levels - 1
        codes = np.where(self._levels == DROPPED, CODE_DROPPED, self.blocks.levels - self._levels.astype(np.int64))
        self._words[:, 0] = np.where((codes == CODE_ONE) | (codes == CODE_DROPPED), ones.view(np.int32), 0)
        self._words[:, 1] = codes
        for level in range(last):
            blocks = np.flatnonzero(self._levels == level)
            if not len(blocks):
                continue
            coded = codes_at(self._source, level, blocks)
            cut = CodedBlocks(coded.data, coded.start, np.minimum(coded.size, wanted.size[blocks]))
            self._place[blocks] = np.arange(len(blocks))
            self._held[level] = self._decoder.hold(cut, level, self._depths[blocks])
        self._context.write(self.index, self._words)
        grid = codes.reshape(self.blocks.counts)
        self._context.write(self.corners, corner_codes(grid, 0, self.blocks.counts[0]))

    def _make_pool(self, pool_bytes: int) -> None:
        """An empty pool."""
        limit = min(int(self._context.device.max_mem_alloc_size) // self.dtype.itemsize, LARGEST_OFFSET)
        capacity = min(pool_bytes // self.dtype.itemsize, limit - SPARE_BYTES)
        self.samples: list[DeviceArray] = []
        self._packing = Packing(self.blocks.count, self.blocks.edge, capacity)
        spare = -(-SPARE_BYTES // self.dtype.itemsize)
        self.samples = [self._context.empty(self.dtype, (self._packing.capacity + spare,))]

    # The pool

    def hold(self, blocks: np.ndarray, what: str = "") -> None:
        """Decodes those of ``blocks`` (distinct numbers) that are not decoded yet. SceneError where the pool is too
        small for all of them; ``what`` names what needs them."""
        sizes = self.sample_bytes(self._levels[blocks]) // self.dtype.itemsize
        blocks, sizes = blocks[sizes > 0], sizes[sizes > 0]
        total = int(sizes.sum())
        if total > self._packing.capacity:
            more = (total - self._packing.capacity) * self.dtype.itemsize
            raise SceneError(
                "multiresolution.memory", f"{self.pool_bytes} bytes of decoded blocks, where {what} needs {more} more",
                f"at least {self.memory_bytes + more} bytes, or a smaller picture",
            )  # fmt: skip
        self._clock += 1
        self._used[blocks] = self._clock
        new = self._packing.start[blocks] < 0
        if not new.any():
            return
        gone = self._evicted(int(sizes[new].sum()))
        moves = self._packing.place(blocks[new], sizes[new])
        for move in moves:
            self._context.copy(self.samples[0], move.old, self.samples[0], move.new, move.size)
        moved = np.array([move.block for move in moves], np.int64)
        self._words[gone, 0] = 0
        changed = np.concatenate([blocks[new], moved])
        self._words[changed, 0] = self._packing.start[changed]
        self._decode(blocks[new])
        every = np.concatenate([gone, changed])
        first, last = int(every.min()), int(every.max()) + 1
        self._context.write(self.index, self._words[first:last], 2 * first)

    def _evicted(self, samples: int) -> np.ndarray:
        """Makes room for ``samples``; returns the blocks that went, the least recently used first."""
        packing = self._packing
        missing = samples - (packing.capacity - packing.used)
        if missing <= 0:
            return np.empty(0, np.int64)
        there = np.flatnonzero((packing.start >= 0) & (self._used < self._clock))
        there = there[np.argsort(self._used[there], kind="stable")]
        count = int(np.searchsorted(np.cumsum(packing.size[there]), missing)) + 1
        gone = there[:count]
        packing.place(gone, np.zeros(len(gone), np.int64))
        return gone

    def _decode(self, blocks: np.ndarray) -> None:
        for level, held in self._held.items():
            own = blocks[self._levels[blocks] == level]
            if not len(own):
                continue
            start = self._packing.start[own]
            self._decoder.decode(held, self._place[own], own, level, self.samples[0], start, self._depths[own])
            self.decoded_samples += len(own) * held.s**3

    def boxes(self) -> Iterator[tuple[tuple[int, int, int], tuple[int, int, int]]]:
        """As ``DeviceBlocks.boxes``: all at once if the pool holds all of them, else boxes of a few blocks."""
        counts = np.array(self.blocks.counts)
        everything = np.flatnonzero(self.sample_bytes(self._levels))
        fits = self.sample_bytes(self._levels[everything]).sum() <= self.pool_bytes
        numbers = np.arange(self.blocks.count).reshape(self.blocks.counts)
        side = counts if fits else np.full(3, self._box_side())
        for corner in np.ndindex(*(-(-counts // side)).tolist()):
            first = np.array(corner) * side
            last = np.minimum(first + side, counts)
            z, y, x = (slice(max(a - 1, 0), b + 1) for a, b in zip(first, last))
            around, own = numbers[z, y, x].ravel(), numbers[tuple(map(slice, first, last))]
            if (self._levels[own] == DROPPED).all():
                around = around[:0]  # shows nothing, whatever is beside it
            self.hold(around, "finding empty space")
            bz, by, bx = (last - first).tolist()
            yield (int(first[2]), int(first[1]), int(first[0])), (bx, by, bz)

    def _box_side(self) -> int:
        """Blocks per axis of boxes that the pool holds with their neighbours, whatever their levels."""
        whole = self.blocks.edge**3
        sides = [side for side in (8, _BOX, 2, 1) if (side + 2) ** 3 * whole <= self._packing.capacity]
        return sides[0] if sides else 1

    def close(self) -> None:
        pass
