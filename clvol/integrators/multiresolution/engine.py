"""The method "multiresolution": selects and loads blocks, and casts rays through them, tile by tile if requested."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np

from clvol.device.view import EVERY_PIXEL, Pixels
from clvol.integrators.base import FrameData, Progress
from clvol.integrators.multiresolution.caster import BlockCaster
from clvol.integrators.multiresolution.coded_caster import CodedBlockCaster
from clvol.integrators.multiresolution.coded_residency import CodedResidency
from clvol.integrators.multiresolution.residency import Residency
from clvol.integrators.pyramid.blocks import BlockPyramidCaster
from clvol.integrators.raycast.history import refused
from clvol.integrators.raycast.picture import PictureParts
from clvol.integrators.tiles.canvas import LAUNCH, SPEED, Canvas, SharedCanvas
from clvol.integrators.tiles.geometry import TileGrid
from clvol.integrators.tiles.picture import TiledFrameData
from clvol.integrators.tiles.tiled import TiledRenderer
from clvol.opencl.context import DeviceContext
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.schedule.crew import Team
from clvol.transfer import TransferFunction

TILES = 16  # pixels per edge of the tiles of a picture for a given time, where the scene sets none


AnyResidency = Residency | CodedResidency


def caster_of(resolved: ResolvedScene, residency: AnyResidency | None = None) -> type[BlockCaster]:
    """The class that renders the scene's stepping, of the blocks of ``residency``."""
    if isinstance(residency, CodedResidency):
        return CodedBlockCaster
    if resolved.multiresolution.stepping == "pyramid":
        return BlockPyramidCaster
    return BlockCaster


