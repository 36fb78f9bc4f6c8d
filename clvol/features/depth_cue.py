"""Depth cueing."""

from __future__ import annotations

import math

import numpy as np

from clvol.features.effect import no, yes
from clvol.features.findings import NOTHING_VISIBLE, Findings
from clvol.scene.depth_cue import DepthCue, corner_distances
from clvol.scene.resolve import ResolvedScene


def analyse(found: Findings) -> None:
    cue, name = found.scene.depth_cue, "depth cueing"
    if cue is None:
        found.note(no(name, "the scene has no depth cue"))
        return
    reason = _idle(found, cue)
    if reason is None:
        found.note(yes(name, f"colours fade from {cue.start:g} to {cue.end:g} before the eye"))
        return
    found.note(no(name, reason))
    found.change(depth_cue=None)


def _idle(found: Findings, cue: DepthCue) -> str | None:
    if cue.strength == 0:
        return "the depth cue's strength is 0"
    if found.projection:
        return f"{found.projection} is not depth-cued"
    if found.blank:
        return NOTHING_VISIBLE
    if cue.start is not None and cue.start >= _farthest(found.scene):
        return f"the depth cue starts at {cue.start:g}, beyond the volume's farthest corner"
    return None


def _farthest(scene: ResolvedScene) -> float:
    """The longest distance along a ray to any point of the volume, from any camera of an orbit."""
    if any(surface.refraction != 1 for surface in scene.isosurfaces):
        return math.inf  # refracted rays may have any length
    if scene.animation.orbit_degrees == 0:
        return float(corner_distances(scene.camera, scene.volume.grid).max())
    camera, corners = scene.camera, scene.volume.grid.world_corners()
    target = np.asarray(camera.target)
    to_eye = np.linalg.norm(np.asarray(camera.position) - target)
    return float(to_eye + np.linalg.norm(corners - target, axis=1).max())
