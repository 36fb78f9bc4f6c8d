"""Which tiles of a picture see each of many boxes."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from clvol.device.view import RayFrame

Ranges: TypeAlias = list[tuple[np.ndarray, np.ndarray]]
"""Of n boxes the first column of tiles that see it and the one after the last, int [n] each; likewise of rows."""

_PIECE = 1 << 16  # boxes that are projected together
_CORNERS = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=-1).astype(bool)


def tile_ranges(
    low: np.ndarray,
    high: np.ndarray,
    frame: RayFrame,
    to_edges: np.ndarray,
    picture: tuple[int, int],
    tile: tuple[int, int],
    beside: int = 0,
) -> Ranges:
    """The tiles with pixels that may have a ray through each of n boxes from ``low`` to ``high`` [n, 3] (x, y, z, in
    lattice coordinates): those that its corners enclose. All tiles where the eye is in the box or beside it, none where
    all of it is behind the eye. ``beside``: also tiles that are so many pixels away from such pixels.

    ``frame``: the picture's rays. ``to_edges`` [3, 3]: lattice directions to lengths in smallest edges. ``picture``,
    ``tile``: pixels (width, height).
    """
    parts = [
        _ranges(low[k : k + _PIECE], high[k : k + _PIECE], frame, to_edges, picture, tile, beside)
        for k in range(0, max(len(low), 1), _PIECE)
    ]
    return [
        (np.concatenate([part[axis][0] for part in parts]), np.concatenate([part[axis][1] for part in parts]))
        for axis in range(2)
    ]


def _ranges(
    low: np.ndarray,
    high: np.ndarray,
    frame: RayFrame,
    to_edges: np.ndarray,
    picture: tuple[int, int],
    tile: tuple[int, int],
    beside: int,
) -> Ranges:
    is_perspective = frame.lens[0] > 0
    forward, right, down, pixel = view_axes(frame, to_edges)
    corners = np.where(_CORNERS, high[:, None], low[:, None])
    from_plane = (corners - frame.origin) @ to_edges.T
    depth = from_plane @ forward + frame.distance
    near, behind = np.zeros(len(low), bool), np.zeros(len(low), bool)
    scale = np.full(depth.shape, 1.0 / pixel)
    if is_perspective:
        least = 1e-3 * (1.0 + np.abs(depth).max(axis=1))
        behind, near = depth.max(axis=1) < -least, depth.min(axis=1) <= least
        scale = 1.0 / (np.maximum(depth, least[:, None]) * pixel)
    ranges = []
    for axis, (direction, n, m) in enumerate(zip((right, down), picture, tile)):
        count = -(-n // m)
        at = from_plane @ direction * scale + frame.centre[axis]
        more = 1 + beside
        first, last = np.floor((at.min(axis=1) - more) / m), np.floor((at.max(axis=1) + more) / m) + 1
        first, last = np.where(near, 0, first), np.where(near, count, last)
        last = np.where(behind, first, last)
        ranges.append((np.clip(first, 0, count).astype(int), np.clip(last, 0, count).astype(int)))
    return ranges


def view_axes(frame: RayFrame, to_edges: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Forward, right and down [3] of the view, orthonormal, in edges, and the edges per pixel (at distance 1 in
    perspective)."""
    forward = to_edges @ frame.forward
    across = (frame.ray_du, frame.ray_dv) if frame.lens[0] > 0 else (frame.du, frame.dv)
    right, down = (to_edges @ v for v in across)
    pixel = float(np.linalg.norm(right))
    return forward / np.linalg.norm(forward), right / pixel, down / pixel, pixel


def sums_over_tiles(ranges: Ranges, values: np.ndarray, columns: int, rows: int) -> np.ndarray:
    """[rows, columns]: the sum of ``values`` [n] over the boxes that each tile sees."""
    (x0, x1), (y0, y1) = ranges
    sums = np.zeros((rows + 1, columns + 1), values.dtype)
    for y, x, sign in ((y0, x0, 1), (y0, x1, -1), (y1, x0, -1), (y1, x1, 1)):
        np.add.at(sums, (y, x), sign * values)
    return sums.cumsum(axis=0).cumsum(axis=1)[:rows, :columns]
