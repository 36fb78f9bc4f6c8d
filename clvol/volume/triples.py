"""Vectors of three floats, for a picture's view: a call of numpy takes longer than computing a few of them."""

from __future__ import annotations

import math
from collections.abc import Iterable

Triple = tuple[float, float, float]


def triple(vector: Iterable[float]) -> Triple:
    """``vector``, of three numbers (a list, or an array), as Python's floats."""
    x, y, z = vector
    return float(x), float(y), float(z)


def difference(a: Triple, b: Triple) -> Triple:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def added(a: Triple, b: Triple) -> Triple:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def scaled(factor: float, a: Triple) -> Triple:
    return factor * a[0], factor * a[1], factor * a[2]


def dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Triple, b: Triple) -> Triple:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def norm(a: Triple) -> float:
    return math.sqrt(dot(a, a))


def unit(a: Triple) -> Triple:
    """``a`` at length 1, or 0 if it is 0; it is scaled first, so that no square over- or underflows."""
    largest = max(abs(a[0]), abs(a[1]), abs(a[2]))
    if largest == 0:
        return a
    near = a[0] / largest, a[1] / largest, a[2] / largest
    length = norm(near)
    return near[0] / length, near[1] / length, near[2] / length
