"""The number of steps that a ray may take at once in each block, for a bound on the error of one such segment.

Step control by the local error, as in solvers of differential equations, in place of the rule of one step per sample
(Ljung 2006). A segment of length l in a block whose field has slope at most G and curvature at most S
(``cl/block_bounds.cl``, ``cl/cell_curvature.cl``) adds to premultiplied colour or opacity an error of at most

  pre-integrated   l A min(S l^2 / 8, R)                        the field against its chord
  post             l (A S l^2 / 24 + K G l / 8), at most l B    the midpoint rule, A the slope of what the value emits
                                                                and absorbs, K how much that slope changes

over the values in the block: A, K and B (the variation of emission or extinction themselves) are taken from the
transfer function between the block's lowest and highest value, and R is its variation there. Attenuation in front only
lowers the error.
"""

from __future__ import annotations

import numpy as np

from clvol.transfer import TransferFunction

_OPAQUE = 1.0 - 1e-4  # larger opacities are lowered to this, so that optical depths stay finite


class RangeExtremes:
    """The maxima of ``values`` [n, channels] over any span, from a table of spans of powers of two."""

    def __init__(self, values: np.ndarray) -> None:
        values = np.asarray(values, np.float64)
        # [k, i]: of 2^k values from the i-th
        self._table = np.zeros((max(len(values).bit_length(), 1), *values.shape))
        self._table[0] = values
        for k in range(1, len(self._table)):
            half, count = 1 << (k - 1), len(values) - (1 << k) + 1
            np.maximum(self._table[k - 1, :count], self._table[k - 1, half : half + count], out=self._table[k, :count])

    def largest(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """[spans, channels]: the maxima of the values from ``first`` to ``last`` >= ``first``, both included."""
        power = np.frexp(last - first + 1)[1] - 1
        return np.maximum(self._table[power, first], self._table[power, last + 1 - (1 << power)])


def most_steps(
    bounds: np.ndarray,
    function: TransferFunction,
    nodes: np.ndarray,
    step_length: float,
    step_voxels: float,
    error: float,
    edge: int,
    midpoints: bool,
    per_step: bool = False,
) -> np.ndarray:
    """uint8 [n], 1 ... ``edge``: the number of steps at once whose error is at most ``error``; ``per_step``: at most
    that times their number.

    ``bounds`` float [n, 4]: curvature, slope, lowest and highest value. ``function`` over the values that kernels
    compute with, and its ``nodes``. ``step_length``: world length of a step; ``step_voxels``: its greatest length in
    voxels along any axis.
    """
    curvature, slope, low, high = np.asarray(bounds, np.float64).T
    nodes = _with_knots(nodes, function.values)
    if len(nodes) == 1:  # a constant volume: nothing changes along any segment
        return np.full(len(bounds), edge, np.uint8)
    known = low <= high
    low, high = np.where(known, low, nodes[0]), np.where(known, high, nodes[0])
    first = np.clip(np.searchsorted(nodes, low, side="right") - 1, 0, len(nodes) - 2)
    last = np.clip(np.searchsorted(nodes, high, side="left") - 1, first, len(nodes) - 2)
    opacity, color = function.opacity_and_color(nodes)
    extinction = -np.log1p(-np.minimum(opacity, _OPAQUE)) / function.opacity_unit
    rates = np.concatenate([extinction[:, None], extinction[:, None] * color], axis=1)
    slopes = np.diff(rates, axis=0) / np.diff(nodes)[:, None]
    # Many cells have the same values: each span of nodes is looked at once.
    pairs, same = np.unique(first * len(nodes) + last, return_inverse=True)
    first, last = np.divmod(pairs, len(nodes))
    steepest, bend, difference = (each.max(axis=1)[same] for each in _spans(slopes, rates, first, last))
    steps = np.ones(len(bounds), np.int64)
    goes_on = np.ones(len(bounds), bool)
    for count in range(2, edge + 1):
        length, voxels = count * step_length, count * step_voxels
        if midpoints:
            found = steepest * curvature * voxels**2 / 24 + bend * slope * voxels / 8
            found = length * np.minimum(found, difference)
        else:
            found = length * steepest * np.minimum(curvature * voxels**2 / 8, high - low)
        goes_on &= found <= (error * count if per_step else error)
        steps[goes_on] = count
    return steps.astype(np.uint8)


def _with_knots(nodes: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """``nodes`` and, between them, all ``knots`` and the values just below them, so that no piece or jump is missed."""
    inside = knots[(knots > nodes[0]) & (knots < nodes[-1])]
    return np.unique(np.concatenate([nodes, inside, np.nextafter(inside, -np.inf)]))


def _spans(slopes: np.ndarray, rates: np.ndarray, first: np.ndarray, last: np.ndarray):
    """Largest slopes, differences of slopes, and differences of rates between nodes ``first`` and ``last`` + 1, each
    [spans, channels]."""
    channels = slopes.shape[1]
    ends = RangeExtremes(np.concatenate([slopes, -slopes], axis=1)).largest(first, last)
    up, down = ends[:, :channels], ends[:, channels:]
    bounds = RangeExtremes(np.concatenate([rates, -rates], axis=1)).largest(first, last + 1)
    return np.maximum(np.abs(up), np.abs(down)), up + down, bounds[:, :channels] + bounds[:, channels:]
