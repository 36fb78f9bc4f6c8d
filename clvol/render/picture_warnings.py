"""Warnings about pictures that can hardly be intended: almost blank ones, and boxes. They say why, and what to set.

Of most pictures a few thousand pixels are checked, and all pixels where those show nothing.
"""

from __future__ import annotations

import numpy as np

from clvol.errors import ClvolWarning
from clvol.features import emits
from clvol.features.scene_warnings import BLANK, largest_depth
from clvol.scene.camera import Camera
from clvol.scene.clip import Clip, MeshClip
from clvol.scene.resolve import ResolvedScene, default_opacity_unit
from clvol.volume import Grid

_PIXELS = 64  # per axis, checked first
_RAYS, _FEW = 24, 7  # rays per axis that are followed
_POINTS = 24  # per axis of the volume, for which clips are checked
_OPAQUE = 0.99
_ENTRY = 0.6  # steps, or smallest voxel edges where steps are shorter: a ray that is opaque by then is opaque at the face
_THIN = 4.0  # smallest voxel edges: shorter paths through the volume count as its rim
_SMALLEST = 24  # voxels per axis: smaller volumes may well be solid bodies


def picture_warning(
    resolved: ResolvedScene, camera: Camera, rgba: np.ndarray, depth: np.ndarray | None
) -> ClvolWarning | None:
    """The warning about a picture [height, width] of ``resolved`` from ``camera`` that has no other warning."""
    alpha = rgba[..., 3]
    if resolved.glow is not None and rgba[..., :3].max(initial=0.0) >= BLANK:
        return None
    spacing = [max(1, n // _PIXELS) for n in alpha.shape]
    some = alpha[:: spacing[0], :: spacing[1]].copy()  # read once: every pixel of them is in a cache line of its own
    if some.max(initial=0.0) < BLANK:
        environment = resolved.environment
        seen = environment is not None and environment.visible and environment.intensity > 0
        largest = float(alpha.max(initial=0.0))
        return None if seen or largest >= BLANK else _blank(resolved, camera, alpha.shape, largest)
    shown = np.count_nonzero(some >= BLANK)
    if shown < 0.01 * some.size or shown - np.count_nonzero(some >= _OPAQUE) > 0.05 * shown:
        return None
    return _box(resolved, camera, alpha, depth)


def _blank(
    resolved: ResolvedScene, camera: Camera, shape: tuple[int, int], largest: float
) -> ClvolWarning:
    what = "is blank: " + (f"its opacity is at most {100 * largest:.2g} %" if largest else "nothing is visible")
    grid = resolved.volume.grid
    rays = camera.world_rays_at(*shape[::-1], *_lattice(shape, _RAYS))
    near, far = _through(grid, *rays)
    if not (far > near).any():
        what += ", since no ray (or hardly any) meets the volume"
        return ClvolWarning("camera", f"the picture {what}", "set camera.target to a point in the volume, or move nearer")
    if resolved.clips and not _anything_kept(grid, resolved.clips):
        return ClvolWarning("clip", f"the picture {what}, since the clips together leave nothing", "leave one of them out")
    function, unit = resolved.transfer_function, resolved.transfer_function.opacity_unit
    if emits(resolved) and resolved.integration.compositing == "over" and largest_depth(resolved) < 0.1:
        what += f", since opacities are for a length of {unit:g}, and the volume is small compared to that"
        advice = f"set transfer_function.opacity_unit to about {default_opacity_unit(grid):.3g}"
        return ClvolWarning("transfer_function.opacity_unit", f"the picture {what}", advice)
    if any(field.role == "mask" for field in resolved.fields):
        advice = "check field.threshold, field.keep and transfer_function.points"
        return ClvolWarning("field", f"the picture {what}, since the masks leave nothing of the volume", advice)
    low, high = resolved.data_range
    visible = function.values[function.opacities > 0]
    if visible.size:
        what += f", since hardly any voxel in view has a visible value (about {visible[0]:g} to {visible[-1]:g})"
    what += f"; voxels lie between {low:g} and {high:g}"
    return ClvolWarning(
        "transfer_function", f"the picture {what}", "set other values or larger opacities in transfer_function.points"
    )


def _box(
    resolved: ResolvedScene, camera: Camera, alpha: np.ndarray, depth: np.ndarray | None
) -> ClvolWarning | None:
    """The warning about a volume that is opaque wherever rays enter it, so that only its faces are visible."""
    grid, (low, high) = resolved.volume.grid, resolved.data_range
    plain = not (resolved.isosurfaces or resolved.clips or resolved.fields)
    if low == high or not plain or min(grid.shape) < _SMALLEST or resolved.integration.compositing != "over":
        return None
    height, width = alpha.shape
    for count in (_FEW, _RAYS):  # around most opaque bodies a few rays already find empty space
        rows, columns = _lattice((height, width), count)
        near, far = _through(grid, *camera.world_rays_at(width, height, rows, columns))
        covered = far - near > _THIN * grid.smallest_edge
        if (alpha[np.ix_(rows, columns)][covered] < _OPAQUE).any():
            return None
    if covered.sum() < 9:
        return None
    if depth is not None:
        entry = _ENTRY * max(resolved.integration.step, 1.0) * grid.smallest_edge
        opaque = depth[np.ix_(rows, columns)] - near <= entry
        share = opaque[covered].mean()
    else:
        share = _opaque_share_of_faces(resolved)
    if share < 0.999:
        return None
    what = "every ray is opaque where it enters the volume: nothing but the faces of a box is visible"
    function = resolved.transfer_function
    outside = f"values that are to be invisible (of {low:g} to {high:g})"
    if function.opacities.max() < 1 and _depth_of_voxel(resolved, float(function.opacities.max())) > 20:
        unit = default_opacity_unit(grid)
        advice = f"set transfer_function.opacity_unit to about {unit:.3g}, or opacity 0 at {outside}"
    else:
        advice = f"set opacity 0 at {outside} in transfer_function.points"
    return ClvolWarning("transfer_function", what, advice)


def _depth_of_voxel(resolved: ResolvedScene, opacity: np.ndarray | float) -> np.ndarray:
    with np.errstate(divide="ignore"):
        tau = -np.log1p(-np.asarray(opacity)) / resolved.transfer_function.opacity_unit
    return tau * resolved.volume.grid.smallest_edge


def _opaque_share_of_faces(resolved: ResolvedScene) -> float:
    """The share of opaque voxels among some in the volume's faces; 0 where voxels are not in memory."""
    volume = resolved.volume
    if "data" not in vars(volume):
        return 0.0
    data = volume.data
    steps = [slice(None, None, max(1, n // _PIXELS)) for n in data.shape]
    faces = []
    for axis in range(3):
        for end in (0, -1):
            position: list[slice | int] = list(steps)
            position[axis] = end
            faces.append(data[tuple(position)].ravel())
    voxels = np.concatenate(faces).astype(np.float64)
    depth = _ENTRY * _depth_of_voxel(resolved, resolved.transfer_function.opacity(voxels))
    return float((depth >= np.log(2.0)).mean())


def _lattice(shape: tuple[int, int], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns, up to ``count`` of each, spread over a picture."""
    rows, columns = (np.unique(np.linspace(0, n - 1, min(n, count)).round().astype(int)) for n in shape)
    return rows, columns


def _through(grid: Grid, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World distances [k, l] at which rays enter the volume and leave it; entry > exit for rays that miss it."""
    to_index = grid.world_to_index()
    at = origins @ to_index[:3, :3].T + to_index[:3, 3]
    along = directions @ to_index[:3, :3].T
    lower, upper = grid.index_bounds()
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (lower - at) / along, (upper - at) / along
        inside = (at >= lower) & (at <= upper)
        one = np.where(along == 0, np.where(inside, -np.inf, np.inf), one)
        other = np.where(along == 0, np.where(inside, np.inf, -np.inf), other)
    near, far = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    return np.maximum(near, 0.0), far


def _anything_kept(grid: Grid, clips: tuple[Clip, ...]) -> bool:
    """Whether all clips keep at least one point of a coarse lattice in the volume."""
    lower, upper = grid.index_bounds()
    axes = [np.linspace(a, b, _POINTS) for a, b in zip(lower, upper)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    to_world = grid.index_to_world()
    points = points @ to_world[:3, :3].T + to_world[:3, 3]
    kept = np.ones(len(points), bool)
    for clip in clips:
        if isinstance(clip, MeshClip):
            low, high = clip.mesh.bounds
            if clip.keep == "inside":
                kept &= ((points >= low) & (points <= high)).all(axis=1)
            continue
        if clip.type == "plane":
            kept &= (points - np.asarray(clip.point)) @ np.asarray(clip.normal) >= 0
            continue
        if clip.type == "box":
            inside = ((points >= clip.lower) & (points <= clip.upper)).all(axis=1)
        else:
            inside = np.linalg.norm(points - np.asarray(clip.center), axis=1) <= clip.radius
        kept &= inside if clip.keep == "inside" else ~inside
    return bool(kept.any())
