"""Intersections of boxes, spheres, planes and grids with the domain of a volume. All shapes are convex."""

from __future__ import annotations

import itertools

import numpy as np

from clvol.readers.meshes import ClosedMesh
from clvol.scene.clip import Clip, MeshClip
from clvol.volume import Grid

_ROUNDING = 1e-14  # of coordinates
_ASKEW = np.array([0.5377, 0.3119, 0.7833])  # a direction that few edges of meshes have
_INSIDE = 1e-9  # tolerance of an index for a corner on the boundary of a grid


def cuts(clip: Clip, grid: Grid) -> bool:
    """Whether ``clip`` removes more of the domain than rounding errors."""
    corners = grid.world_corners()
    if clip.type == "plane":
        return _plane_cuts(clip, corners)
    if clip.type == "box":
        lower, upper = np.asarray(clip.lower), np.asarray(clip.upper)
        if clip.keep == "outside":
            return not box_apart(grid, lower, upper)
        # Each face has its own tolerance, since another face may be extremely far away.
        reach = np.abs(corners).max()
        below = lower - _ROUNDING * np.maximum(reach, np.abs(lower))
        above = upper + _ROUNDING * np.maximum(reach, np.abs(upper))
        return bool(np.any(corners < below) or np.any(corners > above))
    if isinstance(clip, MeshClip):  # what is within a mesh may be hollow
        return not (mesh_holds(clip.mesh, grid) if clip.keep == "inside" else box_apart(grid, *clip.mesh.bounds))
    center = np.asarray(clip.center)
    offsets = corners - center
    largest = max(np.abs(offsets).max(), clip.radius)  # so that no square may overflow
    rounding = _ROUNDING * max(np.abs(corners).max(), np.abs(center).max()) / largest
    if clip.keep == "outside":
        nearest = nearest_distance(center, grid, largest)
        return nearest < clip.radius / largest - rounding
    distances = np.linalg.norm(offsets / largest, axis=1)
    return bool(distances.max() > clip.radius / largest + rounding)


def box_apart(grid: Grid, lower: np.ndarray, upper: np.ndarray) -> bool:
    """Whether the box from ``lower`` to ``upper`` [3] and the domain of ``grid`` at most touch."""
    return _apart(grid.world_corners(), _box_corners(lower, upper), grid.direction, np.eye(3))


def mesh_holds(mesh: ClosedMesh, grid: Grid) -> bool:
    """Whether the domain of ``grid`` lies within ``mesh``: no triangle is near it, and a ray from its middle crosses
    the mesh an odd number of times. False where triangles are near, or the ray meets an edge, too."""
    corners = grid.world_corners()
    low, high = corners.min(axis=0), corners.max(axis=0)
    lower, upper = mesh.bounds
    if np.any(low <= lower) or np.any(high >= upper):
        return False
    triangles = mesh.vertices[mesh.triangles]
    if np.all((triangles.min(axis=1) <= high) & (triangles.max(axis=1) >= low), axis=1).any():
        return False
    middle = 0.5 * (low + high)
    a, b, c = np.moveaxis((triangles - middle) / np.abs(mesh.vertices - middle).max(), 1, 0)
    sides = np.stack([np.cross(p, q) @ _ASKEW for p, q in ((b, c), (c, a), (a, b))])
    crossed = np.all(sides > _ROUNDING, axis=0) | np.all(sides < -_ROUNDING, axis=0)
    may_cross = np.all(sides >= -_ROUNDING, axis=0) | np.all(sides <= _ROUNDING, axis=0)
    if np.any(may_cross & ~crossed):
        return False
    height = np.sum(a * np.cross(b - a, c - a), axis=1)
    return bool(np.count_nonzero(crossed & (height * sides.sum(axis=0) > 0)) % 2)


def holds(grid: Grid, corners: np.ndarray) -> bool:
    """Whether the world points ``corners`` [n, 3], and therefore their hull, lie in the domain of ``grid``."""
    lower, upper = grid.index_bounds()
    to_index = grid.world_to_index()
    index = corners @ to_index[:3, :3].T + to_index[:3, 3]
    return bool(np.all(index >= lower - _INSIDE) and np.all(index <= upper + _INSIDE))


def grids_apart(one: Grid, other: Grid) -> bool:
    """Whether two grids do not overlap, including half a voxel around the second one."""
    lower, upper = other.index_bounds()
    corners = _box_corners(lower - 0.5, upper + 0.5)
    to_world = other.index_to_world()
    around = corners @ to_world[:3, :3].T + to_world[:3, 3]
    return _apart(one.world_corners(), around, one.direction, other.direction)


def _plane_cuts(clip: Clip, corners: np.ndarray) -> bool:
    normal = np.asarray(clip.normal)
    normal = normal / np.abs(normal).max()  # so that no square or product may overflow
    point = np.asarray(clip.point)
    rounding = _ROUNDING * max(np.abs(corners).max(), np.abs(point).max())
    return bool(np.any((corners - point) @ normal < -rounding))


def _box_corners(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    return np.array(list(itertools.product(*zip(lower, upper))), np.float64)


def _apart(
    one: np.ndarray, other: np.ndarray, edges_one: np.ndarray, edges_other: np.ndarray
) -> bool:
    """Whether two parallelepipeds of these corners [8, 3], with edges along the columns of ``edges_one`` and
    ``edges_other``, at most touch: a normal of a face, or a vector perpendicular to an edge of each, separates them.
    """
    scale = max(np.abs(one).max(), np.abs(other).max())
    one, other = one / scale, other / scale
    axes = [normal for edges in (edges_one, edges_other) for normal in np.linalg.inv(edges)]
    axes += [np.cross(a, b) for a in edges_one.T for b in edges_other.T]
    for axis in axes:
        length = np.linalg.norm(axis)
        if length < 1e-9:  # parallel edges
            continue
        a, b = one @ (axis / length), other @ (axis / length)
        if a.max() <= b.min() + _ROUNDING or b.max() <= a.min() + _ROUNDING:
            return True
    return False


def nearest_distance(point: np.ndarray, grid: Grid, scale: float) -> float:
    """The distance from ``point`` to the domain, divided by ``scale``; a lower bound if the grid is oblique."""
    direction, spacing = grid.direction, np.asarray(grid.spacing)
    lower, upper = grid.index_bounds()
    along = np.linalg.inv(direction) @ ((point - np.asarray(grid.origin)) / scale)
    outside = along - np.clip(along, lower * spacing / scale, upper * spacing / scale)
    if np.allclose(direction.T @ direction, np.eye(3), rtol=0, atol=1e-12):
        return float(np.linalg.norm(outside))
    heights = 1.0 / np.linalg.norm(np.linalg.inv(direction), axis=1)
    return float(np.abs(outside * heights).max())
