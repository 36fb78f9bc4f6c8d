"""Which tiles of a picture can show something that lies in some cells alone.

The others are rendered by a kernel that does not know of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.device.tile_ranges import Ranges, sums_over_tiles, view_axes
from clvol.device.view import RayFrame
from clvol.volume.voxel_layout import CELL_SHIFT

_MOST_CELLS = 1 << 16  # cells of which costs are estimated
_FILLED = 1 / 3  # of the mean depth between a cell's bounds: most of a cell at a boundary has the lower values
_ENDS_AT = 4.6  # optical depth at which rays end, about


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
    places = np.argwhere(cells)
    if not len(places):
        return np.zeros(columns * rows, np.int64)
    projected = _projected(places, size, frame, to_edges, picture, tile)
    if projected is None:
        return np.ones(columns * rows, np.int64)
    return sums_over_tiles(projected.ranges, np.ones(len(places), np.int64), columns, rows).ravel()


def expected_costs(
    depths: np.ndarray,
    cells: np.ndarray,
    size: tuple[int, int, int],
    frame: RayFrame,
    to_edges: np.ndarray,
    picture: tuple[int, int],
    tile: tuple[int, int],
) -> np.ndarray:
    """float64 [tiles], row by row: relative costs of tiles, as far as cells tell: those that lie before a tile, until
    what lies in front of them is opaque.

    ``depths`` float [z, y, x]: mean optical depths of cells along their edges. Other arguments as for
    ``cells_over_tiles``. Of very many cells a part is taken.
    """
    columns, rows = (-(-n // m) for n, m in zip(picture, tile))
    places = np.argwhere(cells)
    places = places[:: max(len(places) // _MOST_CELLS, 1)]
    projected = _projected(places, size, frame, to_edges, picture, tile) if len(places) else None
    if projected is None:
        return np.ones(columns * rows)
    kept = cells.sum() / len(places)
    # Tiles are larger than the cell's own outline: the shares of all cells add up to their number.
    shares = kept * projected.shares
    opaque = _FILLED * shares * depths[tuple(places.T)]
    slabs = np.floor((projected.depth - projected.depth.min()) / (1 << CELL_SHIFT)).astype(int)
    order = np.argsort(slabs, kind="stable")
    cost, passed = np.zeros((rows, columns)), np.zeros((rows, columns))
    for slab in np.split(order, np.flatnonzero(np.diff(slabs[order])) + 1):
        ranges = [(first[slab], last[slab]) for first, last in projected.ranges]
        alive = 1.0 / (1.0 + np.exp(np.minimum(passed - _ENDS_AT, 50.0)))
        cost += alive * sums_over_tiles(ranges, shares[slab], columns, rows)
        passed += sums_over_tiles(ranges, opaque[slab], columns, rows)
    return cost.ravel()


@dataclass(frozen=True, eq=False)
class _Projected:
    """``ranges``: the tiles that each cell may cover. ``shares``: of their area that its outline has. ``depth``: along
    the view, in edges."""

    ranges: Ranges
    shares: np.ndarray
    depth: np.ndarray


def _projected(
    places: np.ndarray,
    size: tuple[int, int, int],
    frame: RayFrame,
    to_edges: np.ndarray,
    picture: tuple[int, int],
    tile: tuple[int, int],
) -> _Projected | None:
    """Cells ``places`` int [n, 3] (z, y, x) in the picture; None where the eye is among them."""
    edge = 1 << CELL_SHIFT
    low = places[:, ::-1] * edge
    high = np.maximum(np.minimum(low + edge, np.asarray(size) - 1), low)  # blocks may reach beyond the volume
    half = 0.5 * (high - low) @ np.abs(to_edges).T
    radius = np.linalg.norm(half, axis=1) + 1e-3
    is_perspective = frame.lens[0] > 0
    forward, right, down, pixel = view_axes(frame, to_edges)
    from_plane = (0.5 * (low + high) - frame.origin) @ to_edges.T
    depth = from_plane @ forward + frame.distance
    if is_perspective and np.any(depth <= 1.01 * radius):
        return None
    scale = (1.0 / depth if is_perspective else np.ones_like(depth)) / pixel
    centres = np.stack([from_plane @ right, from_plane @ down]) * scale
    reach = np.broadcast_to(radius / pixel, centres.shape)
    if is_perspective:
        # |x' / z' - x / z| <= r sqrt(1 + (x / z)^2) / (z - r) for every point of the sphere.
        slopes = np.sqrt(1.0 + (centres * pixel) ** 2)
        reach = radius * slopes / ((depth - radius) * pixel)
    ranges = []
    for axis, (n, m) in enumerate(zip(picture, tile)):
        count = -(-n // m)
        at = centres[axis] + frame.centre[axis]
        first = np.floor((at - reach[axis] - 1) / m)
        last = np.floor((at + reach[axis] + 1) / m) + 1
        ranges.append((np.clip(first, 0, count).astype(int), np.clip(last, 0, count).astype(int)))
    (x0, x1), (y0, y1) = ranges
    area = np.maximum((x1 - x0) * (y1 - y0), 1) * float(tile[0] * tile[1])
    volumes = np.prod(2 * half, axis=1)
    return _Projected(ranges, volumes ** (2 / 3) * scale**2 / area, depth)
