"""The ray caster as an integrator: rays through a volume that is on the device as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from clvol.device.gradients import storing_switches
from clvol.device.light_volume import METHODS
from clvol.device.memory import scene_bytes
from clvol.device.voxels import as_rendered
from clvol.features import GRADIENTS
from clvol.features.refuse import refuse_quadrature
from clvol.integrators.base import Prepared, Progress, Shared
from clvol.integrators.raycast.caster import Raycaster, device_volume
from clvol.integrators.raycast.switches import raycast_switches
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume

if TYPE_CHECKING:
    from clvol.scene import Scene


class Raycast:
    """Samples along one ray per pixel, step by step or cell by cell, with all effects and all filters."""

    name = "raycast"
    reads_blocks = False
    tuned_as = "raycast"

    def check(self, resolved: ResolvedScene) -> None:
        refuse_quadrature(resolved)

    def refines_in_time(self, scene: Scene | ResolvedScene) -> bool:
        return False

    def device_bytes(self, volume: Volume, scene: Scene | ResolvedScene) -> int:
        return scene_bytes(volume, scene.image.width, scene.image.height)

    def memory_advice(self, scene: Scene | ResolvedScene) -> tuple[str, str]:
        return "", ""

    def programs(self, resolved: ResolvedScene, lanes: int) -> Mapping[str, Mapping[str, int]]:
        resolved = as_rendered(resolved)
        switches = raycast_switches(resolved, lanes=lanes)
        programs = {"raycast.cl": switches}
        if resolved.image.ray_spacing > 1:
            programs["fill_between_rays.cl"] = switches
        if switches.get("SHADOWS") == METHODS["volume"]:
            programs["light_volume.cl"] = switches
        if switches.get("GRADIENT") == GRADIENTS["precomputed"]:
            programs["gradients.cl"] = storing_switches(switches, resolved.gradient.operator)
        return programs

    def sources(self, resolved: ResolvedScene) -> tuple[Sequence[str], bytes]:
        return ("*.h",), b""

    def key(self, resolved: ResolvedScene) -> tuple[Any, ...]:
        return ()

    def simplified(self, resolved: ResolvedScene, shared: Shared) -> ResolvedScene:
        return as_rendered(resolved, shared.keep)

    def prepare(
        self, shared: Shared, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> Prepared:
        volume = device_volume(shared, resolved)
        return Raycaster(shared.context, resolved, volume=volume)

    def ask_again(self, prepared: Any, progress: Progress | None, wait: bool | None) -> None:
        pass


INTEGRATOR = Raycast()
