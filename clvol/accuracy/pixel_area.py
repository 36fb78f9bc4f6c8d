"""The exact integral over pixels: the truth of pictures that show what is in a pixel, not only what is in its middle.

A pixel is integrated by a grid of 5 by 5 rays, each of which is the exact integral along it; where these differ, by the
grid of 15 by 15 that contains them. What is left of the error of a pixel at an edge is independent of the rays that
pictures are made of (their grids have even sides), so that it can only raise errors that are measured against it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from clvol.integrators.reference.picture import render_reference
from clvol.scene.resolve import ResolvedScene

_FINE, _COARSE = 15, 5  # rays per side of a pixel; the finer grid contains the coarser one
_DIFFERENT = 0.25  # of the error that matters: rays that differ by more are not enough
_MOST_RAYS = 1 << 20  # that are integrated together

Progress = Callable[[int, int], None]


def integrate_pixels(
    resolved: ResolvedScene, devices: Any, tolerance: float, pixels: np.ndarray, error: float,
    progress: Progress | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """RGBA, float64 [n, 4]: means over ``pixels`` (int [n, 2]: row, column), and counters as ``render_reference``.
    ``error``: that of the picture that is measured; the pixels' own is a small part of it."""
    pixels = np.asarray(pixels)
    width, height = resolved.image.width * _FINE, resolved.image.height * _FINE
    larger = replace(resolved, image=resolved.image.model_copy(update={"width": width, "height": height}))
    step = _FINE // _COARSE
    every = np.stack(np.meshgrid(*2 * [np.arange(_FINE)], indexing="ij"), axis=-1).reshape(-1, 2)
    first = (every % step == step // 2).all(axis=1)
    found = np.zeros((len(pixels), 4))
    counters: dict[str, Any] = {}
    total = len(pixels)

    def cast(some: np.ndarray, places: np.ndarray) -> np.ndarray:
        """float64 [n, places, 4]."""
        at = (some[:, None] * _FINE + places).reshape(-1, 2)
        rgba, _, counted = render_reference(larger, devices, tolerance, at)
        for name, value in counted.items():
            together = max if name == "error_estimate" else lambda a, b: a + b
            counters[name] = together(counters[name], value) if name in counters else value
        return rgba.reshape(len(some), len(places), 4)

    size = max(_MOST_RAYS // len(every), 1)
    for k in range(0, total, size):
        part = pixels[k : k + size]
        coarse = cast(part, every[first])
        mean = coarse.mean(axis=1)
        more = np.flatnonzero((np.ptp(coarse, axis=1) > _DIFFERENT * error).any(axis=-1))
        if len(more):
            fine = cast(part[more], every[~first])
            mean[more] = (coarse[more].sum(axis=1) + fine.sum(axis=1)) / len(every)
        found[k : k + size] = mean
        if progress is not None:
            progress(min(k + size, total), total)
    return found, counters
