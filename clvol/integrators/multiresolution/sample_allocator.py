"""Allocation of blocks' samples on a device, and the memory that they take: arithmetic, without a device.

All sample buffers together form one line of positions. Every buffer but the last holds
a whole number of blocks at full resolution, and a block of s^3 samples lies at a multiple of s^3,
so no block straddles two buffers, and the line can be divided as if there were one buffer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.errors import DeviceError, SceneError, VolumeError
from clvol.opencl.structs import BLOCK_PAYLOAD
from clvol.store.geometry import BlockGrid
from clvol.volume.voxel_layout import LARGEST_OFFSET

MOST_BLOCKS = 1024  # along an axis: kernels pack three numbers in 32 bits (cl/blend_blocks.h)
MOST_BUFFERS = 4  # the index has two bits for a buffer's number
SPARE_BYTES = 64  # after the last sample of a buffer, so that wide loads of it stay inside
SMALLEST = 8  # samples of the smallest slot, 2^3; single samples are stored in the index itself

_LARGEST_STAGING = 2**20
# The map of empty space takes at most 1/48 of the bytes that are left for samples: it is held once, and computing it
# needs two temporary copies.
_MAP_SHARE = 48


@dataclass(frozen=True)
class Move:
    """``size`` samples of ``block`` move from position ``old`` to position ``new``."""

    block: int
    old: int
    new: int
    size: int


class Packing:
    """The positions of the samples of ``count`` blocks in a line of ``capacity`` samples.

    start   int64 [count]: position of a block's first sample, a multiple of its size; -1 for none
    size    int32 [count]: samples of each block: edge^3, (edge / 2)^3, ..., 2^3, or 0

    This is an octal buddy allocator: free slots of edge^3 are split into eight, and eight free ones merge.
    In an empty line ``place`` puts the largest blocks first, without gaps, except that small
    blocks first fill the rest of ``capacity`` beyond whole multiples of edge^3.
    """

    def __init__(self, count: int, edge: int, capacity: int) -> None:
        self.capacity = int(capacity) // SMALLEST * SMALLEST
        self.start = np.full(count, -1, np.int64)
        self.size = np.zeros(count, np.int32)
        self._sizes = [8**k for k in range(edge.bit_length() - 1, 0, -1)]  # descending
        self._free: dict[int, np.ndarray] = {}
        at = 0
        for size in self._sizes:
            slots = (self.capacity - at) // size
            self._free[size] = at + size * np.arange(slots, dtype=np.int64)
            at += size * slots
        self._used = 0

    @property
    def used(self) -> int:
        """Number of samples of all blocks."""
        return self._used

    def place(self, blocks: np.ndarray, sizes: np.ndarray) -> list[Move]:
        """Gives each of ``blocks`` (distinct) a slot of its size, or none, in place of its old one.

        This is always possible if the sizes add up to at most ``capacity``; otherwise ValueError is raised,
        and nothing has changed. Where free samples are too scattered, smaller blocks
        are moved out of the way. Returns these moves, to be copied in this order, before anything is written to
        new slots.
        """
        blocks, sizes = np.asarray(blocks, np.int64), np.asarray(sizes, np.int64)
        old = self.size[blocks]
        used = self._used + int(sizes.sum()) - int(old.sum(dtype=np.int64))
        if used > self.capacity:
            raise ValueError(f"{used} samples where there is room for {self.capacity}")
        self._used = used
        for size in self._sizes:
            if (those := old == size).any():
                self._release(size, self.start[blocks[those]])
        self.start[blocks], self.size[blocks] = -1, 0
        moves: list[Move] = []
        for size in self._sizes:
            if (those := sizes == size).any():
                moves += self._put(blocks[those], size)
        return moves

    def _put(self, blocks: np.ndarray, size: int) -> list[Move]:
        starts = self._take(size, len(blocks))
        self.start[blocks[: len(starts)]] = starts
        self.size[blocks] = size
        moves: list[Move] = []
        for block in blocks[len(starts) :]:
            moves += self._put_by_force(int(block), size)
        return moves

    def _put_by_force(self, block: int, size: int) -> list[Move]:
        """Puts ``block`` into the slot that has the fewest samples of smaller blocks. Such a slot exists: blocks of
        ``size`` or more, including this one, never take more than floor(capacity / size) slots of
        it."""
        whole = self.capacity // size * size
        is_smaller = (self.size > 0) & (self.size < size) & (self.start >= 0) & (self.start < whole)
        smaller = np.flatnonzero(is_smaller)
        slots = self.start[smaller] // size
        taken = np.bincount(slots, weights=self.size[smaller])
        slot = int(np.where(taken > 0, taken, np.inf).argmin())
        evicted = smaller[slots == slot]
        old, sizes = self.start[evicted], self.size[evicted]
        for free in self._sizes:
            if free < size:
                places = self._free[free]
                self._free[free] = places[places // size != slot]
        self.start[evicted] = -1
        self.start[block] = slot * size
        moves: list[Move] = []
        for part in self._sizes:
            those = sizes == part
            moves += self._put(evicted[those], part)
            to = self.start[evicted[those]]
            moves += [
                Move(int(other), int(before), int(after), part)
                for other, before, after in zip(evicted[those], old[those], to)
            ]
        return moves

    def _take(self, size: int, count: int) -> np.ndarray:
        """Takes at most ``count`` free slots, and splits larger ones as needed."""
        found = self._free[size]
        if len(found) < count and size < self._sizes[0]:
            larger = self._take(8 * size, -(-(count - len(found)) // 8))
            parts = larger[:, None] + size * np.arange(8)
            found = np.concatenate([found, parts.ravel()])
        self._free[size] = found[count:]
        return found[:count]

    def _release(self, size: int, starts: np.ndarray) -> None:
        found = np.sort(np.concatenate([self._free[size], starts]))
        self._free[size] = found
        if size == self._sizes[0] or len(found) < 8:
            return
        parents = found // (8 * size)
        first = np.flatnonzero(parents[7:] == parents[:-7])  # no slot twice: all eight of it
        if len(first):
            merged = np.zeros(len(found), bool)
            merged[(first[:, None] + np.arange(8)).ravel()] = True
            self._free[size] = found[~merged]
            self._release(8 * size, found[first])


def staging_bytes(blocks: BlockGrid) -> tuple[int, int]:
    """Bytes for samples on their way to the device, at least one block of the widest type, and for
    the records of where they go."""
    samples = np.clip(blocks.count * blocks.edge**3 // 16, 8 * blocks.edge**3, _LARGEST_STAGING)
    return int(samples), BLOCK_PAYLOAD.itemsize * max(int(samples) // 64, 16)


def overhead_bytes(blocks: BlockGrid, memory_bytes: int) -> int:
    """Bytes on the device for everything except samples: index, corners, staging, map of empty space."""
    return _fixed_bytes(blocks) + 3 * map_cells(blocks, map_shift(blocks, memory_bytes))


def _fixed_bytes(blocks: BlockGrid) -> int:
    """The same without the map of empty space."""
    corners = np.prod([n + 1 for n in blocks.counts], dtype=np.int64)
    return int(8 * blocks.count + 4 * corners) + sum(staging_bytes(blocks))


def most_bytes(blocks: BlockGrid, dtype: np.dtype, memory_bytes: int) -> int:
    """Bytes used on the device within a budget of ``memory_bytes``: all of it, or the bytes of all blocks at full
    resolution if these are fewer."""
    samples = blocks.count * blocks.edge**3 * sample_dtype(dtype).itemsize
    needed = overhead_bytes(blocks, memory_bytes) + samples + MOST_BUFFERS * SPARE_BYTES
    return min(memory_bytes, needed)


def map_shift(blocks: BlockGrid, memory_bytes: int) -> int:
    """log2 of the edge, in voxels, of the cells in which empty space is known: 4 where the budget allows, up to
    a block's edge. A finer map always leaves room for the rest, so whatever fits into one budget
    fits into every larger one."""
    log_edge = blocks.levels - 1
    left = memory_bytes - _fixed_bytes(blocks) - SPARE_BYTES
    for shift in range(min(2, log_edge), log_edge):
        if map_cells(blocks, shift) * _MAP_SHARE <= left:
            return shift
    return log_edge


def map_cells(blocks: BlockGrid, shift: int) -> int:
    return blocks.count * (blocks.edge >> shift) ** 3


def sample_dtype(dtype: np.dtype) -> np.dtype:
    """The type in which samples of a volume of ``dtype`` are held: its own, except float32 for float64."""
    return np.dtype(np.float32) if dtype == np.float64 else np.dtype(dtype)


def buffer_samples(
    blocks: BlockGrid, dtype: np.dtype, memory_bytes: int, largest_buffer: int
) -> list[int]:
    """The number of samples in each of one to four buffers, within ``memory_bytes``: all memory that
    ``overhead_bytes`` leaves, or as much as the whole volume needs at full resolution.

    ``largest_buffer``: bytes. SceneError where the memory does not even suffice for the overhead, DeviceError
    where a buffer cannot hold one block, VolumeError for more than MOST_BLOCKS along an axis.
    """
    if max(blocks.counts) > MOST_BLOCKS:
        raise VolumeError(
            "volume",
            f"{max(blocks.counts)} blocks of {blocks.edge} voxels along an axis",
            f"at most {MOST_BLOCKS}: a store of larger blocks (clvol store --edge)",
        )
    itemsize, whole = sample_dtype(dtype).itemsize, blocks.edge**3
    limit = min((largest_buffer - SPARE_BYTES) // itemsize, LARGEST_OFFSET)
    each = limit // whole * whole
    if each <= 0:
        raise DeviceError(
            "largest buffer", f"{largest_buffer} bytes", f"a block of {whole * itemsize} or more"
        )
    left = memory_bytes - overhead_bytes(blocks, memory_bytes) - SPARE_BYTES
    if left < 0:
        needed = memory_bytes - left
        raise SceneError(
            "multiresolution.memory",
            f"{memory_bytes} bytes for {blocks.count} blocks",
            f"at least {needed} bytes: index and staging alone take that",
        )
    total = min(left // itemsize, whole * blocks.count)
    # Each further buffer has its own spare bytes.
    count = int(np.clip(-(-total // each), 1, MOST_BUFFERS))
    total = min(total, (left - SPARE_BYTES * (count - 1)) // itemsize, count * each)
    total = max(total, 0) // SMALLEST * SMALLEST
    return [max(min(each, total - k * each), 0) for k in range(count)]
