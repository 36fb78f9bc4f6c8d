"""Whether any sample of a volume can have both opacity and a gradient: it is either disproved or assumed.

Cells of the lattice are examined in bars from the middle of the volume outwards, since in most volumes the first bar
answers the question. A bar is examined cell by cell only if its range of values is visible at all, for a limited
number of bars; after that, such a sample is assumed to exist.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from weakref import WeakKeyDictionary

import numpy as np

from clvol.features.findings import has_no_gradient
from clvol.features.minification import has_levels
from clvol.features.values import field_overshoot
from clvol.features.vocabulary import FILTER_REACH
from clvol.scene.resolve import ResolvedScene
from clvol.store.source import BlockSource
from clvol.transfer import TransferFunction
from clvol.volume.series import StepVolume

_BAR = (4, 32)  # cells along z and y of a bar, which extends along all of x
_MOST_BARS = 32  # bars that are examined cell by cell
_CHUNK = 2**14  # varying cells that are examined together
_LARGEST_REACH = 8  # cells around a cell: with more, nothing is disproved
_found: WeakKeyDictionary = WeakKeyDictionary()  # volume: {question: answer}


def opacity_meets_gradient(scene: ResolvedScene, anywhere: bool) -> bool:
    """False only if no sample can have both opacity and a gradient.

    ``anywhere``: opacity does not depend on the volume's value alone, so any sample may have it.
    """
    if has_no_gradient(scene):  # non-finite voxels do not count
        return False
    integration = scene.integration
    if has_levels(integration):
        return True  # means join what holes part
    moved = bool(scene.noise) or (integration.filter == "cubic" and integration.prefilter)
    reach = FILTER_REACH[integration.filter]
    if integration.classification == "preintegrated":
        # A segment has the values of its ends, but the gradient at its middle.
        reach += int(np.ceil(0.5 * integration.step)) if integration.step < 100 else 100
    if moved or reach > _LARGEST_REACH:
        return True
    layers = (layer.function for layer in scene.transfer_layers)
    functions = None if anywhere else (scene.transfer_function, *layers)
    widen = field_overshoot(scene)
    if integration.classification == "preintegrated":
        widen += 1.0  # chords are shifted by their curvature
    if isinstance(scene.volume, StepVolume):
        return True  # in some step: all of them are rendered by the same program
    question = (functions, reach, widen)
    answers = _found.setdefault(scene.volume, {})
    if question not in answers:
        source = getattr(scene.volume, "blocks_source", None)
        if source is not None:
            answers[question] = _any_block(source, functions, reach, widen)
        else:
            answers[question] = _any_bar(scene.volume.data, functions, reach, widen)
    return answers[question]


def _any_block(
    source: BlockSource, functions: tuple[TransferFunction, ...] | None, reach: int, widen: float
) -> bool:
    """As ``_any_bar`` for a store, from the statistics of its blocks; no voxel is read."""
    from scipy.ndimage import maximum_filter, minimum_filter  # takes a tenth of a second

    if reach >= source.blocks.edge:
        return True
    ranges = [(part.reach_low, part.reach_high) for part in source.statistics()]
    low, high = (np.concatenate(part) for part in zip(*ranges))
    # A cell and its reach lie within a block and its neighbours.
    low = minimum_filter(low.reshape(source.blocks.counts), 3, mode="nearest")
    high = maximum_filter(high.reshape(source.blocks.counts), 3, mode="nearest")
    varied = low < high  # in blocks without values, low is above high
    if functions is None or not varied.any():
        return bool(varied.any())
    return _any_shows(functions, low[varied], high[varied], widen)


def _any_bar(
    data: np.ndarray, functions: tuple[TransferFunction, ...] | None, reach: int, widen: float
) -> bool:
    """Whether any cell can have a visible value while its gradient is not 0. A value comes from the corners of a cell
    and ``reach`` voxels around them, and exceeds their range by at most ``widen`` times its length.
    """
    read = 0
    for start in _from_the_middle(data.shape):
        if not _bar_can_show(data, start, functions, max(reach, 1), widen):
            continue
        read += 1
        if read > _MOST_BARS or _in_bar(data, start, functions, reach, widen):
            return True
    return False


def _bar_can_show(
    data: np.ndarray,
    start: tuple[int, int],
    functions: tuple[TransferFunction, ...] | None,
    pad: int,
    widen: float,
) -> bool:
    """Whether the values of a bar and ``pad`` voxels around it vary, and any value between them is visible."""
    z, y = (slice(max(f - pad, 0), f + n + 1 + pad) for f, n in zip(start, _BAR))
    bar = data[z, y]
    low, high = bar.min(), bar.max()
    if not (np.isfinite(low) and np.isfinite(high)):
        finite = bar[np.isfinite(bar)]
        low, high = (finite.min(), finite.max()) if finite.size else (0, 0)
    if low == high or functions is None:
        return bool(low < high)
    return _any_shows(functions, np.array([low]), np.array([high]), widen)


def _from_the_middle(shape: tuple[int, ...]) -> Iterator[tuple[int, int]]:
    """First cells (z, y) of bars, the innermost first."""
    orders = []
    for n, length in zip(shape, _BAR):
        starts = range(0, max(n - 1, 1), length)
        orders.append(sorted(starts, key=lambda start: abs(start + length / 2 - n / 2)))
    yield from itertools.product(*orders)


def _in_bar(
    data: np.ndarray,
    start: tuple[int, int],
    functions: tuple[TransferFunction, ...] | None,
    reach: int,
    widen: float,
) -> bool:
    """Whether a cell of the bar at ``start`` can have a visible value while its gradient is not 0.

    The gradient in a cell uses the voxels around it, a value those within ``reach`` of its corners.
    """
    pad = max(reach, 1)
    first = (*start, 0)
    most = [max(n - 1, 1) for n in data.shape]
    cells = tuple(min(b, n - f) for b, n, f in zip((*_BAR, most[2]), most, first))
    around = [
        np.clip(np.arange(f - pad, f + count + 1 + pad), 0, n - 1)
        for f, count, n in zip(first, cells, data.shape)
    ]
    bar = data[np.ix_(*around)]
    if bar.dtype.kind == "f":
        bar = np.where(np.isfinite(bar), bar, np.nan)  # fmin and fmax ignore NaN
    low, high = _extremes(bar, cells, pad, 1)
    varied = low < high
    if functions is None or not varied.any():
        return bool(varied.any())
    low, high = _extremes(bar, cells, pad, reach)
    low, high = low[varied], high[varied]
    return any(
        _any_shows(functions, low[k : k + _CHUNK], high[k : k + _CHUNK], widen)
        for k in range(0, low.size, _CHUNK)
    )


def _any_shows(
    functions: tuple[TransferFunction, ...], low: np.ndarray, high: np.ndarray, widen: float
) -> bool:
    low, high = low.astype(np.float64), high.astype(np.float64)
    with np.errstate(over="ignore"):
        more = widen * (high - low)
        low, high = low - more, high + more
    return any(_shows_between(function, low, high).any() for function in functions)


def _extremes(
    bar: np.ndarray, cells: tuple[int, ...], pad: int, reach: int
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest voxel among each cell's corners and ``reach`` voxels around them, ignoring NaN."""
    found = []
    for extreme in (np.fmin, np.fmax):
        part = bar
        for axis, count in enumerate(cells):
            n = part.shape[axis]
            at = [slice(None)] * 3
            at[axis] = slice(pad - reach, n)
            part, width, wanted = part[tuple(at)], 1, 2 + 2 * reach
            while width < wanted:
                step = min(width, wanted - width)
                n = part.shape[axis] - step
                here, there = at.copy(), at.copy()
                here[axis], there[axis] = slice(0, n), slice(step, step + n)
                part = extreme(part[tuple(here)], part[tuple(there)])
                width += step
            at[axis] = slice(0, count)
            part = part[tuple(at)]
        found.append(part)
    return found[0], found[1]


def _shows_between(function: TransferFunction, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Whether any value from ``low`` to ``high`` [n] has opacity, bool [n]; False for NaN."""
    ends = (function.opacity(low) > 0) | (function.opacity(high) > 0)
    # Piece k lies below point k and above point k - 1.
    below = np.concatenate([function.opacities[:1], function.opacities])
    above = np.concatenate([function.opacities, function.opacities[-1:]])
    visible = np.concatenate([[0], np.cumsum((below > 0) | (above > 0))])
    first = np.searchsorted(function.values, low, side="right")
    last = np.searchsorted(function.values, high, side="left") + 1
    between = (low < high) & (visible[np.maximum(last, first)] > visible[first])
    return np.where(np.isnan(low), False, ends | between)
