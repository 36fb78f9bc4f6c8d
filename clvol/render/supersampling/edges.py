"""Pixels that differ from a neighbour: where one ray per pixel is not enough.

Compared are the pixels as displayed, over the background, since that is where steps show; their opacity, which another
background would show; and their depth, where two surfaces of one colour meet.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from clvol.image.develop import developed
from clvol.transfer.color import linear_to_srgb

_STEEPEST = 16.0  # change of depth, in pixels' widths in the world: steeper surfaces than 86 degrees are two
_LEVELS = 1 << 14
_STRONG = 3.0  # times the threshold
_NEIGHBOURS = (np.s_[..., :-1], np.s_[..., 1:]), (np.s_[..., :-1, :], np.s_[..., 1:, :])


class Edges:
    """Compares pixels of a picture over ``background`` [3] (linear). ``display``: as ``image.develop`` takes it.
    ``footprint``: (a, b), where a pixel is a + b depth wide in the world."""

    def __init__(
        self, threshold: float, background: np.ndarray, display: Any, footprint: tuple[float, float]
    ) -> None:
        self.threshold = threshold
        self._background, self._display, self._footprint = background, display, footprint

    def shown(self, rgba: np.ndarray) -> np.ndarray:
        """float32 [4, ...]: what is compared of ``rgba`` float32 [..., 4]: encoded colour, and opacity."""
        found = np.empty((4, *rgba.shape[:-1]), np.float32)
        how = self._display
        found[3] = rgba[..., 3]
        if how is not None and (how.exposure or how.tone_curve != "clip"):
            levels = developed(rgba.reshape(1, -1, 4), self._background, how, 16, False)
            found[:3] = np.moveaxis(levels, -1, 0).reshape(found[:3].shape)
            found[:3] *= np.float32(1 / 65535)
            return found
        clear = None if not self._background.any() else 1.0 - found[3]
        for k in range(3):
            light = found[k]
            if clear is None:
                np.multiply(rgba[..., k], np.float32(_LEVELS**2), out=light)
            else:
                np.add(rgba[..., k], clear * np.float32(self._background[k]), out=light)
                light *= np.float32(_LEVELS**2)
            # What is no number counts as black.
            np.fmax(np.fmin(light, np.float32(_LEVELS**2), out=light), np.float32(0), out=light)
            # Indices of the pointer's size: numpy converts others, for twice the time of all the rest.
            _encoded_roots().take(np.sqrt(light, out=light).astype(np.intp), out=light, mode="clip")
        return found

    def find(self, rgba: np.ndarray, depth: np.ndarray | None) -> np.ndarray:
        """bool [height, width]: pixels of ``rgba`` [height, width, 4] that differ by the threshold or more from the
        one above, below, left or right of them; all where it is 0."""
        if self.threshold == 0.0:
            return np.ones(rgba.shape[:2], bool)
        whole = np.zeros(rgba.shape[:2], bool)
        part = _around_drawn(rgba)  # pixels without anything are alike
        rgba, found = rgba[part], whole[part]
        depth = None if depth is None else depth[part]
        shown = self.shown(rgba)
        for first, second in _NEIGHBOURS:
            differ = self.differ(shown[first], shown[second])
            if depth is not None:
                differ |= self.apart(depth[first], depth[second])
            found[first] |= differ
            found[second] |= differ
        return whole

    def grade(self, rgba: np.ndarray, depth: np.ndarray | None) -> np.ndarray:
        """uint8 [height, width]: how much pixels of ``rgba`` [height, width, 4] differ from what lies half way between
        those left and right, or above and below, of them, times two (along a ramp the ray through a pixel's middle
        is its mean). 1: by the threshold or more, 2: by ``_STRONG`` times as much, or in depth from a neighbour."""
        whole = np.zeros(rgba.shape[:2], np.uint8)
        part = _around_drawn(rgba)
        found, shown = whole[part], self.shown(rgba[part])
        bends = np.zeros(found.shape, np.float32)
        for axis in (1, 2):
            padded = np.pad(shown, [(0, 0), *((int(axis == k),) * 2 for k in (1, 2))], mode="edge")
            steps = np.diff(padded, axis=axis)
            np.maximum(bends, np.abs(np.diff(steps, axis=axis)).max(axis=0), out=bends)
        found[bends >= self.threshold] = 1
        found[bends >= _STRONG * self.threshold] = 2
        if depth is not None:
            inside = depth[part]
            for first, second in _NEIGHBOURS:
                apart = self.apart(inside[first], inside[second])
                found[first][apart] = 2
                found[second][apart] = 2
        return whole

    def contrast(self, rgba: np.ndarray) -> np.ndarray:
        """float32 [height, width]: the largest difference to a neighbour, as displayed."""
        shown, most = self.shown(rgba), np.zeros(rgba.shape[:2], np.float32)
        for first, second in _NEIGHBOURS:
            step = np.abs(shown[first] - shown[second]).max(axis=0)
            most[first] = np.maximum(most[first], step)
            most[second] = np.maximum(most[second], step)
        return most

    def differ(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """bool [...]: whether pixels ``a`` and ``b``, both as ``shown``, differ by the threshold."""
        most = np.abs(a[0] - b[0])
        for k in range(1, 4):
            step = a[k] - b[k]
            np.maximum(most, np.abs(step, out=step), out=most)
        return most >= self.threshold

    def apart(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """bool [...]: whether pixels next to each other of these depths show two surfaces."""
        with np.errstate(invalid="ignore", over="ignore"):
            step, width = np.abs(a - b), np.minimum(a, b)
            width *= np.float32(_STEEPEST * self._footprint[1])
            width += np.float32(_STEEPEST * self._footprint[0])
            return (step > width) & (step < np.inf)


def _around_drawn(rgba: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of the pixels of ``rgba`` [height, width, 4] that have anything, and of those beside them."""
    words = np.ascontiguousarray(rgba, np.float32).view(np.uint64)
    drawn = (words[..., 0] | words[..., 1]) != 0
    parts = []
    for axis in (1, 0):
        places = np.flatnonzero(drawn.any(axis=axis))
        parts.append(slice(max(places[0] - 1, 0), places[-1] + 2) if len(places) else slice(0))
    return parts[0], parts[1]


@lru_cache(maxsize=1)
def _encoded_roots() -> np.ndarray:
    """float32 [_LEVELS + 1]: light, by its square root, encoded. (Roots are spaced about as encoded light is.)"""
    return linear_to_srgb((np.arange(_LEVELS + 1) / _LEVELS) ** 2).astype(np.float32)
