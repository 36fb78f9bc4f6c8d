"""What is compiled for the effects of a scene: the switches (-D) of cl/effects.h.

Everything here works on the *reduced* scene (clvol.features.reduced). Effects without a consequence have been removed
from it, so they are not compiled.
"""

from __future__ import annotations

from clvol.device.aimed_lights import has_aimed
from clvol.device.fields import field_switches
from clvol.device.gradients import gradient_switch
from clvol.device.light_volume import shadow_switches
from clvol.device.mesh_clips import mesh_switch
from clvol.device.noise import TARGETS
from clvol.device.occlusion_volume import occlusion_switch
from clvol.device.opacity_factors import factor_switches
from clvol.features import COMPOSITINGS, GRADIENTS, emits, is_lit
from clvol.features.gradient_storage import UNLIMITED, DeviceLimits
from clvol.features.opacity import has_gradient_layers
from clvol.scene.resolve import ResolvedScene


def effect_switches(
    resolved: ResolvedScene, limits: DeviceLimits | None = None
) -> dict[str, int]:
    """The switches (-D) of a reduced scene's effects; empty for a scene without effects.

    ``limits``: those of the device, which may be too small for precomputed gradients; None: no limits.
    """
    seen = resolved.environment is not None and resolved.environment.visible
    if resolved.integration.compositing != "over":
        return _projection_switches(resolved, seen)
    lit = is_lit(resolved)
    surfaces = resolved.isosurfaces
    refracts = any(surface.refraction != 1.0 for surface in surfaces)
    factors = resolved.gradient_opacity is not None or resolved.directional_opacity is not None or resolved.fur
    faces = bool(surfaces) and resolved.ambient_occlusion is not None
    ends = lit and resolved.material.light_at == "ends"
    curves = resolved.refraction is not None
    decides = bool(factors) or has_gradient_layers(resolved)
    switches = {
        "LIGHTING": int(lit),
        "LIGHTS": int(bool(resolved.lights)),
        **({"AIMED_LIGHTS": 1} if lit and has_aimed(resolved.lights) else {}),
        "SPECULAR": int(lit and resolved.material.specular > 0),
        "ISOSURFACES": int(bool(surfaces)),
        "REFRACTION": int(refracts),
        "CLIP": int(bool(resolved.clips)),
        "DEPTH_CUE": int(resolved.depth_cue is not None),
        "ENVIRONMENT": int(lit and resolved.environment is not None),
        "ENVIRONMENT_VISIBLE": int(seen),
        **factor_switches(resolved),
        **field_switches(resolved),
        "NOISE": _noise(resolved),
        **shadow_switches(resolved),
        **({"TINTED_SCATTERING": 1} if resolved.attenuation_noise else {}),
        **({"GLOW": 1} if resolved.glow is not None else {}),
        **({"CURVED_RAYS": 1} if curves else {}),
        **mesh_switch(resolved),
        **occlusion_switch(resolved),
        **({"LIT_AT_ENDS": 1} if ends else {}),
        "GRADIENT": _gradient(resolved, limits) if lit or refracts or decides or faces or curves else 0,
    }
    if not any(switches.values()):
        return {}
    # Opacities of whole segments are enough where no effect cuts segments or changes their extinction.
    changed = decides or surfaces or resolved.fields or resolved.integration.classification == "pre"
    changed = changed or resolved.glow is not None or curves or ends
    return {
        "EFFECTS": 1,
        "TRANSLUCENT": int(is_translucent(resolved)),
        "SEGMENT_OPACITIES": int(not changed),
        **switches,
    }


def _projection_switches(resolved: ResolvedScene, seen: bool) -> dict[str, int]:
    """The switches of a projection, which shows one value of each ray."""
    return {
        "EFFECTS": 1,
        "COMPOSITING": COMPOSITINGS[resolved.integration.compositing],
        "CLIP": int(bool(resolved.clips)),
        "ENVIRONMENT_VISIBLE": int(seen),
        "NOISE": _noise(resolved),
        **mesh_switch(resolved),
        **field_switches(resolved),
    }


def _noise(resolved: ResolvedScene) -> int:
    """NOISE_ADDS and NOISE_MOVES of cl/scene_value.h."""
    return sum(1 << TARGETS[target] for target in {term.target for term in resolved.noise})


def _gradient(resolved: ResolvedScene, limits: DeviceLimits | None) -> int:
    settings = resolved.gradient
    if resolved.noise:  # differences of noisy values, whatever the operator is
        return GRADIENTS["central"]
    limits = limits or UNLIMITED
    return gradient_switch(
        resolved.volume, resolved.integration.filter, settings.operator, settings.storage, limits
    )


def is_translucent(resolved: ResolvedScene) -> bool:
    """Whether anything other than surfaces is visible: the volume under its transfer function, or a field."""
    return emits(resolved) or any(field.role == "density" for field in resolved.fields)
