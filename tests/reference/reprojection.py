"""Where rays may start by what those of the picture before met (cl/reproject.cl), in double precision."""

from __future__ import annotations

import numpy as np


def first_depths(kept: np.ndarray) -> np.ndarray:
    """Depths behind the reference plane of the places that are ``kept`` (cl/coherence.h); NaN of pixels without one."""
    kept = np.asarray(kept, np.float64)
    return np.where(np.isinf(kept) | (kept < 0), np.nan, kept)


def projected(kept, coefficients, distance, old_centre, new_centre):
    """New pixel coordinates x and y, and depths, of kept places [height, width]: NaN of what is behind the eye.
    ``distance``: from the eye to the reference plane, in edges; below 0 for parallel rays."""
    s = first_depths(kept)
    height, width = s.shape
    u, v = np.meshgrid(np.arange(width) - old_centre[0], np.arange(height) - old_centre[1])
    depth, across, down = np.tensordot(coefficients, np.stack([np.ones_like(s), u, v, s, s * u, s * v]), 1)
    from_eye = np.ones_like(s) if distance < 0 else distance + depth
    from_eye = np.where(from_eye > 0, from_eye, np.nan)
    return across / from_eye + new_centre[0], down / from_eye + new_centre[1], np.maximum(depth, 0.0)


def starts(x, y, depth, size, splat, window, back, behind, beside) -> np.ndarray:
    """float64 [height, width]: each place is splat on ``splat`` by ``splat`` pixels around (x, y); a pixel starts
    ``back`` edges before the nearest place that was splat on it or on the pixels from (x0, y0) to (x1, y1) beyond it,
    ``window`` as in cl/reproject.cl. Of pixels beyond the splat, ``behind`` (edges per column and per row) counts from
    ``beside`` pixels on; infinity where there is none."""
    width, height = size
    x0, x1, y0, y1 = window
    nearest = np.full((height, width), np.inf)
    for place_x, place_y, s in zip(x.ravel(), y.ravel(), depth.ravel()):
        if np.isnan(s) or np.isnan(place_x):
            continue
        column, row = (int(np.ceil(at - splat / 2)) for at in (place_x, place_y))
        columns = np.arange(max(column - x1, 0), min(max(column - x0 + 1, 0), width))
        rows = np.arange(max(row - y1, 0), min(max(row - y0 + 1, 0), height))
        away = [
            np.maximum(np.maximum(first - own, own - first - splat + 1) - beside, 0) * each
            for first, own, each in ((column, columns, behind[0]), (row, rows, behind[1]))
        ]
        part = nearest[rows[:, None], columns]
        nearest[rows[:, None], columns] = np.minimum(part, s + away[1][:, None] + away[0])
    return nearest - back
