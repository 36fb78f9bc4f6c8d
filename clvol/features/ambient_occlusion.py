"""Ambient occlusion."""

from __future__ import annotations

from clvol.features.effect import no, yes
from clvol.features.findings import NOTHING_VISIBLE, Findings
from clvol.scene.ambient_occlusion import AmbientOcclusion

NAME = "ambient occlusion"


def analyse(found: Findings) -> None:
    table = found.scene.ambient_occlusion
    if table is None:
        found.note(no(NAME, "the scene has no ambient occlusion"))
        return
    reason = _idle(found, table)
    if reason is None:
        light = "all light" if table.darkens == "all" or not found.lit else "ambient light"
        found.note(yes(NAME, f"matter within {table.distance:g} takes a share of {light}"))
        return
    found.note(no(NAME, reason))
    found.change(ambient_occlusion=None)


def _idle(found: Findings, table: AmbientOcclusion) -> str | None:
    if table.intensity == 0:
        return "the ambient occlusion's intensity is 0"
    if found.projection:
        return f"{found.projection} is not lit"
    if not (found.emits or found.adds or any(surface.opacity > 0 for surface in found.surfaces)):
        return NOTHING_VISIBLE
    return None
