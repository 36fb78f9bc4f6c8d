"""Pictures in tiles of random resolution, for tests."""

from __future__ import annotations

import numpy as np
from reference.tiles import JoinTwin

from clvol.integrators.tiles.geometry import Resolution, TileGrid
from clvol.integrators.tiles.join import Joiner

GRIDS = [(7, 5, 16), (7, 5, 3), (1, 1, 16), (33, 20, 8), (40, 35, 16), (9, 9, 2), (50, 3, 13)]


def random_resolution(grid: TileGrid, seed: int, most_halvings: int = 0) -> Resolution:
    rng = np.random.default_rng(seed)
    tau = rng.integers(1, grid.size + 1, grid.count)
    return Resolution(tau, rng.integers(0, most_halvings + 1, grid.count))


def rays_only(grid: TileGrid, resolution: Resolution, image: np.ndarray) -> np.ndarray:
    """``image`` float32 [height, width, 4] where there are rays; NaN, which spreads, where not."""
    known = JoinTwin(grid, resolution).is_ray()
    return np.where(known[..., None], image, np.nan).astype(np.float32)


def joined(context, grid, resolution, image, depths=None, tiles=None, rows_an_item=None):
    """Image and depths filled on the device, from what a ray shows alone."""
    depths = np.zeros(image.shape[:2], np.float32) if depths is None else depths
    known = JoinTwin(grid, resolution).is_ray()
    on_device = context.empty(np.float32, image.shape), context.empty(np.float32, depths.shape)
    context.write(on_device[0], rays_only(grid, resolution, image))
    context.write(on_device[1], np.where(known, depths, np.nan).astype(np.float32))
    tiles = np.arange(grid.count) if tiles is None else tiles
    Joiner(context, grid, rows_an_item=rows_an_item).join(resolution, tiles, *on_device)
    return tuple(context.read(each) for each in on_device)
