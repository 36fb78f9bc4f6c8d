"""One picture made of tiles: its planned rays are cast, then it is refined while there is time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from clvol.integrators.base import FrameData
from clvol.integrators.tiles.canvas import Canvas
from clvol.integrators.tiles.engine import RayEngine
from clvol.integrators.tiles.geometry import Resolution, TileGrid, ray_counts
from clvol.integrators.tiles.join import around
from clvol.integrators.tiles.refine import TileErrors, estimated_errors, mean_of_tiles
from clvol.integrators.tiles.work import RayWork, ray_work

_ROUND = 0.1  # rays per round of refinement, as a share of those that are left ...
_LEAST_ROUND = 0.02  # ... but at least this share of all pixels
_READS = 1.5  # time reserved for the end of a picture, in units of the time that reading the image takes
_SAFETY = 0.9  # share of the remaining time that a round is planned to use


@dataclass
class TiledFrameData(FrameData):
    """``share``: the share of pixels that have a ray of their own. ``estimated_rmse``: root mean square
    difference from the picture with all rays, over its pixels and channels, as estimated from the rays;
    None where it was not requested."""

    share: float = 1.0
    estimated_rmse: float | None = None


class TiledPicture:
    """``canvas``: without content. ``tau`` [tiles]: planned lines per axis of each tile. A new picture has no rays:
    call ``cast`` first. ``clock`` returns seconds; tests replace it."""

    def __init__(
        self,
        engine: RayEngine,
        canvas: Canvas,
        grid: TileGrid,
        tau: np.ndarray,
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        self.engine, self.grid, self.clock = engine, grid, clock
        self._canvas = canvas
        tau = np.asarray(tau, np.int64).ravel()
        self.resolution = Resolution(tau, np.full(grid.count, -1))
        self.rays = self.samples = 0
        self._counts: list[np.ndarray] = []
        self._tiles = np.arange(grid.count)
        self._planned: RayWork | None = None
        self._errors: TileErrors | None = None
        self._rays_a_second = 0.0
        self._reading = 0.0  # seconds that reading the picture takes

    @property
    def unknown(self) -> np.ndarray:
        """int64 [tiles]: pixels without a ray."""
        return self.grid.pixels - self._rays_at(self.resolution.halvings)

    @property
    def costs(self) -> np.ndarray:
        """int64 [tiles]: rays that refining each tile once more costs; 0 for a complete tile."""
        halvings = self.resolution.halvings
        return self._rays_at(halvings + 1) - self._rays_at(halvings)

    def _rays_at(self, halvings: np.ndarray) -> np.ndarray:
        return ray_counts(self.grid, Resolution(self.resolution.tau, halvings), self._tiles)

    def coarsen(self, by: int) -> bool:
        """Plans a ``by``-th of the lines, rounded up, before any ray is cast. Returns whether that lowers any tile's
        number of lines."""
        tau, self.resolution.tau = self.resolution.tau, -(-self.resolution.tau // by)
        return bool((self.resolution.tau < tau).any())

    def cast(self, progress: Callable[[int], None] | None = None) -> None:
        """Casts the planned rays of all tiles. ``progress(rays so far)`` is called after each launch."""
        start = self.clock()
        self._planned, _ = self.refine(self._tiles, progress)
        self._set_speed(self.rays, self.clock() - start)

    def improve(
        self,
        rays: int | None = None,
        seconds: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        """Refines, worst tiles first, until ``rays`` were cast for this picture in all, ``seconds``
        have passed, or every pixel has a ray. Another call continues where this one stopped; all
        rays are kept."""
        start = self.clock()
        errors = self._known_errors()
        pixels = self.grid.width * self.grid.height
        limit = pixels if rays is None else min(rays, pixels)
        while self.rays < limit:
            most, now = limit - self.rays, self.clock()
            affordable: float = most
            if seconds is not None:
                left = seconds - (now - start) - _READS * self._reading
                affordable = min(most, _SAFETY * self._rays_a_second * left)
            round_rays = max(_ROUND * (pixels - self.rays), _LEAST_ROUND * pixels)
            chosen = errors.choose(self.unknown, self.costs, round_rays, affordable)
            if not len(chosen):
                return
            work, measured = self.refine(chosen, progress)
            errors.refined(chosen, measured)
            self._set_speed(work.count, self.clock() - now)

    def estimated_rmse(self) -> float:
        """Root mean square difference from the picture with all rays, as estimated from the rays."""
        pixels = self.grid.width * self.grid.height
        return self._known_errors().rmse(self.unknown, pixels)

    def _set_speed(self, rays: int, seconds: float) -> None:
        self._rays_a_second = rays / max(seconds, 1e-9)

    def _known_errors(self) -> TileErrors:
        """The errors of the tiles; the first call estimates them from the planned rays."""
        if self._errors is None:
            if self._planned is None:
                raise ValueError("errors are known only once the planned rays are cast")
            start = self.clock()
            image = self.read()
            self._reading = self.clock() - start
            self._errors = TileErrors(
                estimated_errors(image, self.grid, self.resolution, self._planned)
            )
        return self._errors

    def refine(
        self, tiles: np.ndarray, progress: Callable[[int], None] | None = None
    ) -> tuple[RayWork, np.ndarray]:
        """Halves the gaps of ``tiles`` (numbers) once more, or casts the planned rays of those that
        have none; then fills all pixels that depend on them. Returns the rays, and the mean square
        change of the picture that those of each tile made [tiles given], which has no meaning for
        first rays. ``progress(rays so far)`` is called after each launch."""
        before = self.rays
        work = ray_work(self.grid, self.resolution, tiles)
        cast = self._canvas.cast(work, None if progress is None else lambda done: progress(before + done))
        self.resolution.halvings[tiles] += 1
        self.rays += work.count
        self.samples += cast.samples
        if cast.counts is not None:
            self._counts.append(cast.counts)
        self._canvas.join(self.resolution, around(self.grid, tiles))
        return work, mean_of_tiles(cast.changes, work, self.grid.count)[tiles]

    def read(self) -> np.ndarray:
        """float32 [height, width, 4]: the current picture."""
        return self._canvas.read()

    def frame(self) -> TiledFrameData:
        counters = self.engine.counted(np.concatenate(self._counts)) if self._counts else {}
        pixels = self.grid.width * self.grid.height
        share = self.rays / pixels
        return TiledFrameData(self.read(), self._canvas.read_depths(), self.samples, self.rays, counters, share)
