"""The layout of voxels on a device and the bytes that they take: arithmetic on a volume, without a device."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from clvol.volume.grid import Grid


class Voxels(Protocol):
    """What the layout depends on."""

    @property
    def grid(self) -> Grid: ...

    @property
    def dtype(self) -> np.dtype: ...


CELL_SHIFT = 3  # cells of 8^3 for empty space
FINE_SHIFT = 2  # of 4^3, where plain rays leap over it
MOST_OCTANT_CELLS = 2**20  # of a map with one more per octant, of which a view needs few
MOST_FINE_CELLS = 2**21  # of a map that stays in a processor's second-level cache
# 8-bit volumes are stored as pairs, with twice the memory, up to this many bytes of pairs.
_LARGEST_PAIRS = 512 * 2**20
LARGEST_OFFSET = 2**31 - 1  # offsets are signed 32-bit integers, as hardware gather instructions need them


def padded_size(volume: Voxels) -> tuple[int, int, int]:
    """Lattice points (x, y, z) on the device: along an axis with one voxel, the voxel is stored twice."""
    nx, ny, nz = volume.grid.size
    return max(nx, 2), max(ny, 2), max(nz, 2)


def holds_pairs(volume: Voxels) -> bool:
    """Whether each 8-bit voxel is stored together with its neighbour in +y."""
    nx, ny, nz = padded_size(volume)
    return volume.dtype.itemsize == 1 and 2 * nx * (ny - 1) * nz <= _LARGEST_PAIRS


def device_bytes(volume: Voxels) -> int:
    """Bytes that ``DeviceVolume`` takes on the device for voxels and min-max grid."""
    size = nx, ny, nz = padded_size(volume)
    voxels = nx * ny * nz * volume.dtype.itemsize
    if holds_pairs(volume):
        voxels = 2 * nx * (ny - 1) * nz
    cells = np.prod([cell_count(n) for n in size], dtype=np.int64)
    return int(voxels + cells * (2 * volume.dtype.itemsize + 2))


def cell_count(size: int, shift: int = CELL_SHIFT) -> int:
    """Cells of 2^``shift`` lattice cells along an axis of ``size`` lattice points."""
    return max(1, -(-(size - 1) // (1 << shift)))
