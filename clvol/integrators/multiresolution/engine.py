"""The method "multiresolution": selects and loads blocks, casts rays through them, tile by tile where asked."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

from clvol.device.view import EVERY_PIXEL, PixelLattice
from clvol.integrators.base import FrameData
from clvol.integrators.multiresolution.caster import BlockCaster
from clvol.integrators.multiresolution.residency import Residency
from clvol.integrators.tiles.tiled import TiledRenderer
from clvol.opencl.context import DeviceContext
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction

TILES = 16  # pixels an edge of the tiles of a picture for a given time, where the scene has none


def caster_of(resolved: ResolvedScene) -> type[BlockCaster]:
    """What renders the scene's stepping."""
    if resolved.multiresolution.stepping == "pyramid":
        from clvol.integrators.pyramid.blocks import BlockPyramidCaster

        return BlockPyramidCaster
    return BlockCaster


class MultiresolutionEngine:
    """An engine as ``Raycaster`` is one. ``residency`` may be shared: each frame asks for its own blocks.

    A frame waits for its blocks, so a picture is the same however long reading takes; but where ``wait`` is
    False frames show what is there until all has come, a thread reading the rest.
    """

    def __init__(
        self,
        context: DeviceContext,
        resolved: ResolvedScene,
        residency: Residency | None = None,
        progress: Callable[[int, int], None] | None = None,
        wait: bool | None = None,
    ) -> None:
        self.context, self.resolved = context, resolved
        self.residency = residency or Residency(context, resolved)
        self.ask(wait, progress)
        self._shown = self.residency.generation
        self.caster = caster_of(resolved)(context, resolved, self.residency.blocks)

    @property
    def visible_share(self) -> float:
        return self.caster.visible_share

    @property
    def renders_all_pixels(self) -> bool:
        """Whether it renders every pixel regardless of the lattice."""
        return self.caster.renders_all_pixels

    @property
    def held(self) -> tuple[Residency]:
        return (self.residency,)

    def for_scene(self, resolved: ResolvedScene) -> MultiresolutionEngine:
        """As ``Prepared.for_scene``."""
        other = copy.copy(self)
        other.resolved = resolved
        other.caster = self.caster.for_scene(resolved)
        return other

    def ask(
        self, wait: bool | None = None, progress: Callable[[int, int], None] | None = None
    ) -> None:
        """Asks for the blocks of the scene's own view. ``wait`` None: as was said last."""
        self.residency.ask(self.resolved, wait=wait, progress=progress)

    def set_transfer_function(self, function: TransferFunction, wait: bool = True) -> None:
        """Another transfer function: new tables, and the blocks that it wants. With ``wait`` False a
        thread reads these while frames are rendered from what is there.

        For an engine that nobody shares: ``PreparedCache`` keep theirs by their function, and make another one."""
        self.resolved = replace(self.resolved, transfer_function=function)
        self.ask(wait)
        self.caster.set_transfer_function(function)
        self._shown = self.residency.generation

    def warm_up(
        self, width: int, height: int, depth: bool = True, seconds: bool = False
    ) -> None:
        """As ``Raycaster.warm_up``. ``seconds``: pictures for a given time are to come."""
        if not seconds:
            self.caster.warm_up(width, height, depth)
        if self._tile_size or seconds:
            self._tiled().warm_up(depth)

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Callable[[int, int], None] | None = None,
        depth: bool = True,
        lattice: PixelLattice = EVERY_PIXEL,
        seconds: float | None = None,
    ) -> FrameData:
        """As ``Raycaster.render``. ``seconds``: of a picture in tiles, which is refined so long."""
        start = perf_counter()
        self._make_resident(camera, width, height)
        if (self._tile_size or seconds is not None) and lattice == EVERY_PIXEL:
            left = None if seconds is None else max(seconds - (perf_counter() - start), 0.0)
            data = self._tiled().render(camera, width, height, progress, depth, seconds=left)
            data.notes["tiles"] = {"share_of_pixels": data.share}
            if data.estimated_rmse is not None:
                data.notes["tiles"]["estimated_rmse"] = data.estimated_rmse
        else:
            data = self.caster.render(camera, width, height, progress, depth, lattice)
        data.notes["blocks"] = self.residency.describe()
        return data

    @property
    def _tile_size(self) -> int:
        return self.resolved.multiresolution.tiles

    def _tiled(self) -> TiledRenderer:
        settings = self.resolved.multiresolution
        if not settings.tiles:
            settings = settings.model_copy(update={"tiles": TILES})
        return TiledRenderer(self.caster, settings)

    def _make_resident(self, camera: Camera, width: int, height: int) -> None:
        image = self.resolved.image.model_copy(update={"width": width, "height": height})
        self.residency.ask(replace(self.resolved, camera=camera, image=image))
        if self._shown != self.residency.generation:
            self.caster.set_resident()
            self._shown = self.residency.generation
