"""Closed meshes on the device (cl/mesh_clip.h): their triangles, in a hierarchy of boxes, as items of the scene."""

from __future__ import annotations

import numpy as np

from clvol.device.local_space import LocalSpace
from clvol.errors import SceneError
from clvol.features.vocabulary import CLIPS
from clvol.readers.meshes import ClosedMesh
from clvol.scene.clip import MeshClip
from clvol.scene.resolve import ResolvedScene

_LEAF = 4  # triangles at most
# Of the largest coordinate: more than what rounding moves a vertex across a ray by.
_MARGIN = 4e-6
_MOST_ITEMS = 1 << 24  # their numbers are floats


def mesh_switch(resolved: ResolvedScene) -> dict[str, int]:
    """The switch of clips by meshes; none for a scene without."""
    return {"MESH_CLIPS": 1} if any(isinstance(clip, MeshClip) for clip in resolved.clips) else {}


def mesh_rows(resolved: ResolvedScene, space: LocalSpace, before: int) -> list[np.ndarray]:
    """float32 [n, 4] each: the items of the scene's mesh clips, which follow ``before`` others.

    They are three for each clip: (kind, whether the inside is kept), (its first item, the one behind its last), and
    one that is not used; then come their boxes and triangles. SceneError where there are too many.
    """
    clips = [clip for clip in resolved.clips if isinstance(clip, MeshClip)]
    if not clips:
        return []
    extent = float(np.linalg.norm(space.shift))
    told = np.zeros((3 * len(clips), 4), np.float32)
    rows = [told]
    at = before + len(told)
    for number, clip in enumerate(clips):
        items = mesh_items(clip.mesh, space, at, extent)
        told[3 * number, :2] = CLIPS["mesh"], clip.keep == "inside"
        told[3 * number + 1, :2] = at, at + len(items)
        at += len(items)
        if at > _MOST_ITEMS:
            where = f"{resolved.origin}: clip"
            raise SceneError(where, f"got meshes of {len(clip.mesh.triangles)} triangles and more", "fewer triangles")
        rows.append(items)
    return rows


def mesh_items(mesh: ClosedMesh, space: LocalSpace, first: int, extent: float) -> np.ndarray:
    """float32 [n, 4]: a mesh's boxes and triangles in local coordinates, as items from number ``first`` on.

    A box is two items, (lower corner, number of the item behind all that it holds) and (upper corner, number of its own
    triangles), a triangle three, its vertices. A box is followed by what it holds: its triangles, or two boxes.
    ``extent``: edges from the volume's middle to its farthest corner.
    """
    vertices = np.asarray(space.point(mesh.vertices), np.float32)
    triangles = vertices[mesh.triangles]
    order, cuts = _groups(triangles.mean(axis=1))
    triangles = triangles[order]
    margin = _MARGIN * max(float(np.abs(vertices).max()), extent)
    low = np.minimum.reduceat(triangles.min(axis=1), cuts) - margin
    high = np.maximum.reduceat(triangles.max(axis=1), cuts) + margin
    leaves = len(cuts)
    ends = np.append(cuts, len(triangles))
    items = np.zeros((2 * (2 * leaves - 1) + 3 * len(triangles), 4), np.float32)
    at = 0
    ranges = [(0, leaves)]
    while ranges:
        begin, end = ranges.pop()
        count = int(ends[end] - ends[begin])
        behind = at + 2 * (2 * (end - begin) - 1) + 3 * count
        items[at] = (*low[begin:end].min(axis=0), first + behind)
        items[at + 1, :3] = high[begin:end].max(axis=0)
        at += 2
        if end - begin == 1:
            items[at - 1, 3] = count
            items[at : at + 3 * count, :3] = triangles[ends[begin] : ends[end]].reshape(-1, 3)
            at += 3 * count
        else:
            middle = (begin + end) // 2
            ranges += [(middle, end), (begin, middle)]
    return items


def _groups(centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An order of triangles with ``centres`` [n, 3], and where groups of at most _LEAF begin in it: halves along the
    longest axis of what they hold, over and over."""
    order = np.arange(len(centres))
    starts = np.array([0])
    ends = np.array([len(centres)])
    while (ends - starts).max() > _LEAF:
        sizes = ends - starts
        group = np.repeat(np.arange(len(starts)), sizes)
        placed = centres[order]
        spread = np.maximum.reduceat(placed, starts) - np.minimum.reduceat(placed, starts)
        along = placed[np.arange(len(order)), spread.argmax(axis=1)[group]]
        order = order[np.lexsort((along, group))]
        split = sizes > _LEAF
        middles = starts + sizes // 2
        starts = np.sort(np.concatenate([starts, middles[split]]))
        ends = np.append(starts[1:], len(centres))
    return order, starts
