"""One picture made of tiles, on the device: cast as planned, then improved for as long as there is
time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Protocol

import numpy as np

from clvol.integrators.base import FrameData
from clvol.integrators.tiles.geometry import Resolution, TileGrid, ray_counts
from clvol.integrators.tiles.join import Joiner, around
from clvol.integrators.tiles.launch import PacketRenderer, cast_rays
from clvol.integrators.tiles.refine import TileErrors, estimated_errors, mean_of_tiles
from clvol.integrators.tiles.work import RayWork, ray_work
from clvol.opencl.context import DeviceContext
from clvol.scene.camera import Camera

_ROUND = 0.1  # rays of a round of refinement, of those that are left ...
_LEAST_ROUND = 0.02  # ... but at least so many, of all pixels
_READS = 1.5  # times as long as reading the image takes, in the end, what is done besides
_SAFETY = 0.9  # of the time that is left, a round is made for


class RayEngine(Protocol):
    """What casts the rays of tiles: a scene resident on a device."""

    context: DeviceContext

    @property
    def shows_nothing(self) -> bool:
        """Nothing can be seen: no ray needs to be cast."""

    def packets(self, depth: bool) -> PacketRenderer:
        """The kernel that casts rays, with depths or without."""

    def picture_view(self, camera: Camera, width: int, height: int) -> np.ndarray:
        """``View`` [1] of a whole picture."""

    def blank_view(self) -> np.ndarray:
        """``View`` [1] of a picture of no pixels, all zeros."""

    def corner_statistics(
        self, view: np.ndarray, grid: TileGrid
    ) -> tuple[np.ndarray, int] | None:
        """What rays through the tiles' corners meet [rows + 1, columns + 1, 4]
        (clvol/integrators/tiles/plan.py), and samples an axis of a block at full resolution; None where
        there are no blocks."""

    def counted(self, counts: np.ndarray) -> dict[str, int]:
        """What effects counted [work-items, COUNTERS], by name."""


@dataclass
class TiledFrameData(FrameData):
    """``share``: pixels with a ray of their own, of all. ``estimated_rmse``: root mean square
    difference from the picture with all rays, as far as the rays tell, over its pixels and
    channels; None where it was not asked for."""

    share: float = 1.0
    estimated_rmse: float | None = None


class TiledPicture:
    """``tau`` [tiles]: lines an axis of each tile, planned. No ray is cast yet: ``cast`` comes
    first. ``clock``: seconds, for tests."""

    def __init__(
        self,
        engine: RayEngine,
        grid: TileGrid,
        tau: np.ndarray,
        view: np.ndarray,
        depth: bool = True,
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        self.engine, self.grid, self.view, self.depth, self.clock = engine, grid, view, depth, clock
        tau = np.asarray(tau, np.int64).ravel()
        self.resolution = Resolution(tau, np.full(grid.count, -1))
        self.rays = self.samples = 0
        context = engine.context
        shape = (grid.height, grid.width)
        self._image = context.empty(np.float32, (*shape, 4))
        self._depths = context.empty(np.float32, shape if depth else (1,))
        self._joiner = Joiner(context, grid, depth)
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
        """int64 [tiles]: rays that refining each tile once more takes; 0 where it has them all."""
        halvings = self.resolution.halvings
        return self._rays_at(halvings + 1) - self._rays_at(halvings)

    def _rays_at(self, halvings: np.ndarray) -> np.ndarray:
        return ray_counts(self.grid, Resolution(self.resolution.tau, halvings), self._tiles)

    def coarsen(self, by: int) -> bool:
        """Plans a ``by``-th of the lines, rounded up, before any ray is cast; whether that is
        less."""
        tau, self.resolution.tau = self.resolution.tau, -(-self.resolution.tau // by)
        return bool((self.resolution.tau < tau).any())

    def cast(self, progress: Callable[[int], None] | None = None) -> None:
        """The planned rays of all tiles. ``progress(rays so far)`` is called after each launch."""
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
        have passed, or every pixel has a ray. Goes on where it stopped if it is called again; all
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
        """How far the picture is from the one with all rays, as far as the rays tell."""
        pixels = self.grid.width * self.grid.height
        return self._known_errors().rmse(self.unknown, pixels)

    def _set_speed(self, rays: int, seconds: float) -> None:
        self._rays_a_second = rays / max(seconds, 1e-9)

    def _known_errors(self) -> TileErrors:
        """Estimated from the planned rays, the first time."""
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
        have none; then fills what shows something of them. Gives the rays, and the mean square
        change that those of each tile made to the picture [tiles given]; it has no meaning for
        first rays. ``progress(rays so far)``."""
        before = self.rays
        work = ray_work(self.grid, self.resolution, tiles)
        cast = cast_rays(
            self.engine.context, self.engine.packets(self.depth), self.view, work,
            self._image, self._depths,
            None if progress is None else lambda done: progress(before + done),
        )  # fmt: skip
        self.resolution.halvings[tiles] += 1
        self.rays += work.count
        self.samples += cast.samples
        if cast.counts is not None:
            self._counts.append(cast.counts)
        self._joiner.join(self.resolution, around(self.grid, tiles), self._image, self._depths)
        return work, mean_of_tiles(cast.changes, work, self.grid.count)[tiles]

    def read(self) -> np.ndarray:
        """float32 [height, width, 4]: the picture as it is."""
        return self.engine.context.read(self._image)

    def frame(self) -> TiledFrameData:
        depths = self.engine.context.read(self._depths) if self.depth else None
        counters = self.engine.counted(np.concatenate(self._counts)) if self._counts else {}
        pixels = self.grid.width * self.grid.height
        share = self.rays / pixels
        return TiledFrameData(self.read(), depths, self.samples, self.rays, counters, share)
