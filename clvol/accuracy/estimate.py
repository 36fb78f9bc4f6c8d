"""The error of a whole picture from its exact values at some pixels, with a bound.

Pixels are drawn where a rough idea of the error (the difference to another rendering) says that it
is, and weighted back: the estimate has no bias however wrong the idea is, and little spread if it is
right (sampling proportional to size; Hansen and Hurwitz 1943). Squared errors are skewed, for which
Student's t gives bounds too low: the bound is Hall's (1992), which transforms the statistic so that
its skewness goes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

_EVERYWHERE = 0.3  # of the pixels are drawn whatever the rough idea of the error is


@dataclass(frozen=True)
class ErrorEstimate:
    """``rmse``, and the ``bound`` that it does not exceed with ``confidence`` (both of linear
    premultiplied RGBA over the whole picture), from the exact values at ``pixels`` of its ``of_pixels``.
    All pixels: then ``bound`` is ``rmse`` itself, and ``confidence`` 1."""

    rmse: float
    bound: float
    confidence: float
    pixels: int
    of_pixels: int


def draw(
    rough: ArrayLike,
    count: int,
    rng: np.random.Generator,
    left_out: ArrayLike | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """``count`` indices (some twice) of the values ``rough`` [n] >= 0, ideas of squared errors, and the
    probability of each of them in one draw; never one of those ``left_out`` (bool [n], not all)."""
    rough = np.asarray(rough, np.float64)
    drawable = np.ones(rough.size) if left_out is None else 1.0 - np.asarray(left_out, np.float64)
    weight = rough * drawable
    total, probability = weight.sum(), drawable / drawable.sum()
    if 0.0 < total < np.inf:
        probability = _EVERYWHERE * probability + (1.0 - _EVERYWHERE) / total * weight
    ends = np.cumsum(probability)
    # One draw in each of `count` equal shares: spread over the picture, and never worse than
    # independent draws, for which the bound is stated.
    at = (np.arange(count) + rng.random(count)) / count * ends[-1]
    last = int(np.flatnonzero(probability)[-1])
    drawn = np.minimum(np.searchsorted(ends, at, side="right"), last)
    return drawn, probability[drawn]


def estimate(
    squared: ArrayLike,
    probability: ArrayLike,
    of_pixels: int,
    confidence: float,
    known: ArrayLike = (),
) -> ErrorEstimate:
    """The error of a picture of ``of_pixels`` pixels.

    ``known`` [k]: squared errors (means over the channels) of some pixels that count once each.
    ``squared`` [m]: those of pixels drawn, with ``probability`` [m] each, out of all others; where none are left
    to be drawn, none. ``confidence``: 0.5 to less than 1.
    """
    squared, known = np.asarray(squared, np.float64), np.asarray(known, np.float64)
    sum_known = float(known.sum())
    if known.size >= of_pixels:
        rmse = math.sqrt(sum_known / of_pixels)
        return ErrorEstimate(rmse, rmse, 1.0, of_pixels, of_pixels)
    totals = squared / np.asarray(probability, np.float64)  # each estimates the sum over the rest
    mean = float(totals.mean())
    upper = mean
    if totals.size < 2 or not np.isfinite(totals).all():
        upper = math.inf
    elif (spread := float(totals.std(ddof=1)) / math.sqrt(totals.size)) > 0:
        upper -= spread * _lower_quantile(totals, confidence)
    return ErrorEstimate(
        rmse=math.sqrt((sum_known + mean) / of_pixels),
        bound=math.sqrt((sum_known + upper) / of_pixels),
        confidence=confidence,
        pixels=known.size + squared.size,
        of_pixels=of_pixels,
    )


def _lower_quantile(values: np.ndarray, confidence: float) -> float:
    """Of (mean - expectation) / standard error, by Hall's transformation: below 0."""
    z = NormalDist().inv_cdf(1.0 - confidence)
    n = values.size
    centred = values - values.mean()
    skewness = float(np.mean(centred**3) / np.mean(centred**2) ** 1.5)
    a = skewness / math.sqrt(n)
    if abs(a) < 1e-6:
        return z
    return 3.0 / a * float(np.cbrt(1.0 + a * (z - a / 6.0)) - 1.0)
