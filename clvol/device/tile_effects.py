"""Which tiles of a picture can show something that lies in some cells alone.

The others are rendered by a kernel that does not know of it.
"""

from __future__ import annotations

import numpy as np

from clvol.device.view import RayFrame
from clvol.volume.voxel_layout import CELL_SHIFT


def tiles_that_see(
    cells: np.ndarray,
    size: tuple[int, int, int],
    frame: RayFrame,
    to_edges: np.ndarray,
    picture: tuple[int, int],
    tile: tuple[int, int],
) -> np.ndarray:
    """bool [tiles], row by row: whether a pixel of the tile may have a ray through a marked cell. Arguments as for
    ``cells_over_tiles``."""
    return cells_over_tiles(cells, size, frame, to_edges, picture, tile) > 0


def cells_over_tiles(
    cells: np.ndarray,
    size: tuple[int, int, int],
    frame: RayFrame,
    to_edges: np.ndarray,
    picture: tuple[int, int],
    tile: tuple[int, int],
) -> np.ndarray:
    """int64 [tiles], row by row: the number of marked cells that the rays of the tile's pixels may pass.

    ``cells`` bool [z, y, x]: cells of 2^CELL_SHIFT lattice units. ``size``: lattice points (x, y, z).
    ``frame``: the picture's rays. ``to_edges`` [3, 3]: lattice directions to lengths in smallest
    edges. ``picture``, ``tile``: pixels (width, height). Takes the sphere around each cell:
    too many, never too few. Where the eye is among the cells, 1 for each tile.
    """
    columns, rows = (-(-n // m) for n, m in zip(picture, tile))
    edge = 1 << CELL_SHIFT
    low = np.argwhere(cells)[:, ::-1] * edge
    if not low.size:
        return np.zeros(columns * rows, np.int64)
    high = np.minimum(low + edge, np.asarray(size) - 1)
    half = 0.5 * (high - low) @ np.abs(to_edges).T
    radius = np.linalg.norm(half, axis=1) + 1e-3
    # An orthonormal frame of the view, in edges, from the eye (or its plane).
    forward, right, down = (to_edges @ v for v in (frame.forward, frame.du, frame.dv))
    is_perspective = frame.lens[0] > 0
    if is_perspective:
        right, down = to_edges @ frame.ray_du, to_edges @ frame.ray_dv
    forward = forward / np.linalg.norm(forward)
    pixel = np.linalg.norm(right)  # edges per pixel, at distance 1 in perspective
    right, down = right / pixel, down / pixel
    from_plane = (0.5 * (low + high) - frame.origin) @ to_edges.T
    depth = from_plane @ forward + frame.distance
    if is_perspective and np.any(depth <= 1.01 * radius):
        return np.ones(columns * rows, np.int64)  # the eye is among them
    scale = (1.0 / depth if is_perspective else np.ones_like(depth)) / pixel
    centres = np.stack([from_plane @ right, from_plane @ down]) * scale
    reach = np.broadcast_to(radius / pixel, centres.shape)
    if is_perspective:
        # |x' / z' - x / z| <= r sqrt(1 + (x / z)^2) / (z - r) for every point of the sphere.
        slopes = np.sqrt(1.0 + (centres * pixel) ** 2)
        reach = radius * slopes / ((depth - radius) * pixel)
    counts = np.zeros((rows + 1, columns + 1), np.int64)
    limits = []
    for axis, (n, m, count) in enumerate(zip(picture, tile, (columns, rows))):
        at = centres[axis] + frame.centre[axis]
        first = np.floor((at - reach[axis] - 1) / m)
        last = np.floor((at + reach[axis] + 1) / m) + 1
        limits.append((np.clip(first, 0, count).astype(int), np.clip(last, 0, count).astype(int)))
    (x0, x1), (y0, y1) = limits
    np.add.at(counts, (y0, x0), 1)
    np.add.at(counts, (y0, x1), -1)
    np.add.at(counts, (y1, x0), -1)
    np.add.at(counts, (y1, x1), 1)
    return counts.cumsum(axis=0).cumsum(axis=1)[:rows, :columns].ravel()
