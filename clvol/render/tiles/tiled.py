"""Pictures made of tiles, each with as many rays as it deserves (P2, section 4), and refined for as long as
there is time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Protocol

import numpy as np

from clvol.opencl.context import DeviceContext, restore_interrupts
from clvol.render.raycast import FrameData
from clvol.render.tiles.geometry import Resolution, TileGrid, ray_counts
from clvol.render.tiles.join import Joiner, around
from clvol.render.tiles.launch import PacketRenderer, cast_rays
from clvol.render.tiles.plan import Priority, plan, planned_tau
from clvol.render.tiles.refine import TileErrors, estimated_errors, mean_of_tiles
from clvol.render.tiles.work import RayWork, ray_work
from clvol.scene.camera import Camera
from clvol.scene.multiresolution import Multiresolution

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
        """What rays through the tiles' corners meet [rows + 1, columns + 1, 4] (clvol/render/tiles/plan.py),
        and samples an axis of a block at full resolution; None where there are no blocks."""

    def counted(self, counts: np.ndarray) -> dict[str, int]:
        """What effects counted [work-items, COUNTERS], by name."""


@dataclass
class TiledFrameData(FrameData):
    """``share``: pixels with a ray of their own, of all. ``estimated_rmse``: root mean square difference
    from the picture with all rays, as far as the rays tell, over its pixels and channels; None where it was
    not asked for."""

    share: float = 1.0
    estimated_rmse: float | None = None


class TiledPicture:
    """One picture on the device. ``tau`` [tiles]: lines an axis of each tile, planned. No ray is cast yet:
    ``refine`` all tiles first."""

    def __init__(
        self, engine: RayEngine, grid: TileGrid, tau: np.ndarray, view: np.ndarray, depth: bool
    ) -> None:
        self.engine, self.grid, self.view, self.depth = engine, grid, view, depth
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

    def refine(
        self, tiles: np.ndarray, progress: Callable[[int], None] | None = None
    ) -> tuple[RayWork, np.ndarray]:
        """Halves the gaps of ``tiles`` (numbers) once more, or casts the planned rays of those that have none;
        then fills what shows something of them. Gives the rays, and the mean square change that
        those of each tile made to the picture [tiles given]; it has no meaning for first rays."""
        work = ray_work(self.grid, self.resolution, tiles)
        cast = cast_rays(
            self.engine.context, self.engine.packets(self.depth), self.view, work,
            self._image, self._depths, progress,
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


class TiledRenderer:
    """Renders an engine's scene tile by tile, as ``settings`` say (``tiles`` at least 2).

    ``clock``: seconds, for tests.
    """

    def __init__(
        self,
        engine: RayEngine,
        settings: Multiresolution,
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        if settings.tiles < 2:
            raise ValueError(f"tiles of {settings.tiles} pixels, expected at least 2")
        self.engine, self.settings, self.clock = engine, settings, clock

    def warm_up(self, depth: bool = True) -> None:
        """Compiles what a picture of any size needs: final code is made at the first launch."""
        engine = self.engine
        if engine.shows_nothing:
            return
        context = engine.context
        none = context.empty(np.float32, (4,))
        # A ray that misses: it is outside a picture of no pixels.
        view = engine.blank_view()
        work = RayWork(np.zeros(1, np.int32), np.zeros(1, np.int32))
        cast_rays(context, engine.packets(depth), view, work, none, none)
        grid = TileGrid(1, 1, self.settings.tiles)
        engine.corner_statistics(view, grid)
        resolution = Resolution(np.ones(1, np.int64), np.zeros(1, np.int64))
        Joiner(context, grid, depth).join(resolution, np.zeros(1, np.int64), none, none)
        context.finish()
        restore_interrupts()

    def start(self, camera: Camera, width: int, height: int, depth: bool = True) -> TiledPicture:
        """A picture with its plan and without any ray."""
        settings, view = self.settings, self.engine.picture_view(camera, width, height)
        grid = TileGrid(width, height, settings.tiles)
        statistics = self.engine.corner_statistics(view, grid)
        if statistics is None:
            tau = planned_tau(np.full(grid.count, settings.tile_high), grid.size)
        else:
            corners, slots = statistics
            low, high = settings.tile_low, settings.tile_high
            tau = plan(corners, settings.tile_priority, low, high, slots, grid.size)
        return TiledPicture(self.engine, grid, tau, view, depth)

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Callable[[int, int], None] | None = None,
        depth: bool = True,
        *,
        seconds: float | None = None,
        rays: int | None = None,
    ) -> TiledFrameData:
        """One picture of ``width`` by ``height``: the planned rays, which are cast in any case, and then
        refined, worst tiles first, until ``seconds`` have passed since the call, or ``rays`` were cast
        in all, or every pixel has one. (Neither given: not refined.) The rays cast are kept, so
        a picture with all of them is the plain one, bit for bit.

        ``progress(rays done, all)`` is called after each launch.
        """
        start = self.clock()
        if self.engine.shows_nothing:
            nowhere = np.full((height, width), np.inf, np.float32) if depth else None
            return TiledFrameData(np.zeros((height, width, 4), np.float32), nowhere, 0, 0, {}, 0.0)
        picture = self.start(camera, width, height, depth)
        refines = seconds is not None or rays is not None
        limit = int(picture.costs.sum())
        if refines:
            limit = min(width * height, max(limit, width * height if rays is None else rays))

        def report(done: int) -> None:
            if progress is not None:
                progress(picture.rays + done, limit)

        tiles = np.arange(picture.grid.count)
        work, _ = picture.refine(tiles, report)
        if not refines:
            return picture.frame()
        reading = self.clock()
        image = picture.read()
        reading = _READS * (self.clock() - reading)
        deadline = None if seconds is None else start + seconds - reading
        errors = TileErrors(estimated_errors(image, picture.grid, picture.resolution, work))
        self._refine(picture, errors, limit, start, deadline, report)
        frame = picture.frame()
        frame.estimated_rmse = errors.rmse(picture.unknown, width * height)
        return frame

    def _refine(
        self,
        picture: TiledPicture,
        errors: TileErrors,
        limit: int,
        round_start: float,
        deadline: float | None,
        report: Callable[[int], None],
    ) -> None:
        """Rounds of refinement, up to ``limit`` rays or the ``deadline``. ``round_start``: when what was cast so
        far was begun."""
        grid = picture.grid
        pixels = grid.width * grid.height
        before = 0
        while picture.rays < limit:
            most = limit - picture.rays
            if deadline is not None:
                now = self.clock()
                per_second = (picture.rays - before) / max(now - round_start, 1e-9)
                most = min(most, _SAFETY * per_second * (deadline - now))
                round_start = now
            before = picture.rays
            round_rays = max(_ROUND * (pixels - picture.rays), _LEAST_ROUND * pixels)
            chosen = errors.choose(picture.unknown, picture.costs, round_rays, most)
            if not len(chosen):
                return
            _, measured = picture.refine(chosen, report)
            errors.refined(chosen, measured)
