"""Pictures made of tiles, with ray density chosen per tile (Ljung 2006, section 4)."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np

from clvol.integrators.tiles.canvas import Canvas, DeviceCanvas
from clvol.integrators.tiles.engine import RayEngine
from clvol.integrators.tiles.geometry import Resolution, TileGrid
from clvol.integrators.tiles.join import Joiner
from clvol.integrators.tiles.launch import cast_rays
from clvol.integrators.tiles.picture import TiledFrameData, TiledPicture
from clvol.integrators.tiles.plan import plan, planned_tau
from clvol.integrators.tiles.work import RayWork
from clvol.opencl.context import restore_interrupts
from clvol.scene.camera import Camera
from clvol.scene.multiresolution import Multiresolution

_COARSER = 4  # factor by which the plan of a picture for a given time is coarsened at first


class TiledRenderer:
    """Renders an engine's scene tile by tile, as ``settings`` say (``tiles`` at least 2).

    ``clock`` returns seconds; tests replace it. ``canvas(view, grid, depth)`` makes what rays are cast on: by default
    a ``DeviceCanvas`` of ``engine``.
    """

    def __init__(
        self,
        engine: RayEngine,
        settings: Multiresolution,
        clock: Callable[[], float] = perf_counter,
        canvas: Callable[[np.ndarray, TileGrid, bool], Canvas] | None = None,
    ) -> None:
        if settings.tiles < 2:
            raise ValueError(f"tiles of {settings.tiles} pixels, expected at least 2")
        self.engine, self.settings, self.clock = engine, settings, clock
        self._canvas = canvas or (lambda view, grid, depth: DeviceCanvas(engine, view, grid, depth))

    def warm_up(self, depth: bool = True) -> None:
        """Compiles what pictures of any size need, by launching it: drivers finish compiling then."""
        engine = self.engine
        if engine.shows_nothing:
            return
        context = engine.context
        none = context.empty(np.float32, (4,))
        # A ray that misses, since it lies outside a picture without pixels.
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
        """A picture with its plan, without any rays yet."""
        settings, view = self.settings, self.engine.picture_view(camera, width, height)
        grid = TileGrid(width, height, settings.tiles)
        statistics = self.engine.corner_statistics(view, grid)
        if statistics is None:
            tau = planned_tau(np.full(grid.count, settings.tile_high), grid.size)
        else:
            corners, slots = statistics
            low, high = settings.tile_low, settings.tile_high
            tau = plan(corners, settings.tile_priority, low, high, slots, grid.size)
        return TiledPicture(self.engine, self._canvas(view, grid, depth), grid, tau, self.clock)

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
        """One picture of ``width`` by ``height``: the planned rays are cast, and then more where they are
        needed most, until ``seconds`` have passed since the call, or ``rays`` were cast in all, or
        every pixel has one. (With neither given, only the planned rays are cast.) All rays are kept, so a picture
        with one ray per pixel equals the one without tiles, bit for bit.

        A plan of more than ``rays`` is made coarser until it fits. The first rays show how fast rays are: with
        ``seconds`` given, they are a sixteenth of the planned ones. At least one ray per tile is cast in any case.

        ``progress(rays done, all)`` is called after each launch; a picture that ends with its time does not reach
        all.
        """
        start = self.clock()
        if self.engine.shows_nothing:
            nowhere = np.full((height, width), np.inf, np.float32) if depth else None
            return TiledFrameData(np.zeros((height, width, 4), np.float32), nowhere, 0, 0, {}, 0.0)
        picture = self.start(camera, width, height, depth)
        if seconds is not None:
            picture.coarsen(_COARSER)
        while rays is not None and picture.costs.sum() > rays and picture.coarsen(2):
            pass
        planned, refines = int(picture.costs.sum()), seconds is not None or rays is not None
        most = width * height if rays is None else min(width * height, rays)
        total = max(planned, most) if refines else planned
        report = None if progress is None else lambda done: progress(done, total)
        picture.cast(report)
        if not refines:
            return picture.frame()
        left = None if seconds is None else seconds - (self.clock() - start)
        picture.improve(rays, left, report)
        frame = picture.frame()
        frame.estimated_rmse = picture.estimated_rmse()
        return frame
