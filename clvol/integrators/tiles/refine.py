"""Estimated errors of the tiles, and which tiles to refine next: arithmetic, without a device.

Errors are mean squares over a tile's pixels without a ray, and over the four channels (linear,
premultiplied). They are estimated in two ways:

- Before a tile is refined, from the second differences D of the picture across its rays (one line
  to either side, so over the borders too). Along an axis linear interpolation between samples h
  apart of a smooth function f is off by (h^2 - 4 u^2) f'' / 8 at distance u from the middle: a mean
  square of D^2 / 120, D = h^2 f''. Where f jumps by J between two samples it is J^2 / 6 between
  these two, next to both of which D = J: D^2 / 12. The estimate takes the geometric mean of the
  two. Estimates of tiles that have not been refined are then multiplied by the ratio of measured to
  estimated errors in the refined tiles.
- When a tile is refined, its new rays show how wrong the picture was before: they stand in the
  middle of the gaps, where interpolation is worst. The factor by which halving the gaps lowers the error
  is taken from the tiles that were refined twice; until there are some, it is 4 (for the mean
  square: between 16, where the picture is smooth, and 2, where it jumps).

Details between rays of equal colour stay unknown, so a small object there counts as no error.
"""

from __future__ import annotations

import numpy as np

from clvol.integrators.tiles.geometry import Resolution, TileGrid, each_axis, lines
from clvol.integrators.tiles.work import RayWork

_OF_SECOND_DIFFERENCES = (120.0 * 12.0) ** -0.5
_FALL = 0.25  # factor on a mean square error when gaps are halved, until it has been measured ...
_LEAST_FALL, _MOST_FALL = 1.0 / 16.0, 1.0  # ... and its limits


def estimated_errors(
    image: np.ndarray, grid: TileGrid, resolution: Resolution, work: RayWork
) -> np.ndarray:
    """float64 [tiles]: mean square errors from second differences of ``image`` [height, width, 4]
    (joined). ``work``: the rays of all tiles."""
    tiles = np.arange(grid.count)
    row, column = np.divmod(work.pixels, grid.width)
    middle = image[row, column]
    total = np.zeros(work.count)
    for axis, (at, last) in enumerate(((column, grid.width - 1), (row, grid.height - 1))):
        count = each_axis(lambda *key: len(lines(*key)), resolution.on_axis(grid, axis, tiles))
        gap = np.maximum(np.rint(grid.lengths[:, axis] / count).astype(np.int64), 1)[work.tiles]
        before, after = np.maximum(at - gap, 0), np.minimum(at + gap, last)
        sides = [image[row, p] if axis == 0 else image[p, column] for p in (before, after)]
        second = sides[0] - 2.0 * middle + sides[1]
        total += np.mean(second * second, axis=1)
    return _OF_SECOND_DIFFERENCES * mean_of_tiles(total, work, grid.count)


def mean_of_tiles(values: np.ndarray, work: RayWork, count: int) -> np.ndarray:
    """float64 [count]: means of ``values`` [rays] over each tile's rays; 0 for a tile without rays."""
    rays = np.bincount(work.tiles, minlength=count)
    return np.bincount(work.tiles, values, minlength=count) / np.maximum(rays, 1)


class TileErrors:
    """Mean square errors of the tiles, kept up to date while they are refined.

    ``estimates`` [tiles]: from second differences.
    """

    def __init__(self, estimates: np.ndarray) -> None:
        self._estimates = np.array(estimates, np.float64)
        self._measured = np.full(self._estimates.shape, np.nan)  # before the last refinement
        self._first = np.zeros(2)  # sums over tiles refined once: measured, estimated
        self._again = np.zeros(2)  # and over those refined again: measured, measured before

    @property
    def correction(self) -> float:
        """The factor on the estimates."""
        measured, estimated = self._first
        return measured / estimated if measured > 0 and estimated > 0 else 1.0

    @property
    def fall(self) -> float:
        """The factor on a tile's mean square error when its gaps are halved."""
        now, before = self._again
        return float(np.clip(now / before, _LEAST_FALL, _MOST_FALL)) if before > 0 else _FALL

    @property
    def mean_squares(self) -> np.ndarray:
        """float64 [tiles]: the current estimates."""
        refined = ~np.isnan(self._measured)
        after = np.where(refined, self._measured, 0.0) * self.fall
        return np.where(refined, after, self._estimates * self.correction)

    def refined(self, tiles: np.ndarray, measured: np.ndarray) -> None:
        """Records that ``tiles`` (numbers) were refined; ``measured`` [k] is the mean square difference of their new
        rays from the picture before."""
        before = self._measured[tiles]
        again = ~np.isnan(before)
        self._again += measured[again].sum(), before[again].sum()
        self._first += measured[~again].sum(), self._estimates[tiles][~again].sum()
        self._measured[tiles] = measured

    def rmse(self, unknown: np.ndarray, pixels: int) -> float:
        """The error of a whole picture of ``pixels``, of which ``unknown`` [tiles] have no ray."""
        return float(np.sqrt((self.mean_squares * unknown).sum() / pixels))

    def choose(
        self, unknown: np.ndarray, costs: np.ndarray, round_rays: float, most_rays: float
    ) -> np.ndarray:
        """The tiles (numbers) to refine next: those with the greatest sum of squared errors for
        each ray that refining them costs (so that no large or nearly full tile is favoured), of
        about ``round_rays`` in all, at least one tile, but never more than ``most_rays``.
        ``unknown``, ``costs`` [tiles]: pixels without a ray, rays that refining adds; 0 where a
        tile is complete."""
        open_tiles = np.flatnonzero((costs > 0) & (costs <= most_rays))
        worth = self.mean_squares[open_tiles] * unknown[open_tiles] / costs[open_tiles]
        order = open_tiles[np.argsort(-worth, kind="stable")]
        spent = np.cumsum(costs[order])
        count = int(np.searchsorted(spent, min(round_rays, most_rays), side="right"))
        return np.sort(order[: max(count, 1)])
