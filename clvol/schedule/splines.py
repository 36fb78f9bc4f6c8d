"""Curves through values at given times.

``catmull_rom``: positions. ``monotone``: whatever must not leave the range of its values. ``slerp``: directions. Before
the first time and after the last one each holds its first and last value.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

_STRAIGHT = 1e-9  # radians between two directions below which they are one


def catmull_rom(times: ArrayLike, values: ArrayLike, at: float) -> np.ndarray:
    """The value at time ``at`` of the spline through ``values`` [n, ...] at ascending ``times`` [n]: cubic between two
    of them, with tangents by Catmull and Rom (1974), for times that are not evenly spaced as by Overhauser (1968):
    those of the parabola through the neighbours. A straight line through two."""
    t, v = _arrays(times, values)
    slopes, lengths = _slopes(t, v)
    tangents = np.empty_like(v)
    if len(t) > 1:
        tangents[0], tangents[-1] = slopes[0], slopes[-1]
        before, after = lengths[:-1], lengths[1:]
        tangents[1:-1] = (after * slopes[:-1] + before * slopes[1:]) / (before + after)
    return _hermite(t, v, tangents, at)


def monotone(times: ArrayLike, values: ArrayLike, at: float) -> np.ndarray:
    """As ``catmull_rom``, with tangents by Fritsch and Butland (1984): harmonic means of the slopes, 0 where these
    change sign. Between two times the curve stays between their values."""
    t, v = _arrays(times, values)
    slopes, lengths = _slopes(t, v)
    tangents = np.zeros_like(v)
    if len(t) > 1:
        tangents[0], tangents[-1] = slopes[0], slopes[-1]
        before, after = slopes[:-1], slopes[1:]
        share = (lengths[:-1] + 2.0 * lengths[1:]) / (3.0 * (lengths[:-1] + lengths[1:]))
        rises = before * after > 0
        mean = np.where(rises, share * after + (1.0 - share) * before, 1.0)
        tangents[1:-1] = np.where(rises, before * after / mean, 0.0)
    return _hermite(t, v, tangents, at)


def slerp(times: ArrayLike, directions: ArrayLike, at: float) -> np.ndarray:
    """The unit vector at time ``at`` between ``directions`` [n, 3]: along great circles, at an even speed between two
    of them (Shoemake 1985). None of them is 0, and neighbours are not opposite."""
    t, v = _arrays(times, directions)
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    k, share = _place(t, at)
    if share == 0.0:
        return v[k]
    angle = float(np.arctan2(np.linalg.norm(np.cross(v[k], v[k + 1])), v[k] @ v[k + 1]))
    if angle < _STRAIGHT:
        return v[k]
    return (np.sin((1.0 - share) * angle) * v[k] + np.sin(share * angle) * v[k + 1]) / np.sin(angle)


def _arrays(times: ArrayLike, values: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    t, v = np.asarray(times, np.float64), np.asarray(values, np.float64)
    if t.ndim != 1 or not t.size or len(v) != len(t) or np.any(t[1:] <= t[:-1]):
        raise ValueError("times must ascend, with a value each")
    return t, v


def _slopes(t: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    lengths = np.diff(t).reshape(-1, *[1] * (v.ndim - 1))
    return np.diff(v, axis=0) / lengths, lengths


def _place(t: np.ndarray, at: float) -> tuple[int, float]:
    """The number of the time before ``at``, and the share of the interval after it; 0 at and beyond the ends."""
    if at <= t[0] or at >= t[-1]:
        return (0 if at <= t[0] else len(t) - 1), 0.0
    k = int(np.searchsorted(t, at, side="right")) - 1
    return k, float((at - t[k]) / (t[k + 1] - t[k]))


def _hermite(t: np.ndarray, v: np.ndarray, tangents: np.ndarray, at: float) -> np.ndarray:
    k, x = _place(t, at)
    if x == 0.0:
        return v[k]
    length = t[k + 1] - t[k]
    rest = 1.0 - x
    ends = rest * rest * (1.0 + 2.0 * x) * v[k] + x * x * (3.0 - 2.0 * x) * v[k + 1]
    return ends + length * x * rest * (rest * tangents[k] - x * tangents[k + 1])
