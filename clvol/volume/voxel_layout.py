"""How voxels are laid out on a device, and how many bytes they take there: arithmetic on a volume, without a device."""

from __future__ import annotations

import numpy as np

from clvol.volume.volume import Volume

CELL_SHIFT = 3  # cells of 8^3 for empty space
# 8-bit volumes are held as pairs (twice the memory) up to this many bytes of pairs.
_LARGEST_PAIRS = 512 * 2**20
LARGEST_OFFSET = 2**31 - 1  # offsets are signed 32 bit: what the hardware's gather takes


def padded_size(volume: Volume) -> tuple[int, int, int]:
    """Lattice points (x, y, z) on the device: an axis of one voxel is held twice."""
    return tuple(max(n, 2) for n in volume.grid.size)


def holds_pairs(volume: Volume) -> bool:
    """Whether each voxel of 8 bits is held together with the one above it in y."""
    nx, ny, nz = padded_size(volume)
    return volume.dtype.itemsize == 1 and 2 * nx * (ny - 1) * nz <= _LARGEST_PAIRS


def device_bytes(volume: Volume) -> int:
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
