"""The method "slicing" as an integrator: what drawing slices as textures shows, beside rays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clvol.device.voxels import as_rendered
from clvol.features.refuse import PLAIN, refuse_effects, refuse_keys
from clvol.integrators.base import Prepared, Progress, Shared
from clvol.integrators.raycast.caster import device_volume
from clvol.integrators.raycast.switches import raycast_switches
from clvol.integrators.slicing.caster import SlicingCaster, slicing_switches
from clvol.integrators.whole_volume import WholeVolume
from clvol.scene.resolve import ResolvedScene

_KEYS: dict[str, tuple[str, ...]] = {"quadrature": ("steps",), "compositing": ("over",)}
_EFFECTS = PLAIN | {"cubic filter", "catmull-rom filter", "prefilter", "colour cycling"}


class SlicingIntegrator(WholeVolume):
    """Planes of voxels, planes across the view or shells around the eye, one over the other."""

    name = "slicing"
    tuned_as = "raycast"

    def check(self, resolved: ResolvedScene) -> None:
        refuse_keys(resolved, _KEYS)
        refuse_effects(resolved, "integration.method", self.name, "raycast", _EFFECTS)

    def programs(self, resolved: ResolvedScene, lanes: int) -> Mapping[str, Mapping[str, int]]:
        resolved = as_rendered(resolved)
        switches = raycast_switches(resolved, lanes=lanes, skip=False) | slicing_switches(resolved.slicing)
        programs: dict[str, Mapping[str, int]] = {"raycast.cl": switches}
        if resolved.image.ray_spacing > 1:
            programs["fill_between_rays.cl"] = switches
        if resolved.image.refines:
            programs["listed_rays.cl"] = switches
        return programs

    def sources(self, resolved: ResolvedScene) -> tuple[Sequence[str], bytes]:
        return ("*.h",), b""

    def key(self, resolved: ResolvedScene) -> tuple[Any, ...]:
        return (resolved.slicing,)

    def prepare(
        self, shared: Shared, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> Prepared:
        return SlicingCaster(shared.context, resolved, volume=device_volume(shared, resolved))


INTEGRATOR = SlicingIntegrator()
