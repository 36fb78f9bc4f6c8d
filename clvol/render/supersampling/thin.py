"""Pixels that may hide something that no ray through the middle of a pixel meets.

What is visible lies in cells (the map by which rays leap over empty space). A pixel whose ray saw nothing, but which
such a cell covers, may hide a thread between rays. Where cells are of a pixel's size, all such pixels are found; where
they are larger, those on the outline of what cells cover, or large parts of the picture would be refined for nothing.
Where voxels are larger than pixels there are none: what is interpolated between voxels is no thinner than they are. A
thread before something else that is visible is not found.
"""

from __future__ import annotations

import numpy as np

from clvol.device.tile_ranges import sums_over_tiles, view_axes
from clvol.device.view import RayFrame
from clvol.volume import Grid

_SMALL = 2.0  # pixels: the mean width of cells that hide threads anywhere in them
_WIDEST = 1.5  # pixels per voxel of rectangles around cells: about a pixel per edge of a voxel
_PIECE = 1 << 16
_CORNERS = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1).astype(bool)


def hidden(
    cells: np.ndarray, shift: int, grid: Grid, frame: RayFrame, opacity: np.ndarray
) -> np.ndarray:
    """bool [height, width]: pixels that may hide something. ``cells`` bool [z, y, x] of 2^``shift`` lattice units:
    where anything is visible in a volume on ``grid``. ``frame``: rays of the picture, ``opacity`` [height, width]."""
    clear = opacity == 0.0
    if not clear.any() or not cells.any():
        return np.zeros_like(clear)
    found = _covered(cells, shift, grid, frame, clear.shape)
    if found is None:
        return np.zeros_like(clear)
    covered, width = found
    if width > _WIDEST * (1 << shift):
        return np.zeros_like(clear)
    return clear & (covered if width <= _SMALL else _outline(covered))


def _covered(
    cells: np.ndarray, shift: int, grid: Grid, frame: RayFrame, picture: tuple[int, int]
) -> tuple[np.ndarray, float] | None:
    """Which pixels [height, width] rectangles around projected cells cover, and how many pixels wide these are in the
    mean; None where the eye is among cells: then threads are not thinner than pixels."""
    height, width = picture
    to_edges = np.diag(np.asarray(grid.spacing) / grid.smallest_edge)
    forward, right, down, pixel = view_axes(frame, to_edges)
    is_perspective = frame.lens[0] > 0
    places = np.argwhere(_surface(cells))[:, ::-1]
    upper = np.maximum(np.asarray(grid.size) - 1, 1)
    ranges, widths = [], 0.0
    for k in range(0, len(places), _PIECE):
        low = places[k : k + _PIECE] << shift
        high = np.minimum(low + (1 << shift), upper)
        corners = np.where(_CORNERS, high[:, None], low[:, None])
        from_plane = (corners - frame.origin) @ to_edges.T
        scale: np.ndarray | float = 1.0 / pixel
        if is_perspective:
            depth = from_plane @ forward + frame.distance
            if (depth <= 1e-3 * (1.0 + np.abs(depth).max())).any():
                return None
            scale = 1.0 / (depth * pixel)
        row = []
        for axis, (direction, n) in enumerate(((right, width), (down, height))):
            at = (from_plane @ direction) * scale + frame.centre[axis]
            first, last = at.min(axis=1), at.max(axis=1)
            widths += float((last - first).sum()) / 2
            # Pixel i reaches from i - 1/2 to i + 1/2; a little more, since rays are rounded.
            bounds = np.ceil(first - 0.51), np.floor(last + 0.51) + 1
            row.append(tuple(np.clip(each, 0, n).astype(int) for each in bounds))
        ranges.append(row)
    joined = [
        (np.concatenate([part[axis][0] for part in ranges]), np.concatenate([part[axis][1] for part in ranges]))
        for axis in range(2)
    ]
    count = sums_over_tiles(joined, np.ones(len(places), np.int64), width, height)
    return count > 0, widths / len(places)


def _surface(cells: np.ndarray) -> np.ndarray:
    """Cells with a side that no other cell touches: what others cover, these do."""
    inside = np.pad(cells, 1)
    core = inside[1:-1, 1:-1, 1:-1].copy()
    for axis in range(3):
        for first in (0, 2):
            index = [slice(1, -1)] * 3
            index[axis] = slice(first, first + cells.shape[axis])
            core &= inside[tuple(index)]
    return cells & ~core


def _outline(covered: np.ndarray) -> np.ndarray:
    """Pixels of ``covered`` [height, width] beside one that is not."""
    around = np.pad(covered, 1, constant_values=True)
    inner = around[:-2, 1:-1] & around[2:, 1:-1] & around[1:-1, :-2] & around[1:-1, 2:]
    return covered & ~inner
