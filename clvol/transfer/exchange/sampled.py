"""Curves of other tools as points that are linear between: opacities, and colours in linear light.

Straight pieces stay exact. A curve is halved until the chord deviates from it by less than a stated error:
``OPACITY_ERROR`` in opacity, ``COLOR_ERROR`` in a component of the sRGB-encoded colour.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from clvol.transfer.color import linear_to_srgb, srgb_to_linear

OPACITY_ERROR = 1 / 2048
COLOR_ERROR = 1 / 512  # half a level of 8 bits
_DEEPEST = 12  # halvings
_PROBES = np.linspace(0.0, 1.0, 9)[1:-1]

class Points(NamedTuple):
    """The arguments of a ``TransferFunction``: values [n], opacities [n], colours [n, 3] in linear light."""

    values: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    opacity_unit: float


class Function(Protocol):
    """What is read of a ``TransferFunction``, whose module imports this one."""

    @property
    def values(self) -> np.ndarray: ...

    @property
    def opacities(self) -> np.ndarray: ...

    @property
    def colors(self) -> np.ndarray: ...

    @property
    def opacity_unit(self) -> float: ...

    def opacity(self, s: ArrayLike, /) -> np.ndarray: ...

    def color(self, s: ArrayLike, /) -> np.ndarray: ...


Curve = Callable[[np.ndarray], np.ndarray]  # [m] in [0, 1] -> [m, k]
Knots = tuple[np.ndarray, np.ndarray]  # [n] ascending, a value twice for a step; [n, k]


def straightened(curve: Curve, breaks: np.ndarray, error: float, colors: bool) -> np.ndarray:
    """Parameters in [0, 1], from ``breaks`` and halvings between, at which chords of ``curve`` deviate by < ``error``.

    ``colors``: the curve is sRGB-encoded [m, 3], and its chords are straight in linear light.
    """
    done: list[float] = []
    waiting = [(float(a), float(b), 0) for a, b in zip(breaks[-2::-1], breaks[:0:-1])]
    while waiting:
        a, b, depth = waiting.pop()
        done.append(a)
        if depth < _DEEPEST and _deviation(curve, a, b, colors) >= 0.9 * error:  # probes miss the very worst
            done.pop()
            middle = 0.5 * (a + b)
            waiting += [(middle, b, depth + 1), (a, middle, depth + 1)]
    return np.array([*done, float(breaks[-1])])


def _deviation(curve: Curve, a: float, b: float, colors: bool) -> float:
    ends, exact = curve(np.array([a, b])), curve(a + (b - a) * _PROBES)
    if colors:
        ends = srgb_to_linear(ends)
    chord = ends[0] + (ends[1] - ends[0]) * _PROBES[:, None]
    return float(np.abs((linear_to_srgb(chord) if colors else chord) - exact).max())


def thinned(values: np.ndarray, encoded: np.ndarray, error: float = COLOR_ERROR) -> np.ndarray:
    """Indices of points of a sampled colour curve that are enough: chords in linear light between them deviate from
    all points by less than ``error`` (``encoded`` [n, 3] is sRGB-encoded, ``values`` [n] ascend strictly).
    """
    linear = srgb_to_linear(encoded)
    kept, waiting = {0, len(values) - 1}, [(0, len(values) - 1)]
    while waiting:
        a, b = waiting.pop()
        if b - a < 2:
            continue
        t = (values[a : b + 1] - values[a]) / (values[b] - values[a])
        chord = linear_to_srgb(linear[a] + (linear[b] - linear[a]) * t[:, None])
        off = np.abs(chord - encoded[a : b + 1]).max(axis=1)
        if (worst := int(off.argmax())) and off[worst] >= error:
            kept.add(a + worst)
            waiting += [(a, a + worst), (a + worst, b)]
    return np.array(sorted(kept))


def without_needless(knots: Knots, error: float = 1e-12) -> Knots:
    """``knots`` without points that lie on the chord of their neighbours, to within ``error``."""
    values, table = knots
    keep = [0]
    for i in range(1, len(values) - 1):
        a, b = keep[-1], i + 1
        if values[a] < values[i] < values[b]:
            t = (values[a + 1 : b] - values[a]) / (values[b] - values[a])
            chord = table[a] + (table[b] - table[a]) * t[:, None]
            if np.abs(chord - table[a + 1 : b]).max() <= error:
                continue
        keep.append(i)
    if len(values) > 1:
        keep.append(len(values) - 1)
    return values[keep], table[keep]


def merged(colors: Knots, opacities: Knots, opacity_unit: float) -> Points:
    """The points of a transfer function from knots of colour (linear light) and of opacity, at all their values."""
    values: list[float] = []
    rows: list[np.ndarray] = []
    for value in np.union1d(colors[0], opacities[0]):
        left, right = (
            np.concatenate([_limit(colors, value, side), _limit(opacities, value, side)])
            for side in ("left", "right")
        )
        for row in (left,) if np.array_equal(left, right) else (left, right):
            values.append(float(value))
            rows.append(row)
    table = np.array(rows)
    return Points(np.array(values), table[:, 3], table[:, :3], opacity_unit)


def _limit(knots: Knots, value: float, side: str) -> np.ndarray:
    """The value of knots [k] on the left or on the right of ``value``; the ends hold outside."""
    values, table = knots
    low, high = int(np.searchsorted(values, value, "left")), int(np.searchsorted(values, value, "right"))
    if low < high:
        return table[low] if side == "left" else table[high - 1]
    if low in (0, len(values)):
        return table[min(low, len(values) - 1)]
    t = (value - values[low - 1]) / (values[low] - values[low - 1])
    return table[low - 1] * (1.0 - t) + table[low] * t


def at_most_two(values: np.ndarray, table: np.ndarray) -> Knots:
    """Sorted by value (in the given order where equal), with the first and the last of those at one value."""
    order = np.argsort(values, kind="stable")
    values, table = values[order], table[order]
    inner = np.zeros(len(values), bool)
    inner[1:-1] = (values[1:-1] == values[:-2]) & (values[1:-1] == values[2:])
    return values[~inner], table[~inner]
