"""Colour cycling: a transfer function that moves through the values and wraps around.

The function moves, not the values that are looked up: between two samples on either side of the wrap, a value must
not run through all the others, as it would in a pre-integrated segment.
"""

from __future__ import annotations

import math

import numpy as np

from clvol.transfer.function import TransferFunction

_MOST_PERIODS = 64


def cycled(
    function: TransferFunction,
    shift: float,
    value_range: tuple[float, float],
    reach: tuple[float, float] | None = None,
    *,
    opacity: bool = True,
) -> TransferFunction:
    """The function g with g(v) = ``function``(low + mod(v - low + shift (high - low), high - low)).

    ``shift`` is in units of the range (low, high) = ``value_range``; a whole number changes nothing on the range.
    ``reach``: the values for which the function is needed, where noise leads beyond the range; at most 64 ranges,
    beyond which the ends hold. Without ``opacity`` only colours move.
    """
    low, high = value_range
    period = high - low
    if not period > 0 or shift % 1.0 == 0.0 and reach is None:
        return function
    first, last = value_range if reach is None else (min(reach[0], low), max(reach[1], high))
    inner = function.values[(function.values > low) & (function.values < high)]
    knots = np.unique(np.concatenate([[low], inner, [high]]))
    right, left = limits(function, knots[:-1], "right"), limits(function, knots[1:], "left")
    offset = -(shift % 1.0) * period
    from_period = math.floor(max((first - low - offset) / period, -_MOST_PERIODS / 2))
    to_period = math.ceil(min((last - low - offset) / period, _MOST_PERIODS / 2))
    values: list[float] = []
    points: list[np.ndarray] = []
    for n in range(from_period, to_period + 1):
        placed = knots + (offset + n * period)
        for k in range(knots.size - 1):
            begin = values[-1] if values else placed[k]  # rounding leaves no gap and no overlap
            end = placed[k + 1]
            if begin < end and end > first and begin < last:
                values += [begin, end]
                points += [right[k], left[k]]
    moved = joined(np.array(values), np.array(points), function.opacity_unit)
    return moved if opacity else _mixed(function, moved)


def limits(function: TransferFunction, at: np.ndarray, side: str) -> np.ndarray:
    """Opacity and colour, float64 [n, 4], just left or right of the values ``at``."""
    found = np.column_stack([function.opacity(at), function.color(at)])
    if side == "left":
        point = np.searchsorted(function.values, at, side="left").clip(0, function.values.size - 1)
        at_point = function.values[point] == at
        points = np.column_stack([function.opacities, function.colors])
        found[at_point] = points[point[at_point]]
    return found


def joined(values: np.ndarray, points: np.ndarray, unit: float) -> TransferFunction:
    """The function through the ends of consecutive pieces; coinciding ends are merged."""
    same = (values[1:] == values[:-1]) & (points[1:] == points[:-1]).all(axis=1)
    keep = np.concatenate([[True], ~same])
    values, points = values[keep], points[keep]
    return TransferFunction(values, points[:, 0], points[:, 1:], unit)


def _mixed(opacities: TransferFunction, colors: TransferFunction) -> TransferFunction:
    """The opacity of one function with the colour of another."""
    knots = np.unique(np.concatenate([opacities.values, colors.values]))
    points = np.empty((knots.size, 2, 4))
    for k, side in enumerate(("left", "right")):
        points[:, k, 0] = limits(opacities, knots, side)[:, 0]
        points[:, k, 1:] = limits(colors, knots, side)[:, 1:]
    return joined(np.repeat(knots, 2), points.reshape(-1, 4), opacities.opacity_unit)
