"""Clips as half-spaces that together cut each ray to one stretch: arithmetic, for methods that need one stretch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clvol.scene.clip import Clip

MOST_HALF_SPACES = 16  # MOST_HALVES of cl/pyramid.h


def half_spaces(clips: Sequence[Clip]) -> list[tuple[np.ndarray, np.ndarray]] | None:
    """(point, unit normal), both float64 [3] in the world, for each half-space that ``clips`` keep together.

    None where what they keep is not the intersection of half-spaces, or of more than ``MOST_HALF_SPACES``.
    """
    found = []
    for clip in clips:
        if clip.type == "plane":
            normal = np.asarray(clip.normal, np.float64)
            normal = normal / np.abs(normal).max()  # first, since squares may overflow
            found.append((np.asarray(clip.point, np.float64), normal / np.linalg.norm(normal)))
        elif clip.type == "box" and clip.keep == "inside":
            for axis in np.eye(3):
                found += [(np.asarray(clip.lower, np.float64), axis), (np.asarray(clip.upper, np.float64), -axis)]
        else:
            return None
    return found if len(found) <= MOST_HALF_SPACES else None
