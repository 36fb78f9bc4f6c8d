"""Shadows, and light that scatters forward on its way."""

from __future__ import annotations

from clvol.features.effect import counted, no, yes
from clvol.features.findings import Findings
from clvol.scene.resolve import ResolvedScene


def analyse(found: Findings) -> None:
    scene = found.scene
    shadow = scene.shadow
    idle = _why_none(found)
    casting = [light for light in scene.lights if casts(light)]
    if idle is not None:
        found.note(no("shadows", idle), no("scattering", idle))
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


def casts(light) -> bool:
    return light.casts_shadow and light.type != "headlight"


def _why_none(found: Findings) -> str | None:
    scene: ResolvedScene = found.scene
    if scene.shadow is None:
        return "the scene has no shadow"
    if found.projection:
        return f"{found.projection} casts no shadows"
    if not found.by_lights:
        return "the shadowing light reaches nothing lit"
    if not any(casts(light) for light in scene.lights):
        return "no light that shines casts a shadow"
    if not scene.shadow.is_volume and scene.shadow.bound >= 1:
        return "no sample's opacity is above the bound 1"
    return None
