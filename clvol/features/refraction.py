"""Continuous refraction: rays that bend by the gradient of an index of refraction."""

from __future__ import annotations

from clvol.errors import SceneError
from clvol.features.effect import no, yes
from clvol.features.findings import NOTHING_VISIBLE, Findings, has_background, has_no_gradient
from clvol.features.values import reachable, shows
from clvol.scene.resolve import ResolvedScene

NAME = "continuous refraction"


def analyse(found: Findings) -> None:
    scene = found.scene
    index = scene.refraction
    idle = "the scene has no refraction"
    if index is not None:
        shape = index.shape
        if found.projection:
            idle = f"{found.projection} bends no rays"
        elif shape is None or not found.has_values or not shows(shape, *reachable(scene)):
            idle = "the index of refraction is the same for all values of the volume"
        elif has_no_gradient(scene):
            idle = "the volume has one value"
        elif found.blank and not has_background(scene):
            idle = NOTHING_VISIBLE
        else:
            found.note(yes(NAME, "the index of refraction changes with the value"))
            return
    found.note(no(NAME, idle))
    found.change(refraction=None)


def check_refraction(resolved: ResolvedScene) -> None:
    """SceneError for what rays that bend everywhere cannot be combined with."""
    if resolved.refraction is None or resolved.refraction.shape is None:
        return
    if resolved.isosurfaces and resolved.integration.compositing == "over":
        what = f"got {len(resolved.isosurfaces)} surfaces in a scene with [refraction]"
        raise SceneError(f"{resolved.origin}: isosurface", what, "no surfaces: they are found along straight rays")
