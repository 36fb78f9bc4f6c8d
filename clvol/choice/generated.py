"""Transfer functions generated from the data: by how often values occur, and by where boundaries are.

Boundaries are found as by Kindlmann and Durkin (Semi-automatic generation of transfer functions for direct volume
rendering, IEEE Symposium on Volume Visualization 1998): value, gradient magnitude f' and second derivative f'' along
the gradient are measured at all voxels. Across a boundary that a Gaussian of width s blurs, f'' / f' = -x / s^2, so the
mean of both over all voxels of one value (and of one gradient magnitude) gives the position x of that value, and
opacity is stated by position: full in the middle of boundaries, none beyond ``thickness``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from clvol.choice.sample import Sample

Generator = Literal["histogram", "histogram-2d", "boundary", "boundary-2d"]
ROWS = 8  # gradient magnitudes at which functions of two values are stated
_BINS = 256
_WIDTH = 1.0  # samples: standard deviation of the Gaussian whose derivatives are taken
_FEWEST = 4  # voxels of a bin that says anything
_REACH = 4  # samples around one without a value whose derivatives are not known
_TOLERANCE = 0.02  # of the largest opacity, of a curve with fewer points
_LARGEST = 99.9  # percentile of gradient magnitudes that counts as the largest


@dataclass(frozen=True, eq=False)
class Measured:
    """What occurs together in a volume.

    ``values`` float64 [bins]: middles of the bins of values; ``magnitudes`` float64 [ROWS]: gradient magnitudes (value
    per world length), from 0 on, each the middle of a bin but the first, which begins there, and the last, which has no
    end. ``counts`` float64 [ROWS, bins]; ``slope`` and ``bend``: means of f' and f'' there, 0 where nothing is.
    ``blur``: world length, the width s of the Gaussian that boundaries look like.
    """

    values: np.ndarray
    magnitudes: np.ndarray
    counts: np.ndarray
    slope: np.ndarray
    bend: np.ndarray
    blur: float

    def of_values(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Counts, mean f' and mean f'' by value alone, [bins] each."""
        counts = self.counts.sum(axis=0)
        known = np.maximum(counts, 1.0)
        means = [(each * self.counts).sum(axis=0) / known for each in (self.slope, self.bend)]
        return counts, means[0], means[1]


@dataclass(frozen=True, eq=False)
class Generated:
    """Opacities at values: ``curve`` [(value, opacity), ...], and ``layers`` [(gradient magnitude, curve), ...] of a
    function of two values."""

    curve: list[tuple[float, float]]
    layers: list[tuple[float, list[tuple[float, float]]]]


def measured(sample: Sample) -> Measured | None:
    """Value, gradient and second derivative of all samples; None where no value differs from another."""
    values, slope, bend, magnitude = _derivatives(sample)
    if values.size == 0 or values.min() == values.max():
        return None
    low, high = float(values.min()), float(values.max())
    bins = _BINS
    if sample.is_integer and high - low < bins:
        bins = int(round(high - low)) + 1
        low, high = low - 0.5, high + 0.5
    edges = np.linspace(low, high, bins + 1)
    top = float(np.percentile(magnitude, _LARGEST)) or 1.0
    magnitudes = np.linspace(0.0, top, ROWS)
    column = np.clip(((values - low) / (high - low) * bins).astype(np.int64), 0, bins - 1)
    row = np.clip(np.rint(magnitude / top * (ROWS - 1)).astype(np.int64), 0, ROWS - 1)
    place, size = row * bins + column, ROWS * bins
    counts = np.bincount(place, minlength=size).astype(np.float64)
    known = np.maximum(counts, 1.0)
    means = [np.bincount(place, each, size) / known for each in (slope, bend)]
    shape = ROWS, bins
    found = Measured(0.5 * (edges[1:] + edges[:-1]), magnitudes, counts.reshape(shape), means[0].reshape(shape),
                     means[1].reshape(shape), 0.0)  # fmt: skip
    return Measured(**{**vars(found), "blur": _blur(found, sample)})


def generate(sample: Sample, how: Generator, strength: float, thickness: float) -> Generated | None:
    """The function that ``how`` makes of the data; None where all values are one. ``strength``: the largest opacity;
    ``thickness``: half the width of what is shown of a boundary, in voxels."""
    found = measured(sample)
    if found is None:
        return None
    edge = float(np.exp(np.mean(np.log(sample.grid.spacing))))
    counts, slope, bend = found.of_values()
    if how in ("histogram", "boundary"):
        if how == "histogram":
            return Generated(_curve(found.values, strength * _rarity(counts), strength), [])
        opacity = strength * _in_boundary(counts, slope, bend, found, thickness * edge)
        return Generated(_curve(found.values, opacity, strength), [])
    if how == "histogram-2d":
        rows = strength * _rarity(found.counts)
    else:
        rows = strength * _in_boundary(found.counts, found.slope, found.bend, found, thickness * edge)
        rows[0] = 0.0  # what has no gradient is no boundary
    curves = [_curve(found.values, row, strength) for row in rows]
    return Generated(curves[0], list(zip(found.magnitudes[1:].tolist(), curves[1:])))


