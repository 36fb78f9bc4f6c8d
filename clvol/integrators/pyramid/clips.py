"""Clips of the method "pyramid": half-spaces, which leave one interval of each ray."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clvol.opencl.structs import MOST_HALVES
from clvol.scene.clip import Clip
from clvol.volume import Grid


def halves_of(clips: Sequence[Clip]) -> list[tuple[np.ndarray, np.ndarray]] | None:
    """(point, unit normal) in the world for each of the half-spaces whose intersection ``clips`` keep; None where they keep
    something else, or there are too many half-spaces."""
    halves = []
    for clip in clips:
        if clip.type == "plane":
            normal = np.asarray(clip.normal, np.float64)
            normal = normal / np.abs(normal).max()  # first, since squares may overflow
            halves.append((np.asarray(clip.point, np.float64), normal / np.linalg.norm(normal)))
        elif clip.type == "box" and clip.keep == "inside":
            for axis in np.eye(3):
                halves += [(np.asarray(clip.lower, np.float64), axis), (np.asarray(clip.upper, np.float64), -axis)]
        else:
            return None
    return halves if len(halves) <= MOST_HALVES else None


def halves_rows(clips: Sequence[Clip], grid: Grid) -> np.ndarray:
    """float64 [n, 4]: ``halves`` of cl/pyramid.h, with normals of length 1 in lattice units. ValueError where ``halves_of``
    gives None."""
    matrix = grid.index_to_world()
    thin = np.where(np.asarray(grid.size) == 1, 0.5, 0.0)  # an axis of one voxel is held twice
    rows = []
    halves = halves_of(clips)
    if halves is None:
        raise ValueError("clips that are no half-spaces")  # ``Pyramid.check`` refuses them
    for point, normal in halves:
        along = normal @ matrix[:3, :3]
        with np.errstate(over="ignore"):
            height = normal @ (matrix[:3, 3] - point) - along @ thin
        scale = np.linalg.norm(along)
        rows.append((*(along / scale), np.clip(height / scale, -_FAR, _FAR)))
    return np.array(rows, np.float64).reshape(-1, 4)


_FAR = 1e30
