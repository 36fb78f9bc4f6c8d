"""The appearance of blocks under a transfer function, from their statistics: whether a block is visible, and the
visible error of each level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clvol.integrators.multiresolution.luv import linear_to_luv
from clvol.scene.glow import Glow
from clvol.store.source import QUANTILES, BlockStatistics
from clvol.transfer import TransferFunction
from clvol.transfer.cycle import limits

_ENTRIES = 1 << 15
_PIECE = 1 << 11  # blocks processed together: few enough for the caches
# The share of the path over which the mixture of a block's values is compared: one voxel of a block of 16^3.
_MEDIUM_PATH = 0.0625
_OPAQUE = 50.0  # optical depth, at most
# The weight of a voxel's own error relative to that of the mixture: along a ray and over neighbouring ones
# most of it cancels.
_OF_VOXELS = 0.1
# The weight of what is lost with gradients: ``spread_errors``.
_OF_GRADIENTS = 0.1
# The groups of the lowest and the highest quantile are divided into parts, finer towards the extreme, so
# that a few visible voxels are not lost in the group's mean. With them a histogram has 16 nodes.
_TAIL = np.array([0.0, 0.5, 0.75, 0.9, 0.97, 1.0])
_SHARES = np.diff(_TAIL)
NODE_WEIGHTS = np.concatenate([_SHARES[::-1], np.ones(QUANTILES - 2), _SHARES]) / QUANTILES
NODE_WEIGHTS = NODE_WEIGHTS.astype(np.float32)
# Orders that pair each node with low and high ones of the level alike: bits of the number reversed,
# and the mirror image. Of the tails, the level's nodes contain only the greatest part.
_REVERSED = np.array([int(f"{k:03b}"[::-1], 2) for k in range(QUANTILES)])
_HEAVY = len(_SHARES) - 1 + _REVERSED[np.arange(len(NODE_WEIGHTS)) % QUANTILES]
_ORDERS = (_HEAVY, len(NODE_WEIGHTS) - 1 - _HEAVY)


def transparent(statistics: BlockStatistics, function: TransferFunction, glow: Glow | None = None) -> np.ndarray:
    """bool [n]: whether ``function``, and with it the light of ``glow``, shows nothing over reach_low ... reach_high,
    or no voxel there is finite.

    Exact for the piecewise linear opacity, steps (two points of one value) included: the points at
    which, or towards which, it is read in that interval all have opacity 0.
    """
    low, high = statistics.reach_low, statistics.reach_high
    known = low <= high
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    values = function.values
    last = values.size - 1
    first = np.maximum(np.searchsorted(values, low, side="right") - 1, 0)
    end = np.searchsorted(values, high, side="right") - 1
    # A value past a point is mixed with the next one; below the first and above the last it is
    # theirs alone.
    below = end < 0
    end = np.clip(end, 0, last)
    end = np.where(~below & (high > values[end]), np.minimum(end + 1, last), end)
    opaque = np.concatenate([[0], np.cumsum(function.opacities > 0)])
    empty = ~known | (opaque[end + 1] == opaque[first])
    return empty if glow is None else empty & transparent(statistics, glow.shape)


class ShownColors:
    """L*, u*, v* of a ray's colour after ``path_length`` (world) of one value, over
    ``background`` (linear [3]), with the light of ``glow``.

    This is a table with equally many entries for each piece of ``function`` between two points, from which the nearest
    one is taken: even narrow pieces are resolved, and jumps are kept. NaN shows the
    background.
    """

    def __init__(
        self, function: TransferFunction, path_length: float, background: np.ndarray, glow: Glow | None = None
    ) -> None:
        light = np.zeros((len(function.values), 3))
        if glow is not None:
            function, light = _with_light(function, glow)
        values, exponent = function.values, path_length / function.opacity_unit
        pieces = np.flatnonzero(values[1:] > values[:-1])
        entries = max(_ENTRIES // max(len(pieces), 1), 64)
        t = np.linspace(0.0, 1.0, entries)[None, :, None]

        def between(table: np.ndarray) -> np.ndarray:
            """[entries of all pieces, k]; before them one for NaN and the first point, behind them
            the last one."""
            mixed = table[pieces, None] * (1.0 - t) + table[pieces + 1, None] * t
            ends = table[:1], table[-1:]
            return np.concatenate([ends[0], ends[0], mixed.reshape(-1, table.shape[1]), ends[1]])

        opacities = between(function.opacities[:, None])
        opacities[0] = 0.0
        with np.errstate(divide="ignore", over="ignore", under="ignore"):
            alpha = -np.expm1(exponent * np.log1p(-opacities))
        background = np.asarray(background, np.float64)
        shown = between(function.colors) * alpha + background * (1.0 - alpha)
        emitted = path_length * between(light)
        emitted[0] = 0.0
        if glow is not None:
            with np.errstate(divide="ignore", over="ignore"):
                shown += emitted * _share_that_leaves(-exponent * np.log1p(-opacities), alpha)
        self._luv = np.ascontiguousarray(linear_to_luv(shown).T, np.float32)
        # The medium itself over a part of the path: optical depth, and colour times it.
        with np.errstate(divide="ignore"):
            depths = -exponent * _MEDIUM_PATH * np.log1p(-opacities)
        depths = np.minimum(depths, _OPAQUE)
        self._medium = np.ascontiguousarray(
            np.concatenate([depths, depths * between(function.colors) + _MEDIUM_PATH * emitted], axis=1).T, np.float32
        )
        self._background = background
        self._transmittances = (1.0 - alpha[:, 0]).astype(np.float32)
        starts = 2 + entries * np.arange(len(pieces))
        self._values = np.stack([values[pieces], values[pieces + 1]], axis=1).ravel()
        self._values = np.append(self._values, values[-1])
        self._places = np.stack([starts, starts + entries - 1], axis=1).ravel().astype(np.float64)
        self._places = np.append(self._places, self._transmittances.size - 1)

    def places(self, values: np.ndarray) -> np.ndarray:
        """Entries of the table for ``values``, intp of the same shape."""
        found = np.interp(values, self._values, self._places, left=1.0)
        np.copyto(found, 0.0, where=np.isnan(found))
        return np.rint(found, out=found).astype(np.intp)

    def luv(self, places: np.ndarray) -> list[np.ndarray]:
        """L*, u* and v*, float32."""
        return [component.take(places) for component in self._luv]

    def mixture(self, places: np.ndarray) -> list[np.ndarray]:
        """L*, u* and v* [k] of a ray's colour after a sixteenth of the path in a mixture of the values
        ``places`` [k, nodes], weighted by ``NODE_WEIGHTS``."""
        return self.mixture_of((places,))

    def mixture_of(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """As ``mixture``, of several sets of values in equal shares."""
        depth, *emission = (
            sum(component.take(places) @ NODE_WEIGHTS for places in parts) / len(parts) for component in self._medium
        )
        alpha = -np.expm1(-depth)
        share = _share_that_leaves(depth, alpha)
        shown = [e * share + b * (1.0 - alpha) for e, b in zip(emission, self._background)]
        return list(linear_to_luv(np.stack(shown, axis=-1)).T)

    def transmittance(self, places: np.ndarray) -> np.ndarray:
        """float32, of ``path_length``."""
        return self._transmittances[places]


def _share_that_leaves(depth: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """The share of light, emitted evenly along a path of optical depth ``depth`` and opacity ``alpha``, that leaves it.
    """
    return np.where(depth > 0, alpha / np.where(depth > 0, depth, 1.0), 1.0)


def _with_light(function: TransferFunction, glow: Glow) -> tuple[TransferFunction, np.ndarray]:
    """``function`` with the points of ``glow`` among its own, and the light [n, 3] per world length at its points."""
    knots = np.unique(np.concatenate([function.values, glow.values]))
    brightest = max(float(glow.light.max()), 1e-300)
    light = TransferFunction(glow.values, np.zeros(len(glow.values)), glow.light / brightest)
    rows = np.empty((len(knots), 2, 7))
    for k, side in enumerate(("left", "right")):
        rows[:, k, :4] = limits(function, knots, side)
        rows[:, k, 4:] = limits(light, knots, side)[:, 1:]
    points = rows.reshape(-1, 7)
    both = TransferFunction(np.repeat(knots, 2), points[:, 0], points[:, 1:4], function.opacity_unit)
    return both, points[:, 4:] * brightest


def block_errors(
    statistics: BlockStatistics,
    function: TransferFunction,
    path_length: float,
    background: np.ndarray,
) -> np.ndarray:
    """float32 [levels, n]: estimated Delta-E (CIELUV) between a block's appearance at full resolution
    and at a level, over ``background`` (linear [3]); 0 at level 0, not falling with the level,
    finite. ``path_length`` (world): a block's edge.

    Values that are not finite are ignored; a level without finite values shows the background.

    It is the sum of two parts. First, the mixture: Delta-E between a ray's colours after a sixteenth
    of the path in the mean media of both histograms (means of extinction and emission).
    Second, a tenth of the mean Delta-E over the voxels between the colours of the voxel and of the level's sample
    there along the whole path. A pixel adds up many voxels, so differences that
    cancel (noise) are not visible, and the loss of thin structures is. Whole
    pictures against full resolution, mean CIEDE2000, voxels alone -> mixture behind a quarter of the
    path and a tenth of voxels -> behind a sixteenth: chest at 16 MiB 1.02 -> 0.80 -> 0.65; vismale at
    2 MiB 0.13 -> 0.13; aneurism at 1.8 MB 0.63 -> 0.58; engine with narrow peaks at 2 MiB 1.61 -> 1.58.

    The voxels' part is the mean of three estimates, all of which are exact where a level is one sample (up to the
    histogram's coarseness):
      plain    quantile j of the voxels against quantile j of the level: too low, as it misses that
               values changed places
      paired   the level's quantiles against voxels spread about each like the block's own
               quantiles about their mean, scaled so that they deviate from it by ``deviation``; low
               and high ones are paired alike
      scaled   the one sample's plain estimate times the share of the block's deviation that the
               level has
    The outermost quantiles are spread out to the least and largest voxel (``_tail``): without that
    a few opaque voxels may have no error.

    Compared on 128^3 of engine, cthead, vismale and tooth with eight transfer functions, a path of
    a block's edge. Estimate / true error (voxel by voxel), correlation and rms difference over
    blocks and levels; and by how much the true error left by a selection from the estimates is more
    than by one from true errors, at 1/4, 1/10 and 1/25 of all bytes (geometric means):
      plain                       0.54  0.876  0.48   +16 %  +8 %  +6 %
      level +- deviation          1.52  0.900  0.63   +15 %  +9 %  +9 %
      max(plain, +- deviation)    1.53  0.905  0.63   +13 %  +8 %  +8 %
      paired                      1.15  0.913  0.36   +14 %  +8 %  +7 %
      scaled                      1.21  0.883  0.45    +9 %  +4 %  +3 %
      mean of plain and paired    0.84  0.947  0.27    +9 %  +4 %  +4 %
      mean of all three           0.96  0.950  0.22    +7 %  +3 %  +4 %
      the same, with tails        0.99  0.954  0.21    +7 %  +2 %  +3 %
    Delta-E of the whole picture against full resolution, likewise: plain +17, +5, +8 %; the last
    +11, +2, +6 %. The path matters little: with paths from a sixteenth of an edge to two edges,
    pictures of chest (every other column, held in 8, 4 or 2 of 34 MiB, four transfer functions)
    were wrong by Delta-E within 8 % of each other.
    """
    return estimated_errors(statistics, ShownColors(function, path_length, background))


def estimated_errors(
    statistics: BlockStatistics, shown: ShownColors, wanted: np.ndarray | None = None
) -> np.ndarray:
    """``block_errors`` with an existing table; 0 for blocks that are not ``wanted`` (bool [n])."""
    out = np.zeros(statistics.mean.shape, np.float32)
    # A constant block is the same at all levels.
    varied = (statistics.minimum[0] < statistics.maximum[0]) | statistics.holes
    blocks = np.flatnonzero(varied if wanted is None else varied & wanted)
    for first in range(0, len(blocks), _PIECE):
        piece = blocks[first : first + _PIECE]
        found = _estimate(
            statistics.quantiles[:, piece],
            statistics.minimum[:, piece],
            statistics.maximum[:, piece],
            statistics.deviation[:, piece],
            shown,
        )
        found *= _OF_VOXELS
        found += _mixture_errors(
            statistics.quantiles[:, piece],
            statistics.minimum[:, piece],
            statistics.maximum[:, piece],
            shown,
        )
        out[:, piece] = np.maximum.accumulate(found, axis=0)
    return out


def noise_errors(statistics: BlockStatistics, deviation: np.ndarray, shown: ShownColors) -> np.ndarray:
    """float32 [n]: the estimated Delta-E, made of the same two parts as ``block_errors``, of blocks at full resolution
    whose voxels are wrong by ``deviation`` float [n] (root mean square), as of a lossy code: each node of the histogram
    stands for two values that far apart from it. Blocks with holes, which a code that is cut loses, count as if they
    had nothing but their mean."""
    out = np.zeros(len(deviation), np.float32)
    blocks = np.flatnonzero((deviation > 0) & (statistics.minimum[0] < statistics.maximum[0]))
    for first in range(0, len(blocks), _PIECE):
        part = blocks[first : first + _PIECE]
        nodes = histogram_nodes(statistics.quantiles[0, part], statistics.minimum[0, part], statistics.maximum[0, part])
        amount = np.asarray(deviation[part], np.float64)[:, None]
        places = shown.places(nodes), shown.places(nodes - amount), shown.places(nodes + amount)
        whole, *moved = (shown.luv(each) for each in places)
        for each in moved:
            out[part] += np.float32(0.5 * _OF_VOXELS) * _mean_delta_e(whole, each)
        a, b = shown.mixture(places[0]), shown.mixture_of(places[1:])
        out[part] += np.sqrt(sum((u - v) ** 2 for u, v in zip(a, b))).astype(np.float32)
    return out


def spread_errors(statistics: BlockStatistics, looks: Sequence[ShownColors]) -> np.ndarray:
    """float32 [levels, n]: the estimated Delta-E of values that look like any of ``looks``, depending on the gradient:
    a tenth of the largest one between the mixtures of a block's values that all look like one of them, in the share of
    the block's deviation, and so of its gradients, that a level has lost.

    Pictures by blocks against all voxels, RMSE in sRGB, of weights 0, 0.1, 0.3, 1 (by a factor from 0 on; by layers):
      cthead in 1500 KiB  0.028, 0.027, 0.028, 0.036;  0.032, 0.032, 0.033, 0.034
      tooth in 1 MiB      0.056, 0.032, 0.031, 0.031;  0.0098, 0.0087, 0.0089, 0.0093
    By the transfer function alone: 0.051 and 0.046; 0.031 and 0.0097."""
    out = np.zeros(statistics.mean.shape, np.float32)
    blocks = np.flatnonzero(statistics.minimum[0] < statistics.maximum[0])
    for first in range(0, len(blocks), _PIECE):
        piece = blocks[first : first + _PIECE]
        nodes = histogram_nodes(
            statistics.quantiles[0, piece], statistics.minimum[0, piece], statistics.maximum[0, piece]
        )
        own, *others = (look.mixture(look.places(nodes)) for look in looks)
        spread = np.zeros(len(piece))
        for other in others:
            spread = np.maximum(spread, np.sqrt(sum((a - b) ** 2 for a, b in zip(own, other))))
        deviation = statistics.deviation[:, piece]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            lost = np.where(deviation[-1] > 0, np.minimum(deviation / deviation[-1], 1.0), 0.0)
        out[:, piece] = _OF_GRADIENTS * np.maximum.accumulate(np.nan_to_num(lost * spread), axis=0)
    return out


def _mixture_errors(
    quantiles: np.ndarray, minimum: np.ndarray, maximum: np.ndarray, shown: ShownColors
) -> np.ndarray:
    """float32 [levels, k]: Delta-E between the mixtures of the block's values and of each level's."""
    nodes = (histogram_nodes(*level) for level in zip(quantiles, minimum, maximum))
    full, *others = (shown.mixture(shown.places(values)) for values in nodes)
    out = np.zeros(quantiles.shape[:2], np.float32)
    for level, luv in enumerate(others, 1):
        out[level] = np.sqrt(sum((a - b) ** 2 for a, b in zip(full, luv)))
    return out


def _estimate(
    quantiles: np.ndarray,
    minimum: np.ndarray,
    maximum: np.ndarray,
    deviation: np.ndarray,
    shown: ShownColors,
) -> np.ndarray:
    """float32 [levels, k] for k blocks, level by level."""
    out = np.zeros(deviation.shape, np.float32)
    full = histogram_nodes(quantiles[0], minimum[0], maximum[0])
    full_luv = shown.luv(shown.places(full))
    low, high = minimum[0][:, None], maximum[0][:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        spread = full - (full * NODE_WEIGHTS).sum(axis=1)[:, None]
        # The last level is one sample: its deviation is the block's own.
        parts = np.where(deviation[-1] > 0, np.minimum(deviation / deviation[-1], 1.0), 0.0)
    parts = np.nan_to_num(parts)
    last = len(quantiles) - 1
    for level in range(last, 0, -1):
        samples = histogram_nodes(quantiles[level], minimum[level], maximum[level])
        luv = shown.luv(shown.places(samples))
        plain = _mean_delta_e(full_luv, luv)
        if level == last:
            out[level] = plain
            continue
        paired = np.zeros(len(plain), np.float32)
        for order in _ORDERS:
            with np.errstate(invalid="ignore", over="ignore"):
                voxels = samples[:, order] + parts[level][:, None] * spread
            voxels = np.clip(voxels, low, high)
            near = [component[:, order] for component in luv]
            paired += _mean_delta_e(shown.luv(shown.places(voxels)), near) / len(_ORDERS)
        out[level] = (plain + paired + parts[level] * out[last]) / 3.0
    return out


def histogram_nodes(quantiles: np.ndarray, minimum: np.ndarray, maximum: np.ndarray) -> np.ndarray:
    """float64 [k, 16], ascending, of weights ``NODE_WEIGHTS``: ``quantiles`` [k, 8] with the outer two
    in parts."""
    q = quantiles.astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore", under="ignore"):
        bottom = -_tail(-q[:, 1], -q[:, 0], -minimum)
        top = _tail(q[:, -2], q[:, -1], maximum)
    return np.concatenate([bottom[:, ::-1], q[:, 1:-1], top], axis=1)


def _tail(inner: np.ndarray, mean: np.ndarray, extreme: np.ndarray) -> np.ndarray:
    """[k, 5]: means of the parts ``_TAIL`` of a group of values that rise from somewhere beyond
    ``inner`` to ``extreme`` as a power, of which the whole group's ``mean`` makes the exponent."""
    start = np.maximum(inner, 2.0 * mean - extreme)
    room = extreme - start
    skewed = room > 0
    share = np.where(skewed, (mean - start) / np.where(skewed, room, 1.0), 0.5)
    share = np.clip(share, 1e-4, 0.5)
    powers = _TAIL ** (1.0 / share)[:, None]
    found = start[:, None] + (room * share)[:, None] * (np.diff(powers, axis=1) / _SHARES)
    return np.where(skewed[:, None], found, mean[:, None])


def _mean_delta_e(a: list[np.ndarray], b: list[np.ndarray]) -> np.ndarray:
    """float32 [k] of L*, u*, v*, each [k, quantiles]."""
    squares = np.zeros_like(a[0])
    for one, other in zip(a, b):
        difference = one - other
        difference *= difference
        squares += difference
    return np.sqrt(squares, out=squares) @ NODE_WEIGHTS


def block_transmittances(statistics: BlockStatistics, shown: ShownColors) -> np.ndarray:
    """float32 [n]: mean over a block's voxels of the transmittance of ``path_length`` of each.

    This is the transmittance if each ray met only one value, an upper bound for all arrangements of the same
    values. Blocks with holes count as clear.
    """
    found = shown.transmittance(shown.places(statistics.quantiles[0])).mean(axis=-1)
    return np.where(statistics.holes, np.float32(1.0), found)
