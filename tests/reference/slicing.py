"""Slices of a volume, one over the other: the method "slicing" in world coordinates and double precision."""

from __future__ import annotations

import numpy as np

from reference import classify
from reference.clip import kept_stretches
from reference.medium import Medium

_NEARLY = 1e-4  # of the slices' distance: a ray meets the slice that lies in the face it enters through


def render_slices_twin(resolved) -> np.ndarray:
    """The picture of ``resolved``, premultiplied linear RGBA, float64 [height, width, 4]."""
    camera, settings, grid = resolved.camera, resolved.slicing, resolved.volume.grid
    origin, direction = camera.world_rays(resolved.image.width, resolved.image.height)
    shape = origin.shape[:-1]
    origin, direction = origin.reshape(-1, 3), direction.reshape(-1, 3)
    kept = kept_stretches(grid, (), origin, direction)
    enter, leave = kept.enter[:, 0], kept.leave[:, 0]
    if settings.geometry.startswith("object-aligned"):
        places, apart = _planes_of_voxels(resolved, origin, direction)
    elif settings.geometry == "view-aligned" or camera.projection == "orthographic":
        places, apart = _planes_of_view(resolved, origin, direction)
    else:
        places, apart = _shells(resolved)
        places = np.broadcast_to(places, (len(origin), places.size))
    medium, rgba = Medium(resolved), np.zeros((len(origin), 4))
    for ray in np.nonzero(np.isfinite(enter))[0]:
        at = np.sort(places[ray])
        gap = at[1] - at[0] if at.size > 1 else 0.0
        at = at[(at >= enter[ray] - _NEARLY * gap) & (at <= leave[ray] + _NEARLY * gap)]
        if not at.size:
            continue
        at = np.clip(at, enter[ray], leave[ray])
        points = origin[ray] + at[:, None] * direction[ray]
        rgba[ray] = _composited(resolved, medium, points, gap if settings.opacity_correction else apart)
    return rgba.reshape(*shape, 4)


def _planes_of_voxels(resolved, origin, direction):
    """Where rays meet the planes of the stack that faces the view: world lengths [rays, planes], and the world distance
    of the planes."""
    grid, settings = resolved.volume.grid, resolved.slicing
    step = resolved.integration.step * grid.smallest_edge
    lower, upper = grid.index_bounds()
    facing = np.abs(np.asarray(resolved.camera.basis()[0]) @ grid.direction)
    axis = int(np.argmax(facing))
    low, high, edge = lower[axis], upper[axis], grid.spacing[axis]
    if settings.geometry == "object-aligned":
        planes = int(round(high - low)) + 1
        every = 1 if settings.slices is None else max(1, int(np.ceil((planes - 1) / (settings.slices - 1))))
        count = (planes - 1) // every + 1
        index = low + (planes - 1 - every * (count - 1)) // 2 + every * np.arange(count)
        apart = every * edge
    else:
        count = int((high - low) * edge / step) + 1 if settings.slices is None else settings.slices
        apart = step if settings.slices is None else (high - low) * edge / (count - 1)
        index = 0.5 * (low + high) + (np.arange(count) - 0.5 * (count - 1)) * apart / edge
    to_index = grid.world_to_index()
    start = origin @ to_index[axis, :3] + to_index[axis, 3]
    return (index - start[:, None]) / (direction @ to_index[axis, :3])[:, None], apart


def _planes_of_view(resolved, origin, direction):
    forward = np.asarray(resolved.camera.basis()[0])
    depths = (resolved.volume.grid.world_corners() - np.asarray(resolved.camera.position)) @ forward
    first = depths.min() if resolved.camera.projection == "orthographic" else max(depths.min(), 0.0)
    places, apart = _spread(resolved, first, depths.max())
    start = (origin - np.asarray(resolved.camera.position)) @ forward
    return (places - start[:, None]) / (direction @ forward)[:, None], apart


def _shells(resolved):
    eye, forward = np.asarray(resolved.camera.position), np.asarray(resolved.camera.basis()[0])
    away = resolved.volume.grid.world_corners() - eye
    return _spread(resolved, max((away @ forward).min(), 0.0), np.linalg.norm(away, axis=1).max())


def _spread(resolved, first: float, last: float) -> tuple[np.ndarray, float]:
    """Slices from ``first`` to ``last``, and their distance: the middles of equal parts, or their ends."""
    ends, slices = resolved.integration.classification == "preintegrated", resolved.slicing.slices
    if slices is None:
        apart = resolved.integration.step * resolved.volume.grid.smallest_edge
        slices = int(np.ceil((last - first) / apart)) + 1
    else:
        apart = (last - first) / (slices - 1 if ends else slices)
    return first + (np.arange(slices) + (0.0 if ends else 0.5)) * apart, apart


def _composited(resolved, medium, points, thickness) -> np.ndarray:
    """Premultiplied RGBA [4] of a ray's slices at ``points`` [n, 3], front first."""
    (function,) = medium.functions
    length = np.full(len(points), thickness)
    if medium.classification == "preintegrated":
        value = medium.value(points)
        color, depth = classify.of_chord(function, value[:-1], value[1:], length[1:])
    elif medium.classification == "post":
        color, depth = classify.of_value(function, medium.value(points), length)
    else:
        color, depth = classify.of_voxels(function, *medium.field.value.taps(points), length)
    rgba = np.zeros(4)
    for c, d in zip(color, depth):
        a = -np.expm1(-d)
        rgba = rounded(rgba + (1.0 - rgba[3]) * np.append(c * a, a), resolved.slicing.accumulate)
        if rgba[3] >= 1.0 - resolved.integration.early_termination:
            break
    return rgba


def rounded(rgba: np.ndarray, accumulate: str) -> np.ndarray:
    """Channels as a frame buffer of that precision holds them."""
    if accumulate == "half":
        return rgba.astype(np.float16).astype(np.float64)
    if accumulate == "uint8":
        return np.round(np.minimum(rgba, 1.0) * 255.0) / 255.0
    return rgba