class MultiresolutionEngine:
    """A ``Prepared`` scene of blocks, which also ``RefinesInTime``. ``residency`` may be shared: each frame requests
    its own blocks.

    A frame waits for its blocks, so a picture is the same however long reading takes. Where ``wait`` is
    False, a thread reads the blocks, and frames show those that are there until all have arrived.
    """

    def __init__(
        self,
        context: DeviceContext,
        resolved: ResolvedScene,
        residency: AnyResidency | None = None,
        progress: Progress | None = None,
        wait: bool | None = None,
    ) -> None:
        self.context, self.resolved = context, resolved
        self.residency = residency or Residency(context, resolved)
        self.ask(wait, progress)
        self._shown = self.residency.generation
        make = caster_of(resolved, self.residency)
        self.caster = make(context, resolved, self.residency.blocks)
        self.caster.history = self.residency.history

    @property
    def visible_share(self) -> float:
        return self.caster.visible_share

    @property
    def renders_all_pixels(self) -> bool:
        """Whether it renders every pixel regardless of the lattice."""
        return self.caster.renders_all_pixels

    @property
    def held(self) -> tuple[AnyResidency]:
        return (self.residency,)

    @property
    def visible_cells(self) -> tuple[np.ndarray, int]:
        """As in ``Prepared``."""
        return self.caster.visible_cells

    def for_scene(self, resolved: ResolvedScene) -> MultiresolutionEngine:
        """As ``Prepared.for_scene``."""
        other = copy.copy(self)
        other.resolved = resolved
        other.caster = self.caster.for_scene(resolved)
        return other

    def ask(self, wait: bool | None = None, progress: Progress | None = None) -> None:
        """Requests the blocks of the scene's own view. ``wait`` None: as in the last request."""
        self.residency.ask(self.resolved, wait=wait, progress=progress)

    def set_transfer_function(self, function: TransferFunction, wait: bool = True) -> None:
        """Another transfer function: new tables, and the blocks that it needs. With ``wait`` False a
        thread reads these while frames are rendered from the blocks that are there.

        Only for an engine that is not shared: a ``PreparedCache`` finds engines by their transfer function, so it makes
        another one instead."""
        self.resolved = replace(self.resolved, transfer_function=function)
        self.ask(wait)
        self.caster.set_transfer_function(function)
        self._shown = self.residency.generation

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        """As ``Prepared.warm_up``."""
        self.caster.warm_up(width, height, depth)
        if self._tile_size:
            self._tiled().warm_up(depth)

    def warm_up_parts(self, width: int, height: int, depth: bool = True) -> None:
        """As ``RendersParts.warm_up_parts``."""
        if self._tile_size:
            self.warm_up(width, height, depth)
        else:
            self.caster.warm_up_parts(width, height, depth)

    def parts(
        self, camera: Camera, width: int, height: int, depth: bool = True, lattice: Pixels = EVERY_PIXEL
    ) -> PictureParts | None:
        """As ``RendersParts.parts``; None for pictures whose ray density is chosen per tile."""
        if self._tile_size and lattice == EVERY_PIXEL:
            return None
        self._make_resident(camera, width, height)
        parts = self.caster.parts(camera, width, height, depth, lattice)
        if parts is not None:
            parts.notes["blocks"] = self.residency.describe()
        return parts

    def warm_up_for_time(self, depth: bool = True) -> None:
        """As ``RefinesInTime.warm_up_for_time``."""
        self._tiled().warm_up(depth)

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:
        """As ``Prepared.render``."""
        self._make_resident(camera, width, height)
        if self._tile_size and lattice == EVERY_PIXEL:
            tiled = self._described(self._tiled().render(camera, width, height, progress, depth))
            if self.resolved.coherence.mode == "reproject":
                tiled.notes["coherence"] = refused(self.resolved, self.caster.switches)
            return tiled
        data = self.caster.render(camera, width, height, progress, depth, lattice)
        data.notes["blocks"] = self.residency.describe()
        if isinstance(self.residency, CodedResidency):
            data.notes["compression"] = self.residency.compression()
        return data

    def render_for_time(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        *,
        seconds: float,
    ) -> FrameData:
        """As ``RefinesInTime.render_for_time``: a picture in tiles."""
        start = perf_counter()
        self._make_resident(camera, width, height)
        left = max(seconds - (perf_counter() - start), 0.0)
        return self._described(self._tiled().render(camera, width, height, progress, depth, seconds=left))

    def render_on(
        self, prepared: Sequence[MultiresolutionEngine], camera: Camera, width: int, height: int,
        progress: Progress | None, depth: bool, on_loss: Callable[[int, BaseException], None],
        seconds: float | None = None, lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData | None:  # fmt: skip
        """As ``RendersOnSeveral.render_on``, for pictures whose ray density is chosen per tile."""
        if (not self._tile_size and seconds is None) or lattice != EVERY_PIXEL:
            return None
        start = perf_counter()
        self._make_resident(camera, width, height)

        def ready(device: int) -> None:
            prepared[device]._make_resident(camera, width, height)

        team = Team([each.context.name for each in prepared], SPEED, LAUNCH)
        casters = [each.caster for each in prepared]
        canvas = partial(SharedCanvas, casters, team, ready, on_loss)
        left = None if seconds is None else max(seconds - (perf_counter() - start), 0.0)
        try:
            return self._described(self._tiled(canvas).render(camera, width, height, progress, depth, seconds=left))
        finally:
            team.close()

    def _described(self, data: TiledFrameData) -> TiledFrameData:
        """``data`` with notes about its tiles and blocks."""
        tiles = {"share_of_pixels": data.share}
        if data.estimated_rmse is not None:
            tiles["estimated_rmse"] = data.estimated_rmse
        data.notes["tiles"] = tiles
        data.notes["blocks"] = self.residency.describe()
        return data

    @property
    def _tile_size(self) -> int:
        return self.resolved.multiresolution.tiles

    def _tiled(self, canvas: Callable[[np.ndarray, TileGrid, bool], Canvas] | None = None) -> TiledRenderer:
        settings = self.resolved.multiresolution
        if not settings.tiles:
            settings = settings.model_copy(update={"tiles": TILES})
        return TiledRenderer(self.caster, settings, canvas=canvas)

    def _make_resident(self, camera: Camera, width: int, height: int) -> None:
        image = self.resolved.image.model_copy(update={"width": width, "height": height})
        self.residency.ask(replace(self.resolved, camera=camera, image=image))
        if self._shown != self.residency.generation:
            self.caster.set_resident()
            self._shown = self.residency.generation
