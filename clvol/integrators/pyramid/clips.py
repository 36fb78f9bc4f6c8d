"""Clips of the method "pyramid": half-spaces that cut each ray to one stretch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clvol.features.half_spaces import half_spaces
from clvol.scene.clip import Clip
from clvol.volume import Grid


def halves_rows(clips: Sequence[Clip], grid: Grid) -> np.ndarray:
    """float64 [n, 4]: ``halves`` of cl/pyramid.h, their normals of length 1 in lattice units. ValueError where ``half_spaces``
    gives None."""
    matrix = grid.index_to_world()
    thin = np.where(np.asarray(grid.size) == 1, 0.5, 0.0)  # such an axis is held twice
    rows = []
    halves = half_spaces(clips)
    if halves is None:
        raise ValueError("clips that are no half-spaces")  # refused before
    for point, normal in halves:
        along = normal @ matrix[:3, :3]
        with np.errstate(over="ignore"):
            height = normal @ (matrix[:3, 3] - point) - along @ thin
        scale = np.linalg.norm(along)
        rows.append((*(along / scale), np.clip(height / scale, -_FAR, _FAR)))
    return np.array(rows, np.float64).reshape(-1, 4)


_FAR = 1e30
