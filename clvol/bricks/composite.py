"""Partial pictures, put together from front to back."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


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
