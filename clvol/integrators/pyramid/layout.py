"""The layout of the maps of the method "pyramid", and the memory that it needs: arithmetic, without a device."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.volume.voxel_layout import cell_count, padded_size

if TYPE_CHECKING:
    from clvol.scene import Scene
    from clvol.scene.resolve import ResolvedScene
    from clvol.volume import Volume

FREE_SHIFT, FREE_REACH = 2, 250.0  # of the map of empty space: cells of 4^3, and a reach in smallest edges
_MOST_CELLS = 2**28  # up to this number a map is as fine as the voxels; beyond it has cells of 2^3
BRICK = 4  # cells per axis in a cache line of a map (cl/oracle_layout.h)
MAP_SPARE = 4  # bytes, so that a 32-bit gather of the last byte stays inside


def map_shift(size: tuple[int, int, int]) -> int:
    """log2 of the edge of a map's cells, in lattice units, for lattice points ``size``."""
    return 0 if float(np.prod(size, dtype=np.float64)) <= _MOST_CELLS else 1


def map_shape(size: tuple[int, int, int], shift: int) -> tuple[int, int, int]:
    """Cells (z, y, x) of 2^shift lattice cells per axis, for lattice points ``size`` (x, y, z)."""
    x, y, z = size
    return cell_count(z, shift), cell_count(y, shift), cell_count(x, shift)


def padded_row(cells: int) -> int:
    """Length of a row in an array of cells that a map is made from: whole vectors."""
    return -(-cells // 16) * 16


def map_bytes(shape: tuple[int, int, int]) -> int:
    """Bytes of a map of ``shape`` cells."""
    bricks = np.prod([-(-n // BRICK) for n in shape], dtype=np.int64)
    return int(bricks) * BRICK**3 + MAP_SPARE


def pyramid_bytes(volume: Volume, scene: Scene | ResolvedScene) -> int:
    """Bytes on the device in addition to those of the plain ray caster: maps, the arrays that they are made with, and
    tables."""
    size = padded_size(volume)
    shapes = map_shape(size, map_shift(size)), map_shape(size, FREE_SHIFT)
    voxels = int(np.prod(size, dtype=np.int64))  # a byte of bits for each
    ranges = _RANGES if scene.pyramid.oracle == "error" else 0
    return voxels + ranges + sum(map(_bytes_to_make, shapes))


def block_pyramid_bytes(cells: tuple[int, int, int], scene: Scene | ResolvedScene) -> int:
    """Bytes in addition to those of the other steppings through blocks, with a map of empty space of ``cells``."""
    return 2 * _bytes_to_make(cells)


def _bytes_to_make(shape: tuple[int, int, int]) -> int:
    """Bytes of a map, of its bits, and of two squared distances of two bytes per cell, in rows of whole vectors."""
    nz, ny, nx = shape
    return map_bytes(shape) + nz * ny * padded_row(nx) * (1 + 2 * 2)


_RANGES = 9 * 2**20  # tables of the oracle "error"
