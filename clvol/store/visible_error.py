"""What a transfer function makes of a block's statistics: whether it shows at all, and how wrong a level looks."""

from __future__ import annotations

import numpy as np

from clvol.store.luv import linear_to_luv
from clvol.store.source import QUANTILES, BlockStatistics
from clvol.transfer import TransferFunction

_ENTRIES = 1 << 15
_PIECE = 1 << 14  # blocks looked at together
# Orders that pair each quantile with low and high ones alike: bits of the number reversed, forwards and backwards.
_FORWARD = np.array([int(f"{k:03b}"[::-1], 2) for k in range(QUANTILES)])
_ORDERS = (_FORWARD, _FORWARD[::-1])


def transparent(statistics: BlockStatistics, function: TransferFunction) -> np.ndarray:
    """bool [n]: ``function`` shows nothing over reach_low ... reach_high, or no voxel of those is finite.

    Exact for the piecewise linear opacity, steps (two points of one value) included: the points at which, or
    towards which, it is read in that interval all have opacity 0.
    """
    low, high = statistics.reach_low, statistics.reach_high
    known = low <= high
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    values = function.values
    last = values.size - 1
    first = np.maximum(np.searchsorted(values, low, side="right") - 1, 0)
    end = np.searchsorted(values, high, side="right") - 1
    # A value past a point is mixed with the next one; below the first and above the last it is theirs alone.
    below = end < 0
    end = np.clip(end, 0, last)
    end = np.where(~below & (high > values[end]), np.minimum(end + 1, last), end)
    opaque = np.concatenate([[0], np.cumsum(function.opacities > 0)])
    return ~known | (opaque[end + 1] == opaque[first])


class ShownColors:
    """L*, u*, v* of what a ray shows behind ``path_length`` (world) of one value, over ``background`` (linear [3]).

    A table: equally many entries for each piece of ``function`` between two points, the nearest one taken, so that pieces are
    resolved alike however narrow, and steps are steps.
    """

    def __init__(
        self, function: TransferFunction, path_length: float, background: np.ndarray
    ) -> None:
        values, exponent = function.values, path_length / function.opacity_unit
        pieces = np.flatnonzero(values[1:] > values[:-1])
        entries = max(_ENTRIES // max(len(pieces), 1), 64)
        t = np.linspace(0.0, 1.0, entries)[None, :, None]

        def between(table: np.ndarray) -> np.ndarray:
            """[entries of all pieces, k], the first point before and the last behind them."""
            mixed = table[pieces, None] * (1.0 - t) + table[pieces + 1, None] * t
            return np.concatenate([table[:1], mixed.reshape(-1, table.shape[1]), table[-1:]])

        opacities = between(function.opacities[:, None])
        with np.errstate(divide="ignore", over="ignore", under="ignore"):
            alpha = -np.expm1(exponent * np.log1p(-opacities))
        background = np.asarray(background, np.float64)
        shown = between(function.colors) * alpha + background * (1.0 - alpha)
        self._luv = np.ascontiguousarray(linear_to_luv(shown).T, np.float32)
        self._transmittances = (1.0 - alpha[:, 0]).astype(np.float32)
        starts = 1 + entries * np.arange(len(pieces))
        self._values = np.stack([values[pieces], values[pieces + 1]], axis=1).ravel()
        self._values = np.append(self._values, values[-1])
        self._places = np.stack([starts, starts + entries - 1], axis=1).ravel().astype(np.float64)
        self._places = np.append(self._places, self._transmittances.size - 1)

    def places(self, values: np.ndarray) -> np.ndarray:
        """Entries of the table for ``values``, intp of the same shape; NaN takes the first one."""
        found = np.interp(values, self._values, self._places, left=0.0)
        np.copyto(found, 0.0, where=np.isnan(found))
        return np.rint(found, out=found).astype(np.intp)

    def luv(self, places: np.ndarray) -> np.ndarray:
        """float32 [3, ...]."""
        return self._luv[:, places]

    def transmittance(self, places: np.ndarray) -> np.ndarray:
        """float32, of ``path_length``."""
        return self._transmittances[places]


def block_errors(
    statistics: BlockStatistics,
    function: TransferFunction,
    path_length: float,
    background: np.ndarray,
) -> np.ndarray:
    """float32 [levels, n]: estimated mean Delta-E (CIELUV) over a block's voxels between what the voxel and what the level's sample there
    show, each along ``path_length`` (world) over ``background`` (linear [3]); 0 at level 0, not falling with the level, finite.

    TEXT
    """
    return estimated_errors(statistics, ShownColors(function, path_length, background))


def estimated_errors(statistics: BlockStatistics, shown: ShownColors) -> np.ndarray:
    """``block_errors`` with the table at hand."""
    out = np.empty(statistics.mean.shape, np.float32)
    for first in range(0, out.shape[1], _PIECE):
        piece = slice(first, first + _PIECE)
        _estimate(
            statistics.quantiles[:, piece],
            statistics.deviation[:, piece],
            statistics.minimum[0, piece],
            statistics.maximum[0, piece],
            shown,
            out[:, piece],
        )
    return np.maximum.accumulate(out, axis=0, out=out)


def _estimate(
    quantiles: np.ndarray,
    deviation: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    shown: ShownColors,
    out: np.ndarray,
) -> None:
    full = quantiles[0].astype(np.float64)
    full_luv = shown.luv(shown.places(full))
    spread = full - _mean(full)[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # The last level is one sample: its deviation is the block's own.
        parts = np.where(deviation[-1] > 0, np.minimum(deviation / deviation[-1], 1.0), 0.0)
    last = len(quantiles) - 1
    out[0] = 0.0
    for level in range(1, last + 1):
        samples = quantiles[level].astype(np.float64)
        luv = shown.luv(shown.places(samples))
        out[level] = _mean_delta_e(full_luv, luv)
        if level == last:
            break  # all voxels share the one sample: nothing is left to pair
        paired = np.zeros(out.shape[1], np.float32)
        for order in _ORDERS:
            with np.errstate(invalid="ignore", over="ignore"):
                voxels = samples + np.nan_to_num(parts[level])[:, None] * spread[:, order]
            voxels = np.clip(voxels, low[:, None], high[:, None])
            paired += _mean_delta_e(shown.luv(shown.places(voxels)), luv)
        out[level] = 0.5 * (out[level] + paired / len(_ORDERS))


def _mean(values: np.ndarray) -> np.ndarray:
    """Over the last axis, of values whose sum may overflow."""
    return (values / values.shape[-1]).sum(axis=-1)


def _mean_delta_e(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[k] of L*, u*, v* [3, k, quantiles]."""
    difference = a - b
    difference *= difference
    return np.sqrt(difference.sum(axis=0)).mean(axis=-1)


def block_transmittances(statistics: BlockStatistics, shown: ShownColors) -> np.ndarray:
    """float32 [n]: mean over a block's voxels of what ``path_length`` of each lets through.

    As if rays met one value each, side by side: more than any other order of the same values lets through. Blocks with holes count
    as clear.
    """
    found = shown.transmittance(shown.places(statistics.quantiles[0])).mean(axis=-1)
    return np.where(statistics.holes, np.float32(1.0), found)
