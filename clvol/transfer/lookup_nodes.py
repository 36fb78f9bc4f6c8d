"""Lookup nodes: the values at which the lookup tables of a transfer function have their entries.

Tables are addressed by a table coordinate, the position of a value among the nodes. For integer voxels whose control
points are integers, evenly spaced nodes fall on all control points. In general this is impossible; the map from value
to coordinate is then piecewise linear over equal bins (a "warp"). It puts most nodes where the transfer function
varies, and one exactly on every control point, so that voxels of that value do not show a mixture with neighbouring
values. A peak that is a thousandth of the range wide is resolved by as many entries as one that fills the range.
Control points closer than 1 / 16384 of the range share bins: a pre-integrated ray that crosses them still gathers
what lies between, but voxels of a single value in there show a mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.transfer.function import TransferFunction

# Bins of the warp: by default, if some control points have to share bins, and at most.
BINS, STEP_BINS, MOST_BINS = 4096, 16384, 65536
_BINS_APART = 4  # so that each control point has its own bin, and the jump of a step the bin before
_NARROW = 8  # in nodes: evenly spaced nodes misplace what lies between closer control points
_STEP_MARGIN = 0.02  # share of a bin; exceeds the rounding of a value's position among all bins
# Shares of the nodes: evenly over the range, over what is visible, and around it, where a segment that
# reaches into it changes with 1 / its span.
_EVEN, _VISIBLE, _AROUND = 0.25, 0.40, 0.35


@dataclass(frozen=True, eq=False)
class LookupNodes:
    """The nodes: ``values`` [n >= 2] float64, ascending.

    The coordinate of value s is (s - ``first``) * ``per_value``, clamped to 0 .. n - 1. If ``warp`` exists (float32
    [bins + 1], ascending from 0 to n - 1), that number is a position among bins, at which ``warp`` is interpolated
    linearly.
    """

    values: np.ndarray
    first: float
    per_value: float
    warp: np.ndarray | None = None

    @property
    def rounding(self) -> float:
        """Largest difference of float32 arithmetic from ``position``; 0 if nodes are evenly spaced."""
        if self.warp is None:
            return 0.0
        return float(np.diff(self.warp).max()) * self.warp.size * 2.0**-22 + 2e-5

    @property
    def last_coordinate(self) -> float:
        return float(self.values.size - 1)

    def is_exact(self, values: np.ndarray) -> np.ndarray:
        """Whether float32 arithmetic gives exactly ``position`` of ``values``, whole numbers at the edges of bins."""
        values = np.asarray(values, np.float64)
        whole = (values == np.floor(values)) & (np.abs(values) < 2**24)
        steps = (self.first, self.per_value)
        return whole & all(v == np.floor(v) and abs(v) < 2**24 for v in steps)

    def position(self, values: np.ndarray) -> np.ndarray:
        """Table coordinates (float64) of ``values``, computed as in the kernels."""
        p = (np.asarray(values, np.float64) - self.first) * self.per_value
        if self.warp is not None:
            p = np.interp(p, np.arange(self.warp.size), self.warp.astype(np.float64))
        return np.clip(p, 0.0, self.last_coordinate)


def lookup_nodes(
    function: TransferFunction,
    value_range: tuple[float, float],
    count: int,
    *,
    integer: bool,
    may_warp: bool = True,
) -> LookupNodes:
    """About ``count`` nodes (never more) over ``value_range`` for ``function``.

    ``integer``: voxels are integers. ``may_warp`` False: nodes are evenly spaced if that resolves the function, as a
    long one-dimensional table requires; for integer voxels there may then be as many nodes as values.
    """
    low, high = (float(v) for v in value_range)
    if not high > low:
        high = low + 1.0 if integer else low + max(abs(low) * 1e-3, np.finfo(np.float32).tiny * 1e4)
    inside = function.values[(function.values > low) & (function.values < high)]
    if integer and high - low <= count - 1:
        per_value = int((count - 1) // (high - low))
        if not may_warp or np.all(inside * per_value == np.round(inside * per_value)):
            n = per_value * int(high - low) + 1
            return LookupNodes(low + np.arange(n) / per_value, low, float(per_value))
    if not may_warp:
        if integer and high - low < MOST_BINS and _is_narrow(function, low, high, count):
            return LookupNodes(np.arange(low, high + 1), low, 1.0)
        may_warp = not integer and _is_narrow(function, low, high, count)
    if not may_warp or inside.size > count // 2:
        return LookupNodes(np.linspace(low, high, count), low, (count - 1) / (high - low))
    return _warped(function, low, high, count, integer)


def _is_narrow(function: TransferFunction, low: float, high: float, count: int) -> bool:
    """Whether ``count`` evenly spaced nodes would misplace a step, or an interval between control points."""
    gaps = np.diff(_knots(function, low, high)[0])
    return bool(gaps.min() * (count - 1) < _NARROW * (high - low))


def _warped(
    function: TransferFunction, low: float, high: float, count: int, integer: bool
) -> LookupNodes:
    knots, opacities = _knots(function, low, high)
    lengths = np.diff(knots)
    if integer:  # bin edges on integers, so that steps of integer data stay sharp
        per_bin = max(1.0, np.ceil((high - low) / BINS))
        if high - low <= MOST_BINS and lengths.min() < _NARROW * per_bin:
            per_bin = 1.0
        per_value = max(1.0, BINS // (high - low)) if per_bin == 1.0 else 1.0 / per_bin
        bins = int(np.ceil((high - low) * per_value))
    else:
        apart = lengths[lengths * MOST_BINS >= _BINS_APART * (high - low)]
        bins = BINS if apart.size == lengths.size else STEP_BINS
        while bins < MOST_BINS and apart.min(initial=high - low) * bins < _BINS_APART * (high - low):
            bins *= 2
        per_value = bins / (high - low)
    edges = low + np.arange(bins + 1) / per_value

    share = np.concatenate([[0.0], np.cumsum(_density(knots, opacities, edges))])
    share /= share[-1]
    at = np.interp(knots, edges, share)
    # A whole number of nodes between knots; a step is an interval of length 0 and takes one.
    spare = count - 1 - lengths.size
    cells = np.where(lengths > 0, 1 + np.floor(np.diff(at) * spare), 1)
    at_knots = np.concatenate([[0.0], np.cumsum(cells)])

    # Right-continuous at steps, like the transfer function.
    k = np.clip(np.searchsorted(knots, edges, side="right") - 1, 0, lengths.size - 1)
    span = at[k + 1] - at[k]
    w = np.where(span > 0, (share - at[k]) / np.where(span > 0, span, 1.0), 1.0)
    warp = at_knots[k] + np.clip(w, 0.0, 1.0) * cells[k]
    warp[0], warp[-1] = 0.0, at_knots[-1]
    warp = np.maximum.accumulate(warp)
    met = _meet_knots(warp, (knots - low) * per_value, at_knots, exact=integer)
    warp = np.maximum.accumulate(warp).astype(np.float32)
    n = int(at_knots[-1]) + 1
    # A node's value is the one that the warp maps to it.
    values = np.interp(np.arange(n), warp.astype(np.float64), edges)
    values[at_knots[met].astype(np.int64)] = knots[met]
    return LookupNodes(values, low, float(per_value), warp)


def _meet_knots(
    warp: np.ndarray, places: np.ndarray, at_knots: np.ndarray, exact: bool
) -> np.ndarray:
    """Shifts the edges of the bins that hold knots, at ``places`` (in bins), so that the coordinate of a knot is its
    node. Returns the indices of the knots for which that succeeds, int [m].

    At a step the coordinate is that of the later node; what leads up to it lies in the bin before. Unless float32
    computes positions exactly, the coordinate there is slightly beyond the node, where nothing of the jump is left.
    """
    met = []
    for i in range(1, places.size - 1):
        is_step = places[i] == places[i - 1]
        nearest = min(places[i] - places[i - 1 - is_step], places[i + 1] - places[i])
        if nearest < _BINS_APART or (exact and places[i] == int(places[i])):
            continue  # there is no node to meet, or it is met already
        margin = _STEP_MARGIN if is_step and not exact else 0.0
        b = int(np.floor(places[i] - margin))
        if b < 1 or b + 2 >= warp.size:
            continue
        node, share = at_knots[i], places[i] - margin - b
        slope = min(warp[b + 1] - warp[b], node - warp[b - 1], warp[b + 2] - node, 0.5)
        if is_step:
            slope = min(slope, _STEP_MARGIN)
        warp[b], warp[b + 1] = node - share * slope, node + (1.0 - share) * slope
        if is_step:  # the knot may lie just beyond
            warp[b + 2] = min(warp[b + 2], warp[b + 1] + slope)
        met.append(i)
    return np.array(met, np.int64)


def _density(knots: np.ndarray, opacities: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """The relative number of nodes for each bin between ``edges``."""
    middle, bin_width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    visible = np.maximum(opacities[:-1], opacities[1:]) > 0
    even = np.full(middle.size, 1.0 / middle.size)
    if not visible.any():
        return even
    from_, to = knots[:-1][visible], knots[1:][visible]
    inside = np.zeros(middle.size)
    around = np.zeros(middle.size)
    for a, b in zip(from_, to):
        width = max(b - a, bin_width)
        overlap = np.clip(np.minimum(edges[1:], b) - np.maximum(edges[:-1], a), 0, None)
        if b > a:
            # Half of the nodes are shared equally by intervals, half by their lengths.
            inside += overlap / (b - a) * 0.5 / visible.sum()
            inside += overlap / np.sum(to - from_) * 0.5
        distance = np.maximum(np.maximum(a - middle, middle - b), 0.0)
        around = np.maximum(around, 1.0 / (distance + max(width / 8, bin_width)))
    inside = inside / inside.sum() if inside.sum() > 0 else even
    return _EVEN * even + _VISIBLE * inside + _AROUND * around / around.sum()


def _knots(
    function: TransferFunction, low: float, high: float
) -> tuple[np.ndarray, np.ndarray]:
    """Control points inside the range, and its ends. A step at the upper end appears twice."""
    inside = (function.values > low) & (function.values < high)
    at_high = np.flatnonzero(function.values == high)
    inside[at_high[:-1]] = True
    ends = function.opacity(np.array([low, high]))
    knots = np.concatenate([[low], function.values[inside], [high]])
    return knots, np.concatenate([ends[:1], function.opacities[inside], ends[1:]])


def visible_cells(function: TransferFunction, nodes: np.ndarray) -> np.ndarray:
    """Whether any value between nodes k and k + 1, inclusive, has opacity: bool [n - 1]."""
    at = function.opacity(nodes) > 0
    visible = at[:-1] | at[1:]
    shown = function.values[function.opacities > 0]
    # A control point with opacity makes the open intervals on both its sides visible.
    for side in ("left", "right"):
        k = np.searchsorted(nodes, shown, side=side) - 1
        k = k[(k >= 0) & (k < visible.size)]
        visible[k] = True
    return visible
