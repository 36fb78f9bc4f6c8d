"""Pictures whose samples come from levels of the volume (cl/volume_levels.h).

What is empty, and how far rays step, depends on the levels that a picture takes. There is a ``Raycaster`` for each
range of them, and all share the volume. A step is that of the scene, in voxels of the picture's finest level.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clvol.device.footprint import footprint_of, levels_seen
from clvol.device.levels import LevelledVolume, SeenLevels
from clvol.device.view import EVERY_PIXEL, PixelLattice, PixelList, Pixels, ray_frame
from clvol.integrators.base import FrameData, Progress, Shared
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.picture import PictureParts
from clvol.opencl.context import DeviceContext
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene

_KEPT = 6  # volumes
_MOST_RANGES = 8


def levelled_volume(shared: Shared, resolved: ResolvedScene) -> LevelledVolume:
    """The scene's volume and its levels on the device, shared by all scenes of that volume."""
    context, volume = shared.context, resolved.volume
    return shared.keep("levels", volume, lambda: LevelledVolume(context, volume), _KEPT)


class LevelsCaster:
    """A scene with integration.minification "levels" on a device (a ``Prepared``, and ``RendersParts``). ``how``: keys
    of ``Raycaster``."""

    held: Sequence[object] = ()
    renders_all_pixels = False

    def __init__(
        self, context: DeviceContext, resolved: ResolvedScene, volume: LevelledVolume, **how: Any
    ) -> None:
        self._context, self._resolved, self._how = context, resolved, how
        self.volume = volume
        self._casters: dict[tuple[int, int], Raycaster] = {}

    @property
    def resolved(self) -> ResolvedScene:
        return self._resolved

    @property
    def visible_share(self) -> float:
        return self._of_scene.visible_share

    @property
    def visible_cells(self) -> tuple[np.ndarray, int] | None:
        return self._of_scene.visible_cells

    def for_scene(self, resolved: ResolvedScene) -> LevelsCaster:
        """As ``Prepared.for_scene``."""
        other = copy.copy(self)
        other._resolved = resolved
        other._casters = {
            levels: caster.for_scene(_in_steps_of(resolved, levels[0]))
            for levels, caster in self._casters.items()
        }
        return other

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        self._of_scene.warm_up(width, height, depth)

    def warm_up_parts(self, width: int, height: int, depth: bool = True) -> None:
        """As ``RendersParts.warm_up_parts``."""
        self._of_scene.warm_up_parts(width, height, depth)

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:
        """As ``Prepared.render``; the notes have the levels that were taken, and the step in edges of the smallest
        voxel."""
        caster = self.caster_of(camera, width, height, lattice)
        data = caster.render(camera, width, height, progress, depth, lattice)
        data.notes["minification"] = _described(caster)
        return data

    def parts(
        self, camera: Camera, width: int, height: int, depth: bool = True, lattice: Pixels = EVERY_PIXEL
    ) -> PictureParts | None:
        """As ``RendersParts.parts``."""
        caster = self.caster_of(camera, width, height, lattice)
        parts = caster.parts(camera, width, height, depth, lattice)
        if parts is not None:
            parts.notes["minification"] = _described(caster)
        return parts

    def caster_of(self, camera: Camera, width: int, height: int, lattice: Pixels = EVERY_PIXEL) -> Raycaster:
        """What renders such a picture."""
        levels = levels_of_picture(self._resolved, camera, (width, height), lattice)
        if levels not in self._casters:
            while len(self._casters) >= _MOST_RANGES:
                del self._casters[next(iter(self._casters))]
            scene, seen = _in_steps_of(self._resolved, levels[0]), SeenLevels(self.volume, *levels)
            self._casters[levels] = Raycaster(self._context, scene, volume=seen, **self._how)
        return self._casters[levels]

    @property
    def _of_scene(self) -> Raycaster:
        """What renders the scene's own picture."""
        image = self._resolved.image
        return self.caster_of(self._resolved.camera, image.width, image.height)


def levels_of_picture(
    resolved: ResolvedScene, camera: Camera, size: tuple[int, int], lattice: Pixels = EVERY_PIXEL
) -> tuple[int, int]:
    """The finest and the coarsest level that a picture of ``size`` pixels (width, height) takes."""
    volume = resolved.volume
    of_rays = PixelLattice(covers=lattice.covers) if isinstance(lattice, PixelList) else lattice
    frame = ray_frame(camera, volume.grid, *size, of_rays)
    return levels_seen(footprint_of(frame, volume, resolved.integration.level_bias), volume)


def _in_steps_of(resolved: ResolvedScene, level: int) -> ResolvedScene:
    """The scene with steps in voxels of ``level``."""
    integration = resolved.integration
    step = integration.step * 2.0**level
    return replace(resolved, integration=integration.model_copy(update={"step": step}))


def _described(caster: Raycaster) -> dict[str, object]:
    volume = caster.volume
    assert isinstance(volume, SeenLevels)
    return {"levels": [volume.first, volume.last], "step": caster.resolved.integration.step}
