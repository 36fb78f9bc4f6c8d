"""Shadows, and forward scattering."""

from __future__ import annotations

from clvol.features.effect import counted, no, yes
from clvol.features.findings import Findings
from clvol.scene.light import Light
from clvol.scene.shadow import Shadow

TINT = "attenuation noise"


def analyse(found: Findings) -> None:
    scene = found.scene
    shadow = scene.shadow
    idle = "the scene has no shadow" if shadow is None else _why_none(found, shadow)
    casting = [light for light in scene.lights if casts(light)]
    if shadow is None or idle is not None:
        reason = idle or ""
        found.note(no("shadows", reason), no("scattering", reason))
        found.change(shadow=None)
        _note_tint(found, None)
        return
    found.note(yes("shadows", f"{counted(len(casting), 'light')} with shadows"))
    if shadow.scattering == 0:
        found.note(no("scattering", "scattering is 0"))
    elif shadow.cone_degrees == 0 and not any(shadow.scatter_color) and not found.scene.attenuation_noise:
        found.note(no("scattering", "the cone is 0 and nothing of it is scattered"))
        found.change(shadow=shadow.model_copy(update={"scattering": 0.0}))
    else:
        found.note(yes("scattering", f"scattering is {shadow.scattering:g}"))
    _note_tint(found, found.scene.shadow)


def _note_tint(found: Findings, shadow: Shadow | None) -> None:
    """Whether noise changes what attenuates scattered light; ``shadow``: of the reduced scene."""
    noises = tuple(noise for noise in found.scene.attenuation_noise if noise.amplitude != 0)
    if noises and shadow is not None and shadow.scattering > 0:
        found.note(yes(TINT, f"noise of amplitude {max(abs(n.amplitude) for n in noises):g} tints scattered light"))
        found.change(attenuation_noise=noises)
        return
    reason = "the scene has no noise of attenuation"
    if found.scene.attenuation_noise:
        reason = "no light is scattered" if noises else "the noise's amplitude is 0"
    found.note(no(TINT, reason))
    found.change(attenuation_noise=())


def casts(light: Light) -> bool:
    return light.casts_shadow and light.type != "headlight"


def _why_none(found: Findings, shadow: Shadow) -> str | None:
    if found.projection:
        return f"{found.projection} casts no shadows"
    if not found.by_lights:
        return "the shadowing light reaches nothing lit"
    if not any(casts(light) for light in found.scene.lights):
        return "no light that shines casts a shadow"
    if not shadow.is_volume and shadow.bound >= 1:
        return "no sample's opacity is above the bound 1"
    return None