def _derivatives(sample: Sample) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Values, f', f'' and gradient magnitudes (per world length) of all samples that are far enough from those without
    a value: float64 [n] each. f' and f'' are of the field blurred by _WIDTH samples; magnitudes are those of central
    differences, as pictures have them."""
    from scipy import ndimage  # takes a tenth of a second

    finite = np.isfinite(sample.values)
    if not finite.any():
        return (np.zeros(0),) * 4
    filled = np.where(finite, sample.values, np.mean(sample.values[finite]))
    spacing = sample.spacing[::-1]

    def derivative(*axes: int) -> np.ndarray:
        order = [axes.count(axis) if filled.shape[axis] > 1 else 0 for axis in range(3)]
        if sum(order) < len(axes):
            return np.zeros_like(filled)
        scale = float(np.prod([spacing[axis] for axis in axes]))
        sigma = [_WIDTH if n > 1 else 0.0 for n in filled.shape]
        return ndimage.gaussian_filter(filled, sigma, order=order, mode="nearest", truncate=5.0) / scale

    gradient = [derivative(axis) for axis in range(3)]
    square = sum(each**2 for each in gradient)
    bend = np.zeros_like(filled)
    for a in range(3):
        for b in range(a, 3):
            bend += (1 if a == b else 2) * gradient[a] * gradient[b] * derivative(a, b)
    slope = np.sqrt(square)
    has_slope = slope > 1e-12 * max(float(slope.max()), 1e-300)
    bend = np.where(has_slope, bend / np.where(has_slope, square, 1.0), 0.0)
    if not finite.all():
        finite = ~ndimage.binary_dilation(~finite, iterations=_REACH)
    axes = [axis for axis in range(3) if filled.shape[axis] > 1]
    found = np.gradient(filled, *[spacing[axis] for axis in axes], axis=axes) if axes else []
    found = found if isinstance(found, (list, tuple)) else [found]
    magnitude = np.sqrt(sum((each**2 for each in found), np.zeros_like(filled)))
    return sample.values[finite], slope[finite], bend[finite], magnitude[finite]


def _blur(found: Measured, sample: Sample) -> float:
    """The width s of boundaries: 2 max f' / (sqrt(e) (max f'' - min f'')) by value (Kindlmann and Durkin, section 4),
    at least that of the derivatives' own Gaussian."""
    counts, slope, bend = found.of_values()
    known = counts >= _FEWEST
    own = _WIDTH * float(np.exp(np.mean(np.log(sample.spacing))))
    span = float(np.ptp(bend[known])) if known.any() else 0.0
    return own if span <= 0 else max(own, 2.0 * float(slope[known].max()) / (np.sqrt(np.e) * span))


def _rarity(counts: np.ndarray) -> np.ndarray:
    """0 .. 1: 1 - log(1 + n) / log(1 + largest n) where n voxels are, 0 where too few are: what is rare shows."""
    largest = max(float(counts.max()), 1.0)
    return np.where(counts >= _FEWEST, 1.0 - np.log1p(counts) / np.log1p(largest), 0.0)


def _in_boundary(
    counts: np.ndarray, slope: np.ndarray, bend: np.ndarray, found: Measured, thickness: float
) -> np.ndarray:
    """0 .. 1: 1 in the middle of boundaries, linearly down to 0 at ``thickness`` (world length) from it."""
    weak = found.magnitudes[1] * 0.5  # below, noise decides about directions
    known = (counts >= _FEWEST) & (slope > weak)
    position = -(found.blur**2) * bend / np.where(known, slope, 1.0)
    return np.where(known, np.clip(1.0 - np.abs(position) / thickness, 0.0, 1.0), 0.0)


def _curve(values: np.ndarray, opacity: np.ndarray, strength: float) -> list[tuple[float, float]]:
    """The points of a curve that keep it to _TOLERANCE of ``strength`` (Douglas and Peucker 1973)."""
    kept = np.zeros(values.size, bool)
    kept[[0, -1]] = True
    spans = [(0, values.size - 1)]
    while spans:
        first, last = spans.pop()
        inner = np.arange(first + 1, last)
        if not inner.size:
            continue
        straight = np.interp(values[inner], values[[first, last]], opacity[[first, last]])
        off = np.abs(opacity[inner] - straight)
        worst = int(off.argmax())
        if off[worst] > _TOLERANCE * strength:
            kept[inner[worst]] = True
            spans += [(first, int(inner[worst])), (int(inner[worst]), last)]
    return list(zip(values[kept].tolist(), opacity[kept].tolist()))


def palette(colors: Sequence[tuple[float, float, float]], share: np.ndarray) -> np.ndarray:
    """float64 [n, 3]: ``colors`` evenly spaced over 0 .. 1, at ``share`` [n]."""
    at = np.linspace(0.0, 1.0, len(colors))
    return np.stack([np.interp(share, at, [color[k] for color in colors]) for k in range(3)], axis=-1)
