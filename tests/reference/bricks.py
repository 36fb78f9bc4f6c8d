"""Bricks in numpy: which box holds a place, and in which order a ray meets the boxes, found without a tree."""

from __future__ import annotations

import numpy as np


def owners(places: np.ndarray, boxes, size) -> np.ndarray:
    """int [n, boxes]: 1 where a box holds the place [n, 3] (x, y, z). Boxes hold their lower faces, not their upper
    ones; outermost ones reach to infinity."""
    found = np.ones((len(places), len(boxes)), int)
    for number, box in enumerate(boxes):
        for axis in range(3):
            at = places[:, axis]
            if box.lower[axis] > 0:
                found[:, number] &= at >= box.lower[axis]
            if box.upper[axis] < size[axis] - 1:
                found[:, number] &= at < box.upper[axis]
    return found


def met_in_order(origin: np.ndarray, direction: np.ndarray, boxes) -> list[int]:
    """The numbers of the boxes through whose inside the ray from ``origin`` [3] runs, by where it enters."""
    entries = []
    for number, box in enumerate(boxes):
        enter, leave = 0.0, np.inf
        for axis in range(3):
            low, high = box.lower[axis] - origin[axis], box.upper[axis] - origin[axis]
            if direction[axis] == 0:
                if not low < 0 < high:
                    leave = -np.inf
                continue
            a, b = sorted((low / direction[axis], high / direction[axis]))
            enter, leave = max(enter, a), min(leave, b)
        if enter < leave:
            entries.append((enter, number))
    return [number for _, number in sorted(entries)]


def over(partial: list[np.ndarray]) -> np.ndarray:
    """[..., 4] float64: pictures, the nearest one first, each added to what is in front of it."""
    result = np.zeros(partial[0].shape)
    for rgba in partial:
        result = result + (1.0 - result[..., 3:]) * rgba.astype(np.float64)
    return result
