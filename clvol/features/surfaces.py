"""Iso-surfaces, and the refraction of rays at them."""

from __future__ import annotations

from clvol.features.effect import counted, joined, no, yes
from clvol.features.findings import NO_VALUES, NOTHING_VISIBLE, Findings, has_background
from clvol.features.values import range_text, reachable
from clvol.scene.isosurface import Isosurface


def analyse(found: Findings) -> None:
    surfaces, name, bending = found.scene.isosurfaces, "isosurfaces", "refraction"
    if not surfaces:
        found.note(no(name, "the scene has no isosurface"))
        found.note(no(bending, "the scene has no isosurface"))
        return
    # Nothing behind an opaque surface is visible, so refraction has no consequence.
    kept = tuple(_unbent(s) if s.opacity == 1 else s for s in found.surfaces)
    found.surfaces = kept
    if found.projection:
        reason = f"{found.projection} shows no surfaces"
        found.note(no(name, reason), no(bending, reason))
    elif kept:
        found.note(yes(name, f"{counted(len(kept), 'iso-value')} inside the data's range"))
        _note_refraction(found, surfaces)
    else:
        reason = joined(_reason(surface, found) for surface in surfaces)
        found.note(no(name, reason), no(bending, reason))
    found.change(isosurfaces=kept)


def _note_refraction(found: Findings, surfaces: tuple[Isosurface, ...]) -> None:
    bending = [s for s in found.surfaces if s.refraction != 1]
    if bending:
        reason = f"{counted(len(bending), 'surface')} with a refraction other than 1"
        found.note(yes("refraction", reason))
    elif all(s.refraction == 1 for s in surfaces):
        found.note(no("refraction", "every isosurface's refraction is 1"))
    else:
        found.note(no("refraction", "every surface that would refract is opaque or not there"))


def _unbent(surface: Isosurface) -> Isosurface:
    if surface.refraction == 1:
        return surface
    return surface.model_copy(update={"refraction": 1.0})


def _reason(surface: Isosurface, found: Findings) -> str:
    if not found.has_values:
        return NO_VALUES
    low, high = reachable(found.scene)
    value = found.scene.axis.values(surface.value)
    if not low <= surface.value <= high:
        outside = f"outside the data's range {range_text(found.scene)}"
        return f"iso-value {value:g} lies {outside}"
    if surface.refraction != 1 and not has_background(found.scene):
        return NOTHING_VISIBLE
    return f"the isosurface at {value:g} is transparent"
