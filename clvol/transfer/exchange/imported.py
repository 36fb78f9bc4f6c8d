"""What a file or a colour map of another tool says: colours and, perhaps, opacities over values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from clvol.errors import SceneError
from clvol.transfer.exchange.sampled import Knots, Points, merged

DEFAULT_OPACITY = ((0.0, 0.0), (1.0, 0.5))

# An opacity curve over a range: opacities, evenly spaced, or pairs of position in [0, 1] and opacity.
OpacityCurve = Sequence[float] | Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Imported:
    """``colors`` are knots in linear light; ``opacities`` knots [n, 1], None where the source has none.

    ``opacity_unit`` is the world length that the source states, or None. ``is_relative``: the source has no values of
    its own (a colour map), so its knots go from 0 to 1. ``notes`` are what was left out, one sentence each.
    """

    where: str
    colors: Knots
    opacities: Knots | None = None
    opacity_unit: float | None = None
    is_relative: bool = False
    notes: tuple[str, ...] = field(default=())

    def points(
        self,
        value_range: Sequence[float] | None = None,
        opacity: OpacityCurve | None = None,
        opacity_unit: float = 1.0,
    ) -> Points:
        """The arguments of the transfer function, moved to ``value_range`` (low, high) if it is given.

        ``opacity`` replaces the source's opacities; without either, opacity rises from 0 to 0.5 over the range.
        ``opacity_unit`` is used where the source states none. SceneError for an impossible range or curve.
        """
        values = self.colors[0] if self.opacities is None else np.union1d(self.colors[0], self.opacities[0])
        low, high = float(values.min()), float(values.max())
        wanted = (low, high) if value_range is None else checked_range(value_range, self.where)
        if value_range is not None and low == high and wanted[0] < wanted[1]:
            raise SceneError(self.where, f"all points at {low:g}", "points at two values or more, or no range")
        colors = _moved(self.colors, (low, high), wanted)
        opacities = None if self.opacities is None else _moved(self.opacities, (low, high), wanted)
        if opacity is not None or opacities is None:
            opacities = curve_knots(DEFAULT_OPACITY if opacity is None else opacity, wanted, self.where)
        return merged(colors, opacities, self.opacity_unit or opacity_unit)


def checked_range(value_range: Sequence[float], where: str) -> tuple[float, float]:
    """SceneError unless ``value_range`` is two finite numbers, ascending."""
    try:
        low, high = (float(end) for end in value_range)
    except (TypeError, ValueError):
        low = high = math.nan
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise SceneError(where, f"got the range {value_range!r}", "two finite numbers [low, high], ascending")
    return low, high


def curve_knots(opacity: OpacityCurve, wanted: tuple[float, float], where: str) -> Knots:
    """The knots of an opacity curve over the range ``wanted``."""
    expected = "opacities from 0 to 1, or pairs [position, opacity] with ascending positions from 0 to 1"
    try:
        table = np.array(opacity, dtype=float)
    except (TypeError, ValueError):
        raise SceneError(where, "got an opacity curve that is no list of numbers", expected) from None
    if table.ndim == 1 and table.size:
        table = np.stack([np.linspace(0.0, 1.0, max(table.size, 2)), np.resize(table, max(table.size, 2))], axis=1)
    if table.ndim != 2 or table.shape[1] != 2 or not np.isfinite(table).all():
        raise SceneError(where, f"got an opacity curve of shape {table.shape}", expected)
    at = table[:, 0]
    if table.min() < 0 or table.max() > 1 or (np.diff(at) < 0).any() or (at[2:] == at[:-2]).any():
        raise SceneError(where, f"got the opacity curve {table.tolist()}"[:200], expected)
    low, high = wanted
    return low * (1.0 - at) + high * at, table[:, 1:]


def _moved(knots: Knots, span: tuple[float, float], wanted: tuple[float, float]) -> Knots:
    if span == wanted:
        return knots
    t = (knots[0] - span[0]) / (span[1] - span[0])
    return wanted[0] * (1.0 - t) + wanted[1] * t, knots[1]
