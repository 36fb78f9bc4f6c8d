"""The method "reference" as an integrator: the exact integral."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clvol.device.view import EVERY_PIXEL, PixelLattice, PixelList, Pixels
from clvol.features import effects, reduced
from clvol.features.refuse import PLAIN, refuse_effects
from clvol.integrators.base import FrameData, Prepared, Progress, Shared
from clvol.integrators.reference.picture import render_reference
from clvol.integrators.whole_volume import WholeVolume
from clvol.opencl.context import DeviceContext
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene

_EFFECTS = PLAIN | {"nearest filter", "cubic filter"}  # those that are integrated exactly


def has_exact_integral(resolved: ResolvedScene) -> bool:
    """Whether the reference integrates the scene: emission and absorption, and its filter."""
    return all(effect.name in _EFFECTS for effect in effects(resolved) if effect.called_for)


class Reference(WholeVolume):
    """The ground truth of emission and absorption: no steps, a tolerance."""

    name = "reference"
    tuned_as = "raycast"

    def check(self, resolved: ResolvedScene) -> None:
        refuse_effects(resolved, "integration.method", self.name, "raycast", _EFFECTS)

    def programs(self, resolved: ResolvedScene, lanes: int) -> Mapping[str, Mapping[str, int]]:
        return {}  # one source, with switches for the type of the voxels and the filter

    def sources(self, resolved: ResolvedScene) -> tuple[Sequence[str], bytes]:
        resolved = reduced(resolved)
        return ("reference*",), f"{resolved.volume.dtype.name} {resolved.integration.filter}".encode()

    def simplified(self, resolved: ResolvedScene, shared: Shared) -> ResolvedScene:
        return resolved

    def prepare(
        self, shared: Shared, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> Prepared:
        return PreparedReference(shared.context, resolved)


class PreparedReference:
    """Nothing is resident: the volume is sent with each picture."""

    renders_all_pixels = True
    visible_share = 1.0
    visible_cells = None
    held: Sequence[object] = ()

    def __init__(self, context: DeviceContext, resolved: ResolvedScene) -> None:
        self.context, self.resolved = context, resolved

    def for_scene(self, resolved: ResolvedScene) -> PreparedReference:
        return PreparedReference(self.context, resolved)

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        pass

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:
        return self._rendered(self.context.device, camera, width, height, progress, lattice, None)

    def render_on(
        self, prepared: Sequence[PreparedReference], camera: Camera, width: int, height: int, progress: Progress | None,
        depth: bool, on_loss: Callable[[int, BaseException], None], seconds: float | None = None,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:  # fmt: skip
        """As ``RendersOnSeveral.render_on``."""
        devices = [each.context.device for each in prepared]
        return self._rendered(devices, camera, width, height, progress, lattice, on_loss)

    def _rendered(
        self, devices: Any, camera: Camera, width: int, height: int, progress: Progress | None,
        lattice: Pixels, on_loss: Callable[[int, BaseException], None] | None,
    ) -> FrameData:  # fmt: skip
        image = self.resolved.image.model_copy(update={"width": width, "height": height})
        resolved = replace(self.resolved, camera=camera, image=image)
        tolerance = resolved.integration.tolerance
        pixels = None
        if isinstance(lattice, PixelList):
            pixels = np.stack([lattice.rows, lattice.columns], axis=1)
        elif lattice.alone:
            pixels = lattice.pixels(width, height)
        rgba, distances, counted = render_reference(resolved, devices, tolerance, pixels, progress, on_loss)
        if pixels is None:
            assert isinstance(lattice, PixelLattice)
            rgba, distances = rgba[lattice.slices], distances[lattice.slices]
        else:
            across, down = lattice.size(width, height)
            room = across * down - len(pixels)
            rgba = np.concatenate([rgba, np.zeros((room, 4))]).reshape(down, across, 4)
            distances = np.concatenate([distances, np.full(room, np.inf)]).reshape(down, across)
        notes = {name: value for name, value in counted.items() if name not in ("samples", "rays", "seconds")}
        return FrameData(rgba, distances, counted["samples"], counted["rays"], notes=notes)


INTEGRATOR = Reference()
