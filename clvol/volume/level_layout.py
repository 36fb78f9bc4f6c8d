"""Levels of a volume, each with half the resolution of the one below: which axes are halved, how many lattice points a
level has, and where it lies behind the volume's own voxels. Arithmetic, without a device.

Level k stands for voxels whose edges are as near as possible to 2^k times the volume's shortest edge: an axis with
longer edges is halved later than the others, so that a level's voxels become cubes. An axis of two lattice points or
fewer is not halved. Lattice point j of an axis that was halved s times is the middle of the voxels 2^s j to
2^s (j + 1) - 1; beyond the volume its outermost voxels count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from clvol.volume.voxel_layout import Voxels, holds_pairs, padded_size

MOST_VOLUME_LEVELS = 10  # as in cl/features.h
_LEAST = 2  # lattice points of an axis that is not halved


@dataclass(frozen=True)
class Level:
    """``halvings`` of each axis, and lattice points (``size``), both (x, y, z); ``first``: elements (voxels, or pairs
    of them) in the buffer before its own, and ``elements``: how many it has."""

    halvings: tuple[int, int, int]
    size: tuple[int, int, int]
    first: int
    elements: int


def level_edge(volume: Voxels) -> float:
    """World length of a voxel's edge at level 0: the shortest one, of those axes that can be halved."""
    axes = zip(volume.grid.spacing, padded_size(volume))
    return min((edge for edge, n in axes if n > _LEAST), default=volume.grid.smallest_edge)


def levels_of(volume: Voxels) -> tuple[Level, ...]:
    """The levels of ``volume`` from its own voxels on, until no axis can be halved. One that has the lattice points of
    the one before, since an axis is too short and another not yet fine enough, lies where that lies."""
    size, edge, pairs = padded_size(volume), level_edge(volume), int(holds_pairs(volume))
    delay = [math.log2(spacing / edge) for spacing in volume.grid.spacing]
    most = [max(math.ceil(math.log2(n / _LEAST)), 0) for n in size]
    found: list[Level] = []
    end = 0
    for k in range(MOST_VOLUME_LEVELS):
        halvings = tuple(min(max(math.floor(k - late + 0.5), 0), m) for late, m in zip(delay, most))
        nx, ny, nz = (-(-n // (1 << s)) for n, s in zip(size, halvings))
        x, y, z = halvings
        if found and found[-1].halvings == (x, y, z):
            found.append(found[-1])
        else:
            found.append(Level((x, y, z), (nx, ny, nz), end, nx * (ny - pairs) * nz))
            end += found[-1].elements
        if all(s == m for s, m in zip(halvings, most)):
            break
    return tuple(found)


def coarser_bytes(volume: Voxels) -> int:
    """Bytes that the levels take behind the volume's own voxels."""
    levels = levels_of(volume)
    element = volume.dtype.itemsize * (2 if holds_pairs(volume) else 1)
    return (levels[-1].first + levels[-1].elements - levels[0].elements) * element
