"""Partial pictures, put together from front to back: of volumes, and of projections, which show a sample per ray."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np


def put_together(partial: Iterable[np.ndarray], height: int, width: int) -> np.ndarray:
    """float32 [height, width, 4]: the pictures ``partial``, the nearest one first: ``composited``, or, of float32
    [height, width, 5] with a score of each pixel, each pixel of the first one that has the highest score."""
    parts = list(partial)
    if parts[0].shape[-1] == 4:
        return composited(parts, height, width)
    found, best = np.zeros((height, width, 4), np.float32), np.full((height, width), -np.inf, np.float32)
    for part in parts:
        better = part[..., 4] > best
        found[better], best[better] = part[better, :4], part[better, 4]
    return found


def winners(scores: Sequence[np.ndarray]) -> np.ndarray:
    """int [height, width]: which of ``scores`` float32 [height, width] is the highest, the first of equal ones."""
    return np.argmax(np.stack(scores), axis=0)


def composited(partial: Iterable[np.ndarray], height: int, width: int) -> np.ndarray:
    """float32 [height, width, 4]: the pictures ``partial``, float32 [height, width, 4], premultiplied, the nearest one
    first, each seen through those before it (Porter and Duff 1984: over). Added in double precision, so that the
    number of parts costs no digit."""
    color = np.zeros((height, width, 3))
    transmittance = np.ones((height, width, 1))
    for rgba in partial:
        color += transmittance * rgba[..., :3]
        transmittance *= 1.0 - rgba[..., 3:].astype(np.float64)
    return np.concatenate([color, 1.0 - transmittance], axis=-1).astype(np.float32)
