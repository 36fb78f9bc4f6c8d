"""Pixels that may hide something that no ray through the middle of a pixel meets.

What is visible lies in cells (the map by which rays leap over empty space). A pixel whose ray saw nothing, but which
such a cell covers, may hide a thread between rays. Where cells are of a pixel's size, all such pixels are found; where
they are larger, those on the outline of what cells cover, or large parts of the picture would be refined for nothing.
Where voxels are larger than pixels there are none: what is interpolated between voxels is no thinner than they are. A
thread before something else that is visible is not found.
"""

from __future__ import annotations

import numpy as np

from clvol.device.tile_ranges import Ranges, sums_over_tiles, view_axes
from clvol.device.view import RayFrame
from clvol.volume import Grid

_SMALL = 3.0  # pixels: the mean width of rectangles around cells that hide threads anywhere in them
_WIDEST = 1.5  # pixels per voxel of rectangles around cells: about a pixel per edge of a voxel
_SOME = 256  # cells by which the width of all is judged
_CORNERS = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1).astype(bool)


def hidden(
    cells: np.ndarray, shift: int, grid: Grid, frame: RayFrame, opacity: np.ndarray
) -> np.ndarray:
    """bool [height, width]: pixels that may hide something. ``cells`` bool [z, y, x] of 2^``shift`` lattice units:
    where anything is visible in a volume on ``grid``. ``frame``: rays of the picture, ``opacity`` [height, width]."""
    clear = opacity == 0.0
    places = np.argwhere(_surface(cells))[:, ::-1]
    if not clear.any() or not len(places):
        return np.zeros_like(clear)
    some = _Cells(places[:: max(len(places) // _SOME, 1)], shift, grid, frame, clear.shape)
    if some.width > _WIDEST * (1 << shift):
        return np.zeros_like(clear)
    every = _Cells(places, shift, grid, frame, clear.shape)
    if every.width == np.inf:
        return np.zeros_like(clear)
    covered = every.covered()
    return clear & (covered if some.width <= _SMALL else _outline(covered))


class _Cells:
    """Cells ``places`` int [n, 3] (x, y, z) in a ``picture`` (height, width): ``ranges`` of the pixels that rectangles
    around them touch, and ``width``, how many pixels wide these are in the mean; infinite where the eye is among
    cells: then threads are not thinner than pixels."""

    def __init__(
        self, places: np.ndarray, shift: int, grid: Grid, frame: RayFrame, picture: tuple[int, int]
    ) -> None:
        self._height, self._width = picture
        self.ranges: Ranges = []
        self.width = np.inf
        to_edges = np.diag(np.asarray(grid.spacing) / grid.smallest_edge)
        forward, right, down, pixel = view_axes(frame, to_edges)
        low = places << shift
        high = np.minimum(low + (1 << shift), np.maximum(np.asarray(grid.size) - 1, 1))
        corners = np.where(_CORNERS, high[:, None], low[:, None])
        from_plane = (corners - frame.origin) @ to_edges.T
        scale: np.ndarray | float = 1.0 / pixel
        if frame.lens[0] > 0:
            depth = from_plane @ forward + frame.distance
            if (depth <= 1e-3 * (1.0 + np.abs(depth).max())).any():
                return
            scale = 1.0 / (depth * pixel)
        widths = []
        for axis, (direction, n) in enumerate(((right, self._width), (down, self._height))):
            at = (from_plane @ direction) * scale + frame.centre[axis]
            first, last = at.min(axis=1), at.max(axis=1)
            widths.append(float((last - first).mean()))
            # Pixel i reaches from i - 1/2 to i + 1/2; a little more, since rays are rounded.
            begin, end = np.ceil(first - 0.51), np.floor(last + 0.51) + 1
            self.ranges.append((np.clip(begin, 0, n).astype(int), np.clip(end, 0, n).astype(int)))
        self.width = sum(widths) / 2

    def covered(self) -> np.ndarray:
        """bool [height, width]."""
        ones = np.ones(len(self.ranges[0][0]), np.int64)
        return sums_over_tiles(self.ranges, ones, self._width, self._height) > 0


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
