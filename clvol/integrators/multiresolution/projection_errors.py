"""What a projection shows of blocks: which of them can show nothing, and the visible error of each level.

A maximum shows one value of each ray. Of a ray through a block of s samples per axis it is the largest of about s of
them; were these independent, quantile q of all such maxima would be quantile q^(1 / s) of the samples. A level's error
is the mean colour difference (CIELUV) between these quantiles of its samples and of the voxels. Whether another block
on the ray has a larger value is not known here, so that errors are what they are where none has. Minima are
alike. A mean shows the deviation of a level's field from the voxels, of which along the voxels of a block as much is
left as if they were independent, in the share that a block has of the longest ray.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from clvol.integrators.multiresolution.selection import SourceErrors
from clvol.integrators.multiresolution.visible_error import (
    NODE_WEIGHTS,
    ShownColors,
    histogram_nodes,
    transparent,
)
from clvol.store.source import BlockSource, BlockStatistics
from clvol.transfer import TransferFunction

_RAYS = (np.arange(8) + 0.5) / 8  # quantiles of what rays through a block show
_PIECE = 1 << 11  # blocks processed together


def projection_errors(
    source: BlockSource, function: TransferFunction, background: np.ndarray, mode: str
) -> SourceErrors:
    """As ``source_errors``, under the compositing ``mode``. No block hides another one."""
    blocks = source.blocks
    shown = projected_colors(function, background)
    errors = np.zeros((blocks.levels, blocks.count), np.float32)
    dropped = np.zeros(blocks.count, bool)
    per_value = _difference_per_value(shown, *source.value_range) / (max(blocks.counts) * np.sqrt(blocks.edge))
    for part in source.statistics():
        piece = slice(part.first, part.first + len(part.reach_low))
        dropped[piece] = shows_nothing(part, function, mode)
        if mode == "average":
            found = np.nan_to_num(part.deviation * per_value).astype(np.float32)
        else:
            found = _of_extremes(part, shown, mode)
        errors[:, piece] = np.maximum.accumulate(np.where(dropped[piece], np.float32(0.0), found), axis=0)
    return SourceErrors(errors, dropped, np.ones(blocks.count, np.float32))


def projected_colors(function: TransferFunction, background: np.ndarray) -> ShownColors:
    """The colours of single values: those of one opacity unit, over ``background`` (linear [3])."""
    return ShownColors(function, function.opacity_unit, background)


def shows_nothing(statistics: BlockStatistics, function: TransferFunction, mode: str) -> np.ndarray:
    """bool [n]: blocks that change no ray, whatever it meets: of a maximum (minimum) those all of whose values are
    transparent, with all values below (above) them. Under attenuation and in means every value counts."""
    known = statistics.reach_low <= statistics.reach_high
    if mode == "maximum":
        return transparent(replace(statistics, reach_low=np.where(known, -np.inf, np.inf)), function)
    if mode == "minimum":
        return transparent(replace(statistics, reach_high=np.where(known, np.inf, -np.inf)), function)
    return ~known


def _of_extremes(statistics: BlockStatistics, shown: ShownColors, mode: str) -> np.ndarray:
    """float32 [levels, n]."""
    out = np.zeros(statistics.mean.shape, np.float32)
    varied = np.flatnonzero(statistics.minimum[0] < statistics.maximum[0])
    for first in range(0, len(varied), _PIECE):
        piece = varied[first : first + _PIECE]
        whole: list[np.ndarray] | None = None
        for level, values in enumerate(_extremes(statistics, piece, mode)):
            luv = shown.luv(shown.places(values))
            whole = whole or luv
            out[level, piece] = np.sqrt(sum((a - b) ** 2 for a, b in zip(whole, luv))).mean(axis=1)
    return out


def _extremes(statistics: BlockStatistics, piece: np.ndarray, mode: str) -> Iterator[np.ndarray]:
    """float64 [k, rays] of each level: what rays through the blocks ``piece`` may show."""
    ends = np.cumsum(NODE_WEIGHTS, dtype=np.float64)
    middles = ends - 0.5 * NODE_WEIGHTS
    for level in range(len(statistics.mean)):
        samples = 1 << (len(statistics.mean) - 1 - level)
        nodes = histogram_nodes(
            statistics.quantiles[level, piece], statistics.minimum[level, piece], statistics.maximum[level, piece]
        )
        at = _RAYS ** (1.0 / samples)
        yield nodes @ _shares(middles, at if mode != "minimum" else 1.0 - at)


def _shares(places: np.ndarray, at: np.ndarray) -> np.ndarray:
    """float64 [places, at]: of what is known at ``places``, linear between them, the value at each of ``at``."""
    return np.stack([np.interp(at, places, row) for row in np.eye(len(places))])


def _difference_per_value(shown: ShownColors, low: float, high: float) -> float:
    """Colour difference per unit of value, in the mean over low ... high; 0 where that is no range."""
    if not low < high:
        return 0.0
    luv = shown.luv(shown.places(np.linspace(low, high, 257)))
    return float(np.sqrt(sum(np.diff(component) ** 2 for component in luv)).sum() / (high - low))
