"""The method "slicing" as an integrator: what drawing slices as textures shows, beside rays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clvol.device.effect_switches import effect_switches
from clvol.device.gradients import storing_switches
from clvol.device.light_volume import METHODS
from clvol.device.voxels import as_rendered
from clvol.errors import SceneError
from clvol.features import GRADIENTS, reduced
from clvol.features.refuse import PLAIN, refuse_effects, refuse_keys
from clvol.integrators.base import Prepared, Progress, Shared
from clvol.integrators.raycast.caster import device_volume
from clvol.integrators.raycast.switches import raycast_switches
from clvol.integrators.slicing.caster import SlicingCaster, slicing_switches
from clvol.integrators.slicing.half_angle import check_lights
from clvol.integrators.slicing.half_angle_caster import HalfAngleCaster, half_angle_switches
from clvol.integrators.whole_volume import WholeVolume
from clvol.scene.resolve import ResolvedScene

_KEYS: dict[str, tuple[str, ...]] = {"quadrature": ("steps",), "compositing": ("over",)}
_EFFECTS = PLAIN | {"cubic filter", "catmull-rom filter", "prefilter", "colour cycling"}
_LIT_EFFECTS = _EFFECTS | {
    "lighting", "specular", "spot lights", "image lights", "environment", "shadows", "scattering",
    "half-angle slices", "gradients", "sobel gradients", "precomputed gradients", "noise", "clipping", "depth cueing",
}  # fmt: skip


class SlicingIntegrator(WholeVolume):
    """Planes of voxels, planes across the view, shells around the eye or planes half way between light and view, one
    over the other."""

    name = "slicing"
    tuned_as = "raycast"

    def check(self, resolved: ResolvedScene) -> None:
        refuse_keys(resolved, _KEYS)
        if resolved.slicing.is_half_angle:
            refuse_effects(resolved, "integration.method", self.name, "raycast", _LIT_EFFECTS)
            _check_half_angle(reduced(resolved))
        else:
            refuse_effects(resolved, "integration.method", self.name, "raycast", _EFFECTS)

    def programs(self, resolved: ResolvedScene, lanes: int) -> Mapping[str, Mapping[str, int]]:
        resolved = as_rendered(resolved)
        lit = _has_effects(resolved)
        own = half_angle_switches() if lit else slicing_switches(resolved.slicing)
        switches = raycast_switches(resolved, lanes=lanes, skip=lit) | own
        programs: dict[str, Mapping[str, int]] = {"raycast.cl": switches}
        if switches.get("SHADOWS") == METHODS["half-angle"]:
            programs["light_slices.cl"] = switches
        if switches.get("GRADIENT") == GRADIENTS["precomputed"]:
            programs["gradients.cl"] = storing_switches(switches, resolved.gradient.operator)
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
        caster = HalfAngleCaster if _has_effects(as_rendered(resolved)) else SlicingCaster
        return caster(shared.context, resolved, volume=device_volume(shared, resolved))


def _has_effects(resolved: ResolvedScene) -> bool:
    """Whether the scene, which is reduced, needs more than emission and absorption."""
    return resolved.slicing.is_half_angle and bool(effect_switches(resolved))


def _check_half_angle(resolved: ResolvedScene) -> None:
    """SceneError for settings that half-angle slices do not have. ``resolved``: reduced."""
    where, settings = f"{resolved.origin}: slicing", resolved.slicing
    if settings.accumulate != "float32":
        what = f"got {settings.accumulate!r} with the geometry 'half-angle'"
        raise SceneError(f"{where}.accumulate", what, "'float32', or another geometry")
    if not settings.opacity_correction:
        raise SceneError(f"{where}.opacity_correction", "got false with the geometry 'half-angle'", "true")
    if resolved.shadow is not None and resolved.shadow.method == "rays":
        what = "got 'rays' with slices of the geometry 'half-angle'"
        raise SceneError(f"{resolved.origin}: shadow.method", what, "'volume': the light is kept in slices")
    check_lights(resolved)


INTEGRATOR = SlicingIntegrator()
