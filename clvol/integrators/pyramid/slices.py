"""The spacing of a view's slices and rays: arithmetic, without a device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.device.view import picture_height, ray_frame
from clvol.scene.camera import Camera
from clvol.scene.pyramid import MOST_LEVELS
from clvol.scene.resolve import ResolvedScene


@dataclass(frozen=True)
class SlicePlan:
    """``levels`` of coarsening along rays, and ``oversampling`` additional levels across them, where rays are
    2^oversampling times closer together than slices. ``spacing``: distance of neighbouring rays at slice 0, in
    smallest edges, and its ``growth`` from one slice to the next."""

    levels: int
    oversampling: int
    spacing: float
    growth: float

    @classmethod
    def nowhere(cls, levels: int) -> SlicePlan:
        """The plan of a picture without pixels."""
        return cls(levels, 0, 1.0, 0.0)


def slice_plan(resolved: ResolvedScene, camera: Camera, width: int, height: int) -> SlicePlan:
    """The plan for the picture of ``camera`` (complete), from rays and slices in the middle of the volume."""
    grid, step = resolved.volume.grid, resolved.integration.step
    frame = ray_frame(camera, grid, width, height)
    if camera.projection == "orthographic":
        spacing, growth = picture_height(camera) / height / grid.smallest_edge, 0.0
        there = spacing
    else:
        growth = frame.lens[0] * step
        spacing = frame.lens[0] * frame.distance
        corners = grid.world_corners()
        away = np.linalg.norm(corners.mean(axis=0) - np.asarray(camera.position, np.float64))
        there = frame.lens[0] * away / grid.smallest_edge
    levels = resolved.pyramid.levels
    nearer = np.log2(step / there) if there > 0 else np.inf
    most = MOST_LEVELS - levels
    oversampling = int(np.clip(np.rint(np.clip(nearer, -99, 99)), 0, most))
    return SlicePlan(levels, oversampling, float(spacing), float(growth))
