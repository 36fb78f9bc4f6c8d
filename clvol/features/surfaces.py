"""Iso-surfaces, and rays that bend at them."""

from __future__ import annotations

from clvol.features.effect import counted, joined, no, yes
from clvol.features.findings import NO_VALUES, NOTHING_VISIBLE, Findings, has_background
from clvol.features.values import range_text, reachable
from clvol.scene.isosurface import Isosurface


def analyse(found: Findings) -> None:
    asked, name, bending = found.scene.isosurfaces, "isosurfaces", "refraction"
    if not asked:
        found.note(no(name, "the scene has no isosurface"))
        found.note(no(bending, "the scene has no isosurface"))
        return
    # Nothing is seen behind an opaque surface, from whatever direction.
    kept = tuple(_unbent(s) if s.opacity == 1 else s for s in found.surfaces)
    found.surfaces = kept
    if found.projection:
        reason = f"{found.projection} shows no surfaces"
        found.note(no(name, reason), no(bending, reason))
    elif kept:
        found.note(yes(name, f"{counted(len(kept), 'iso-value')} inside the data's range"))
        _note_refraction(found, asked)
    else:
        reason = joined(_reason(surface, found) for surface in asked)
        found.note(no(name, reason), no(bending, reason))
    found.change(isosurfaces=kept)


def _note_refraction(found: Findings, asked: tuple[Isosurface, ...]) -> None:
    bending = [s for s in found.surfaces if s.refraction != 1]
    if bending:
        reason = f"{counted(len(bending), 'surface')} of another refraction than 1"
        found.note(yes("refraction", reason))
    elif all(s.refraction == 1 for s in asked):
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
