"""Shadows, and forward scattering."""

from __future__ import annotations

from clvol.features.effect import counted, no, yes
from clvol.features.findings import Findings
from clvol.scene.light import Light
from clvol.scene.shadow import Shadow


def analyse(found: Findings) -> None:
    scene = found.scene
    shadow = scene.shadow
    idle = "the scene has no shadow" if shadow is None else _why_none(found, shadow)
    casting = [light for light in scene.lights if casts(light)]
    if shadow is None or idle is not None:
        reason = idle or ""
        found.note(no("shadows", reason), no("scattering", reason))
        found.change(shadow=None)
        return
    found.note(yes("shadows", f"{counted(len(casting), 'light')} with shadows"))
    if shadow.scattering == 0:
        found.note(no("scattering", "scattering is 0"))
    elif shadow.cone_degrees == 0 and not any(shadow.scatter_color):
        found.note(no("scattering", "the cone is 0 and nothing of it is scattered"))
        found.change(shadow=shadow.model_copy(update={"scattering": 0.0}))
    else:
        found.note(yes("scattering", f"scattering is {shadow.scattering:g}"))


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
