"""What a transfer function makes of a block's statistics: whether it shows at all, and how wrong a level looks."""

from __future__ import annotations

import numpy as np

from clvol.store.luv import delta_e_luv, linear_to_luv
from clvol.store.source import BlockStatistics
from clvol.transfer import TransferFunction

_ENTRIES = 1 << 15
_PIECE = 1 << 16  # blocks looked at together


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
        self._table = linear_to_luv(shown).astype(np.float32)
        self.transmittances = (1.0 - alpha[:, 0]).astype(np.float32)
        starts = 1 + entries * np.arange(len(pieces))
        self._values = np.stack([values[pieces], values[pieces + 1]], axis=1).ravel()
        self._values = np.append(self._values, values[-1])
        self._places = np.stack([starts, starts + entries - 1], axis=1).ravel().astype(np.float64)
        self._places = np.append(self._places, len(self._table) - 1)

    def places(self, values: np.ndarray) -> np.ndarray:
        """Entries of the table, intp of ``values``' shape; NaN takes the first one."""
        found = np.interp(values, self._values, self._places, left=0.0)
        return np.rint(np.where(np.isnan(found), 0.0, found)).astype(np.intp)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """float32 [..., 3] of ``values`` [...]."""
        return self._table[self.places(values)]
