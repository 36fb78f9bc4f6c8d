"""The kept stretches of a ray: the volume's domain cut by every clip, exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.volume import Grid

LEAST_CUT = 1e-3  # smallest edges: where less of a ray is cut off, no cut face shows


@dataclass
class Stretches:
    """Slots in the order of the ray: ``enter`` < ``leave`` [n, s] along it, inf where there is
    none; ``normal`` [n, s, 3] outwards where a clip made the start, else 0."""

    enter: np.ndarray
    leave: np.ndarray
    normal: np.ndarray


def kept_stretches(grid: Grid, clips, origin: np.ndarray, direction: np.ndarray) -> Stretches:
    """Of rays from ``origin`` [n, 3] along unit ``direction`` [n, 3], from t = 0 on."""
    to_index = grid.world_to_index()
    lower, upper = grid.index_bounds()
    start, end, _, _ = box_interval(
        origin @ to_index[:3, :3].T + to_index[:3, 3], direction @ to_index[:3, :3].T, lower, upper
    )
    start = np.maximum(start, 0.0)
    kept = Stretches(start[:, None], end[:, None], np.zeros((len(origin), 1, 3)))
    for clip in clips:
        kept = _intersection(kept, clip_stretches(clip, origin, direction))
    uncut = kept.enter <= start[:, None] + LEAST_CUT * grid.smallest_edge
    kept.normal[uncut] = 0.0
    empty = ~(kept.leave > kept.enter)
    kept.enter[empty] = kept.leave[empty] = np.inf
    order = np.argsort(kept.enter, axis=1, kind="stable")
    return Stretches(
        np.take_along_axis(kept.enter, order, axis=1),
        np.take_along_axis(kept.leave, order, axis=1),
        np.take_along_axis(kept.normal, order[..., None], axis=1),
    )


def _intersection(a: Stretches, b: Stretches) -> Stretches:
    enters, leaves, normals = [], [], []
    for i in range(a.enter.shape[1]):
        for j in range(b.enter.shape[1]):
            later = b.enter[:, j] > a.enter[:, i]
            enters.append(np.where(later, b.enter[:, j], a.enter[:, i]))
            leaves.append(np.minimum(a.leave[:, i], b.leave[:, j]))
            normals.append(np.where(later[:, None], b.normal[:, j], a.normal[:, i]))
    return Stretches(np.stack(enters, 1), np.stack(leaves, 1), np.stack(normals, 1))


def clip_stretches(clip, origin: np.ndarray, direction: np.ndarray) -> Stretches:
    """What one clip keeps of each ray: one slot or two; of a mesh, as many as it is crossed."""
    kind = getattr(clip, "type", "plane")
    if kind == "mesh":
        return _mesh(clip, origin, direction)
    if kind == "plane":
        return _plane(clip, origin, direction)
    if kind == "sphere":
        start, end, normal_in, normal_out = _sphere(clip, origin, direction)
    else:
        lower, upper = np.asarray(clip.lower, float), np.asarray(clip.upper, float)
        start, end, normal_in, normal_out = box_interval(origin, direction, lower, upper)
    if clip.keep == "inside":
        return Stretches(start[:, None], end[:, None], normal_in[:, None])
    missed = ~(end > start)
    start, end = np.where(missed, np.inf, start), np.where(missed, np.inf, end)
    before = np.full(len(origin), -np.inf)
    none = np.zeros_like(normal_out)
    return Stretches(
        np.stack([before, end], 1),
        np.stack([start, np.full(len(origin), np.inf)], 1),
        np.stack([none, normal_out], 1),
    )


def _plane(clip, origin, direction) -> Stretches:
    normal = np.asarray(clip.normal, float)
    normal = normal / np.linalg.norm(normal)
    height, rate = (origin - np.asarray(clip.point, float)) @ normal, direction @ normal
    parallel = np.abs(rate) < 1e-20
    at = -height / np.where(parallel, 1.0, rate)
    never = np.where(height >= 0, -np.inf, np.inf)
    enter = np.where(parallel, never, np.where(rate > 0, at, -np.inf))
    leave = np.where(parallel | (rate > 0), np.inf, at)
    return Stretches(
        enter[:, None], leave[:, None], np.broadcast_to(-normal, (len(origin), 1, 3)).copy()
    )


def _sphere(clip, origin, direction):
    """The interval inside, with the normals that face a ray that enters, and one that leaves."""
    center = np.asarray(clip.center, float)
    from_center = origin - center
    middle = -np.sum(from_center * direction, axis=1)
    nearest = from_center + middle[:, None] * direction
    left = clip.radius**2 - np.sum(nearest**2, axis=1)
    half = np.sqrt(np.maximum(left, 0.0))
    start = np.where(left > 0, middle - half, np.inf)
    end = np.where(left > 0, middle + half, -np.inf)
    out_at_start = (nearest - half[:, None] * direction) / clip.radius
    out_at_end = (nearest + half[:, None] * direction) / clip.radius
    return start, end, out_at_start, -out_at_end


def _mesh(clip, origin, direction) -> Stretches:
    """Between the crossings of each ray with each triangle (Moeller and Trumbore 1997), sorted."""
    corners = clip.mesh.vertices[clip.mesh.triangles]
    first, edges = corners[:, 0], corners[:, 1:] - corners[:, :1]
    across = np.cross(direction[:, None], edges[None, :, 1])
    area = np.sum(edges[None, :, 0] * across, axis=2)
    safe = np.where(area == 0, 1.0, area)
    offset = origin[:, None] - first[None]
    u = np.sum(offset * across, axis=2) / safe
    other = np.cross(offset, edges[None, :, 0])
    v = np.sum(direction[:, None] * other, axis=2) / safe
    t = np.sum(edges[None, :, 1] * other, axis=2) / safe
    meets = (area != 0) & (u >= 0) & (v >= 0) & (u + v <= 1)
    t = np.where(meets, t, np.inf)
    order = np.argsort(t, axis=1, kind="stable")
    most = int(meets.sum(axis=1).max(initial=0))
    t = np.take_along_axis(t, order, axis=1)[:, :most]
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals = (normals / np.linalg.norm(normals, axis=1)[:, None])[order[:, :most]]
    normals = np.where(np.sum(normals * direction[:, None], axis=2)[..., None] > 0, -normals, normals)
    before, after = np.full((len(origin), 1), -np.inf), np.full((len(origin), 1), np.inf)
    ends = np.concatenate([t, after], axis=1)
    if clip.keep != "inside":
        ends = np.concatenate([before, ends], axis=1)
        normals = np.concatenate([np.zeros((len(origin), 1, 3)), normals], axis=1)
    slots = ends.shape[1] // 2
    if not slots:
        none = np.full((len(origin), 1), np.inf)
        return Stretches(none, none.copy(), np.zeros((len(origin), 1, 3)))
    enter, leave = ends[:, 0 : 2 * slots : 2], ends[:, 1 : 2 * slots : 2]
    return Stretches(enter.copy(), leave.copy(), normals[:, 0 : 2 * slots : 2].copy())


def box_interval(origin, direction, lower, upper):
    """(start [n], end [n], normal where a ray enters [n, 3], normal towards it where it leaves)."""
    still = np.abs(direction) < 1e-20
    inverse = 1.0 / np.where(still, 1.0, direction)
    a, b = (lower - origin) * inverse, (upper - origin) * inverse
    within = (origin >= lower) & (origin <= upper)
    near = np.where(still, np.where(within, -np.inf, np.inf), np.minimum(a, b))
    far = np.where(still, np.where(within, np.inf, -np.inf), np.maximum(a, b))
    rows = np.arange(len(origin))
    first, last = np.argmax(near, axis=1), np.argmin(far, axis=1)
    normal_in, normal_out = np.zeros_like(direction), np.zeros_like(direction)
    normal_in[rows, first] = -np.sign(direction[rows, first])
    normal_out[rows, last] = -np.sign(direction[rows, last])
    return near[rows, first], far[rows, last], normal_in, normal_out
