"""The ray caster as an integrator: rays through a volume that is on the device as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from clvol.device.gradients import storing_switches
from clvol.device.light_volume import METHODS
from clvol.device.voxels import as_rendered
from clvol.encoding.coded_volume import UndecodedVolume
from clvol.features import GRADIENTS, reduced_for_frames
from clvol.features.minification import has_levels
from clvol.features.refuse import refuse_minification, refuse_quadrature
from clvol.integrators.base import Prepared, Progress, Shared
from clvol.integrators.raycast.bricks import BrickCaster
from clvol.integrators.raycast.caster import Raycaster, device_volume
from clvol.integrators.raycast.history import History, unsupported
from clvol.integrators.raycast.levels import LevelsCaster, levelled_volume
from clvol.integrators.raycast.reprojection import MARGIN
from clvol.integrators.raycast.step_map import is_smooth
from clvol.integrators.raycast.switches import raycast_switches
from clvol.integrators.resident_codes import brick_switches, bricks_for, check_resident
from clvol.integrators.whole_volume import WholeVolume
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume
from clvol.volume.level_layout import coarser_bytes
from clvol.volume.series import StepVolume

if TYPE_CHECKING:
    from clvol.scene import Scene

_HISTORIES = 6  # volumes


class Raycast(WholeVolume):
    """Samples along one ray per pixel, step by step or cell by cell, with all effects and all filters."""

    name = "raycast"
    tuned_as = "raycast"
    holds_codes = True

    def check(self, resolved: ResolvedScene) -> None:
        refuse_minification(resolved)
        refuse_quadrature(resolved)
        check_resident(resolved)

    def device_bytes(self, volume: Volume, scene: Scene | ResolvedScene) -> int:
        levels = coarser_bytes(volume) if has_levels(scene.integration) else 0
        return super().device_bytes(volume, scene) + levels

    def key(self, resolved: ResolvedScene) -> tuple[Any, ...]:
        return (resolved.compression.memory,) if isinstance(resolved.volume, UndecodedVolume) else ()

    def programs(self, resolved: ResolvedScene, lanes: int) -> Mapping[str, Mapping[str, int]]:
        resolved = as_rendered(resolved)
        switches = {**raycast_switches(resolved, lanes=lanes, varies=True), **brick_switches(resolved)}
        reprojects = resolved.coherence.mode == "reproject" and not unsupported(resolved, switches)
        programs = {"raycast.cl": {**switches, **({"COHERENT": 1} if reprojects else {})}}
        if reprojects:
            programs["reproject.cl"] = {"MARGIN": MARGIN}
        if resolved.image.ray_spacing > 1:
            programs["fill_between_rays.cl"] = switches
        if resolved.image.refines:
            programs["listed_rays.cl"] = switches
        if switches.get("SHADOWS") == METHODS["volume"]:
            programs["light_volume.cl"] = switches
        if switches.get("AMBIENT_OCCLUSION"):
            programs["occlusion_volume.cl"] = switches
        if switches.get("GRADIENT") == GRADIENTS["precomputed"]:
            programs["gradients.cl"] = storing_switches(switches, resolved.gradient.operator)
        return programs

    def sources(self, resolved: ResolvedScene) -> tuple[Sequence[str], bytes]:
        return ("*.h",), b""

    def simplified(self, resolved: ResolvedScene, shared: Shared) -> ResolvedScene:
        resolved = super().simplified(resolved, shared)
        if isinstance(resolved.volume, StepVolume):
            is_smooth(resolved)  # which looks at the widest step, before the one that is rendered is read
        return resolved

    def prepare(
        self, shared: Shared, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> Prepared:
        if (bricks := bricks_for(shared, resolved)) is not None:
            return BrickCaster(shared.context, resolved, bricks)
        if has_levels(reduced_for_frames(resolved).integration):
            return LevelsCaster(shared.context, resolved, levelled_volume(shared, resolved))
        history = shared.keep("history", resolved.volume, History, _HISTORIES)
        return Raycaster(shared.context, resolved, volume=device_volume(shared, resolved), history=history)


INTEGRATOR = Raycast()
