"""Where a view's slices lie: arithmetic, without a device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.device.view import ray_frame
from clvol.errors import RenderError
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.scene.slicing import MOST_SLICES


@dataclass(frozen=True)
class SlicePlaces:
    """Slice k is at ``first`` + k ``spacing``, k = 0 .. ``count`` - 1. Along a view these are in steps behind the plane
    that touches the volume from the front; along ``axis`` (0, 1, 2 for x, y, z) of the voxels, lattice coordinates.
    ``thickness``: steps between neighbours, seen from the front."""

    first: float
    spacing: float
    thickness: float
    count: int
    axis: int = 0


def slice_places(resolved: ResolvedScene, camera: Camera, size: tuple[int, int, int]) -> SlicePlaces:
    """The slices of a volume of ``size`` lattice points (x, y, z) for ``camera`` (complete). RenderError where they are
    more than 2^20."""
    if resolved.slicing.geometry.startswith("object-aligned"):
        places = _along_axis(resolved, camera, size)
    else:
        places = _along_view(resolved, camera)
    if places.count > MOST_SLICES:
        what = f"{places.count} slices by the method 'slicing'"
        raise RenderError(f"{resolved.origin}: integration.step", what, f"at most {MOST_SLICES}: longer steps")
    return places


def facing_axis(resolved: ResolvedScene, camera: Camera) -> int:
    """The axis of the voxels (0, 1, 2 for x, y, z) whose stack of slices faces the view most."""
    forward = np.asarray(camera.basis()[0]) @ resolved.volume.grid.direction
    return int(np.argmax(np.abs(forward)))


def _along_axis(resolved: ResolvedScene, camera: Camera, size: tuple[int, int, int]) -> SlicePlaces:
    grid, step, slices = resolved.volume.grid, resolved.integration.step, resolved.slicing.slices
    axis = facing_axis(resolved, camera)
    edge, last = float(grid.spacing[axis]) / grid.smallest_edge, size[axis] - 1
    if resolved.slicing.geometry == "object-aligned":  # some of the planes of voxels, evenly
        every = 1 if slices is None else max(1, -(-last // (slices - 1)))
        count = last // every + 1
        first, spacing = float((last - every * (count - 1)) // 2), float(every)
    else:
        count = int(np.floor(last * edge / step)) + 1 if slices is None else slices
        spacing = step / edge if slices is None else last / (slices - 1)
        first = 0.5 * (last - spacing * (count - 1))
    return SlicePlaces(first, spacing, spacing * edge / step, count, axis)


def _along_view(resolved: ResolvedScene, camera: Camera) -> SlicePlaces:
    step, slices = resolved.integration.step, resolved.slicing.slices
    extent = _extent(resolved, camera) / step
    bounds = resolved.integration.classification == "preintegrated"  # slices are the ends of slabs, not their middles
    if slices is None:
        spacing, count = 1.0, int(np.ceil(min(extent, 2.0 * MOST_SLICES))) + 1
    else:
        spacing, count = extent / (slices - 1 if bounds else slices), slices
    return SlicePlaces(0.0 if bounds else 0.5 * spacing, spacing, spacing, count)


def _extent(resolved: ResolvedScene, camera: Camera) -> float:
    """How far the volume reaches behind the plane that touches it from the front, in smallest edges; of shells, behind
    the sphere that touches that plane."""
    grid = resolved.volume.grid
    eye, forward = np.asarray(camera.position, np.float64), np.asarray(camera.basis()[0])
    away = grid.world_corners() - eye
    if resolved.slicing.geometry == "shells" and camera.projection != "orthographic":
        frame = ray_frame(camera, grid, 1, 1)
        far = np.linalg.norm(away, axis=1).max() / grid.smallest_edge - frame.distance
    else:
        depths = away @ forward
        nearest = depths.min() if camera.projection == "orthographic" else max(depths.min(), 0.0)
        far = (depths.max() - nearest) / grid.smallest_edge
    return max(float(far), 1e-6)
