"""A pool of bricks on a device: those parts of a volume that rays sample now, decoded, behind a table that finds them.

Rays read bricks as they read a volume in one array (cl/fetch_voxel.h, BRICKS), with one more look-up per sample, so
that every march and every effect that reads voxels through cl/fetch_voxel.h works on them, and gives the same bits.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from clvol.device.code_decoder import CodeDecoder
from clvol.device.memory import VoxelFacts, value_map, voxel_switches
from clvol.errors import SceneError
from clvol.opencl.arguments import RAW, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.store.codecs.coded_blocks import Codebooks, CodedBlocks
from clvol.store.geometry import BlockGrid
from clvol.store.source import BlockSource
from clvol.volume.voxel_layout import CELL_SHIFT, LARGEST_OFFSET

_SPARE_BYTES = 64  # after the last brick, so that wide loads of it stay inside
_SCRATCH_BYTES = 8 * 2**20  # blocks on their way into bricks, and the share of the memory that they may take
_SCRATCH_SHARE = 16
_WANTED = 12  # numbers of a brick that is to be filled (cl/fill_bricks.cl)
_AROUND = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1)  # [dz][dy][dx]


class BrickSource(VoxelFacts, Protocol):
    """What fills a pool."""

    name: str
    blocks: BlockGrid

    @property
    def nbytes(self) -> int:
        """Bytes that it takes on the device itself."""
        ...

    def put(self, blocks: np.ndarray, target: DeviceArray) -> None:
        """Enqueues the voxels [k, edge, edge, edge] of ``blocks`` (numbers, int64 [k]) at full resolution into
        ``target``, of the volume's type. What they hold beyond the volume does not matter. VolumeError where a block
        is damaged."""
        ...

    def put_box(self, blocks: np.ndarray, target: DeviceArray, corners: np.ndarray) -> None:
        """Likewise to the corners int64 [k, 3] (z, y, x) of the array ``target`` [nz, ny, nx]; what of a block is
        beyond its upper ends is left out."""
        ...


class BrickPool:
    """At most as many bricks of ``source`` as fit into ``memory_bytes`` together with the table and what filling them
    needs (None: into what the device has).

    ``hold`` makes bricks resident; those that were not used for the longest time go first. Memory is taken as it is
    needed: ``capacity`` is what there is room for now, ``most`` what it may become. ``filled_voxels`` counts what
    ``hold`` has had decoded. SceneError where not even one brick fits.
    """

    def __init__(
        self,
        context: DeviceContext,
        source: BrickSource,
        memory_bytes: int | None = None,
        *,
        pairs: bool | None = None,
    ) -> None:
        self._context, self._source = context, source
        self.blocks = blocks = source.blocks
        self.values = value_map(source)
        dtype = np.dtype(source.dtype)
        pairs = dtype.itemsize == 1 if pairs is None else pairs
        edge, self._log_edge = blocks.edge, blocks.levels - 1
        self._unit = dtype.itemsize * (1 + pairs)  # bytes of an element
        self.stride = edge + 1, (edge + 1) * (edge + 1 - pairs)
        self._brick = self.stride[1] * (edge + 1)  # elements
        self.switches = {**voxel_switches(source, self.values, pairs=pairs), "BRICKS": self._log_edge}
        self._table = -(-4 * blocks.count // 64) * 64
        self._block_bytes = edge**3 * dtype.itemsize
        self._around = min(blocks.count, 27)  # the most blocks that a brick, or some beside each other, need
        largest = min(int(context.device.max_mem_alloc_size), self._unit * LARGEST_OFFSET)
        if memory_bytes is None:
            memory_bytes = min(self.memory_for(blocks.count), int(context.device.global_mem_size) // 2)
        self.memory_bytes = memory_bytes
        if memory_bytes < (least := self.memory_for(1)):
            expected = f"at least {least} bytes for the bricks of {source.name}"
            raise SceneError("compression.memory", f"got {memory_bytes} bytes", expected)
        left = memory_bytes - self._table - _SPARE_BYTES
        scratch = min(max(left // _SCRATCH_SHARE // self._block_bytes, self._around), blocks.count)
        scratch = min(scratch, max(_SCRATCH_BYTES // self._block_bytes, self._around))
        room = min(left - scratch * self._block_bytes, largest - self._table - _SPARE_BYTES)
        self.most = min(int(room // self.brick_bytes), blocks.count)
        self._scratch = context.empty(dtype, (scratch, edge, edge, edge))
        self._slot = np.full(blocks.count, -1, np.int64)  # of each block
        self.voxels: Any = None
        self._clock = 0
        self.filled_voxels = self._reported = 0
        self._prepare()
        self._make_room(min(self.most, max(blocks.count // 8, scratch)))

    def _make_room(self, capacity: int) -> None:
        """An empty pool of ``capacity`` bricks."""
        self.capacity = capacity
        size = self._table + capacity * self.brick_bytes + _SPARE_BYTES
        self.voxels = None  # the old one goes first
        self.voxels = self._context.resident(np.uint8, (size,))
        self._slot[:] = -1
        self._block = np.full(capacity, -1, np.int64)  # in each slot
        self._used = np.zeros(capacity, np.int64)  # when it was held last
        self._write_table(np.arange(self.blocks.count))

    def memory_for(self, bricks: int) -> int:
        """Bytes within which ``bricks`` can be held at a time."""
        own = bricks * self.brick_bytes
        room = max(own + self._around * self._block_bytes, -(-own * _SCRATCH_SHARE // (_SCRATCH_SHARE - 1)))
        return self._table + _SPARE_BYTES + room

    @property
    def device_bytes(self) -> int:
        """Bytes of bricks, table and what filling them needs, and of the source."""
        return self.voxels.nbytes + self._scratch.nbytes + self._source.nbytes

    @property
    def brick_bytes(self) -> int:
        return self._brick * self._unit

    @property
    def dtype(self) -> np.dtype:
        return np.dtype(self._source.dtype)

    def take_filled(self) -> int:
        """``filled_voxels`` since the last call."""
        before, self._reported = self._reported, self.filled_voxels
        return self.filled_voxels - before

    def resident(self, blocks: np.ndarray) -> np.ndarray:
        """bool [k]: which of ``blocks`` are in the pool."""
        return self._slot[blocks] >= 0

    def hold(self, blocks: np.ndarray) -> int:
        """Makes ``blocks`` (distinct numbers, at most ``most``) resident; returns how many were not."""
        self._clock += 1
        slots = self._slot[blocks]
        self._used[slots[slots >= 0]] = self._clock
        new = blocks[slots < 0]
        if len(new):
            if len(blocks) > self.most:
                raise ValueError(f"{len(blocks)} bricks where there is room for {self.most}")
            if len(blocks) > self.capacity:
                self._make_room(min(len(blocks) + len(blocks) // 8, self.most))
                self._clock, new = 1, blocks
            oldest = np.argsort(self._used, kind="stable")[: len(new)]
            gone = self._block[oldest]
            gone = gone[gone >= 0]
            self._slot[gone] = -1
            self._slot[new], self._block[oldest] = oldest, new
            self._used[oldest] = self._clock
            try:
                self._fill(new)
            except BaseException:
                self._slot[new] = -1
                self._block[oldest], self._used[oldest] = -1, 0
                raise
            finally:
                self._write_table(np.concatenate([gone, new]))
        return len(new)

    def release(self) -> None:
        """Gives up all bricks, and their memory until some are held again."""
        self.capacity, self.voxels = 0, self._context.empty(np.uint8, (_SPARE_BYTES,))
        self._slot[:] = -1
        self._block, self._used = np.full(0, -1, np.int64), np.zeros(0, np.int64)

    @property
    def free_bytes(self) -> int:
        """What may be held of ``memory_bytes`` in place of bricks."""
        return self.memory_bytes - self._table - _SPARE_BYTES - self._scratch.nbytes

    def put_box(self, target: DeviceArray, first: tuple[int, int, int]) -> None:
        """Enqueues the voxels of a box of the volume into ``target`` [z, y, x], which begins at ``first`` (z, y, x):
        multiples of a block's edge."""
        edge = self.blocks.edge
        ranges = [np.arange(f // edge, -(-(f + n) // edge)) for f, n in zip(first, target.shape)]
        places = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3)
        numbers = np.ravel_multi_index(tuple(places.T), self.blocks.counts)
        self._source.put_box(numbers, target, places * edge - np.array(first))
        self.filled_voxels += len(numbers) * edge**3

    def bounds(self, shift: int = CELL_SHIFT) -> np.ndarray:
        """[z, y, x, 2], of the volume's type: smallest and largest finite voxel of each cell of 2^``shift`` lattice
        cells; low > high where there is none. ``2^shift`` is at most a block's edge. Fills the pool with every brick
        in turn."""
        edge, counts = self.blocks.edge, self.blocks.counts
        n = edge >> shift
        found = np.empty((*counts, n, n, n, 2), self._source.dtype)
        flat, filled = found.reshape(self.blocks.count, -1), self.filled_voxels
        for first in range(0, self.blocks.count, self.capacity):
            blocks = np.arange(first, min(first + self.capacity, self.blocks.count))
            self.hold(blocks)
            out = self._context.empty(found.dtype, (len(blocks), n, n, n, 2))
            wanted = np.zeros((len(blocks), _WANTED), np.int32)
            wanted[:, 0] = self._start(self._slot[blocks])
            self._bounds(
                self._context.queue, (len(blocks),), None, wanted=self._context.upload(wanted), bricks=len(blocks),
                shift=shift, volume=self.voxels, bounds=out,
            )  # fmt: skip
            flat[blocks] = self._context.read(out).reshape(len(blocks), -1)
        self.filled_voxels = filled
        z, y, x = (count * n for count in counts)
        return found.transpose(0, 3, 1, 4, 2, 5, 6).reshape(z, y, x, 2)

    # Filling

    def _prepare(self) -> None:
        names = ("VOXEL_BITS", "VOXEL_SIGNED", "VOXEL_PAIRS", "BRICKS")
        switches = {name: self.switches[name] for name in names}
        dtype = self._scratch.dtype
        wanted = reads("wanted", np.int32, "bricks", _WANTED), value("bricks", np.int32)
        self._filler = self._context.kernel(
            "fill_bricks.cl", "fill_bricks", (*wanted, reads("blocks", dtype), writes("volume", RAW)), switches
        )
        cells = value("shift", np.int32), reads("volume", RAW), writes("bounds", dtype)
        self._bounds = self._context.kernel("fill_bricks.cl", "brick_bounds", (*wanted, *cells), switches)

    def _start(self, slots: np.ndarray) -> np.ndarray:
        """Element of ``voxels`` where the brick in each of ``slots`` begins."""
        return self._table // self._unit + slots * self._brick

    def _write_table(self, blocks: np.ndarray) -> None:
        """Writes the table's entries from the first to the last of ``blocks``. Those that are not resident are where
        the first slot is: what rays that are done fetch there is not used."""
        first, last = int(blocks.min()), int(blocks.max()) + 1
        z, y, x = (axis * self.blocks.edge for axis in self.blocks.places(np.arange(first, last)).T)
        row, slice_ = self.stride
        at = self._start(np.maximum(self._slot[first:last], 0)) - (z * slice_ + y * row + x)
        self._context.write(self.voxels, (at & 0xFFFFFFFF).astype(np.uint32).view(np.uint8), 4 * first)

    def _fill(self, blocks: np.ndarray) -> None:
        """Fills the slots of ``blocks``."""
        places = self.blocks.places(blocks)
        order = _along_curve(places)
        blocks, near = blocks[order], places[order][:, None] + _AROUND
        inside = np.all(near < self.blocks.counts, axis=-1).reshape(-1, 8)
        numbers = np.ravel_multi_index(np.minimum(near, np.array(self.blocks.counts) - 1).transpose(2, 0, 1),
                                       self.blocks.counts)  # fmt: skip
        first, room = 0, self._scratch.shape[0]
        while first < len(blocks):
            last = _most_within(numbers[first:], room) + first
            needed, own = np.unique(numbers[first:last], return_inverse=True)
            wanted = np.empty((last - first, _WANTED), np.int32)
            wanted[:, 0] = self._start(self._slot[blocks[first:last]])
            wanted[:, 9:] = (np.array(self.blocks.shape) - near[first:last, 0] * self.blocks.edge)[:, ::-1]
            wanted[:, 1:9] = np.where(inside[first:last], own.reshape(last - first, 8), -1)
            self._source.put(needed, self._scratch)
            self.filled_voxels += len(needed) * self.blocks.edge**3
            self._filler(
                self._context.queue, (self.blocks.edge + 1, last - first), None,
                wanted=self._context.upload(wanted), bricks=last - first, blocks=self._scratch, volume=self.voxels,
            )  # fmt: skip
            first = last


def _most_within(numbers: np.ndarray, room: int) -> int:
    """How many of the first rows of ``numbers`` [n, 8] have at most ``room`` distinct ones together; at least one."""
    rows = min(len(numbers), room)
    first_seen = np.sort(np.unique(numbers[:rows], return_index=True)[1])
    return rows if len(first_seen) <= room else max(int(first_seen[room]) // numbers.shape[1], 1)


def _along_curve(places: np.ndarray) -> np.ndarray:
    """The order of ``places`` [n, 3] along Morton's curve (1966): neighbours, which share blocks, follow soon."""
    code = np.zeros(len(places), np.int64)
    for bit in range(16):
        for axis in range(3):
            code |= (places[:, axis].astype(np.int64) >> bit & 1) << 3 * bit + axis
    return np.argsort(code)


class ReadBricks:
    """A ``BrickSource`` of blocks that are read at every need, uncompressed."""

    nbytes = 0

    def __init__(self, context: DeviceContext, source: BlockSource) -> None:
        self._context, self._source = context, source
        self.name, self.blocks, self.dtype = source.name, source.blocks, np.dtype(source.dtype)
        self.value_range, self.nan_count, self.inf_count = source.value_range, source.nan_count, source.inf_count

    def put(self, blocks: np.ndarray, target: DeviceArray) -> None:
        self._context.write(target, self._source.read(0, blocks))

    def put_box(self, blocks: np.ndarray, target: DeviceArray, corners: np.ndarray) -> None:
        box = np.zeros(target.shape, self.dtype)
        for block, (z, y, x) in zip(self._source.read(0, blocks), corners):
            part = box[z : z + len(block), y : y + len(block), x : x + len(block)]
            part[...] = block[tuple(slice(n) for n in part.shape)]
        self._context.write(target, box)


class CodedBricks:
    """A ``BrickSource`` whose blocks are codes that stay on the device. ``volume``: the decoded voxels' facts and name;
    ``coded``: all blocks of ``blocks``, in order, at full resolution."""

    def __init__(
        self,
        context: DeviceContext,
        volume: VoxelFacts,
        blocks: BlockGrid,
        codebooks: Codebooks,
        coded: CodedBlocks,
        name: str = "volume",
    ) -> None:
        self.name, self.blocks, self.dtype = name, blocks, codebooks.values.dtype
        self.value_range, self.nan_count, self.inf_count = volume.value_range, volume.nan_count, volume.inf_count
        self._decoder = CodeDecoder(context, codebooks, name)
        self._held = self._decoder.hold(coded, blocks.edge)

    @property
    def nbytes(self) -> int:
        """Bytes of codes and codebooks on the device."""
        return self._held.nbytes + self._decoder.nbytes

    def put(self, blocks: np.ndarray, target: DeviceArray) -> None:
        places = np.arange(len(blocks)) * self.blocks.edge**3
        self._decoder.into_blocks(self._held, blocks, target, places)

    def put_box(self, blocks: np.ndarray, target: DeviceArray, corners: np.ndarray) -> None:
        self._decoder.into_volume(self._held, blocks, target, corners)
