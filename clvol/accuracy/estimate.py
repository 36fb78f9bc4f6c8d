"""Estimates the error of a whole picture, with a bound, from its exact values at some pixels.

Pixels are drawn with probabilities that follow a rough map of the error (the difference to another rendering), and
weighted by their inverse. The estimate is unbiased however wrong the map is, and has little variance if the map is
right (sampling proportional to size; Hansen and Hurwitz 1943). Squared errors are skewed, so bounds from Student's t
would be too low. The bound is that of Hall (1992), who transforms the statistic to remove its skewness.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

_EVERYWHERE = 0.3  # share of the draws that ignore the rough map of the error


@dataclass(frozen=True)
class ErrorEstimate:
    """``rmse`` of linear premultiplied RGBA over the whole picture, and the ``bound`` that it does not exceed with
    probability ``confidence``, from the exact values at ``pixels`` of its ``of_pixels`` pixels. If those are all
    pixels, ``bound`` is ``rmse`` and ``confidence`` is 1."""

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
    """Draws ``count`` pixels, some possibly twice: their indices, and the probability of each in a single draw.

    ``rough`` [n] >= 0: rough squared errors of all pixels. ``left_out`` (bool [n], not all True): pixels that are
    never drawn.
    """
    rough = np.asarray(rough, np.float64)
    drawable = np.ones(rough.size) if left_out is None else 1.0 - np.asarray(left_out, np.float64)
    weight = rough * drawable
    total, probability = weight.sum(), drawable / drawable.sum()
    if 0.0 < total < np.inf:
        probability = _EVERYWHERE * probability + (1.0 - _EVERYWHERE) / total * weight
    ends = np.cumsum(probability)
    # One draw in each of `count` equal shares (stratified sampling) spreads over the picture, and is never worse than
    # the independent draws that the bound assumes.
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

    ``known`` [k]: squared errors (means over the channels) of pixels that count once each. ``squared`` [m]: those of
    pixels that were drawn from all others, with probability ``probability`` [m] each; empty if ``known`` has all
    pixels. ``confidence``: at least 0.5 and less than 1.
    """
    squared, known = np.asarray(squared, np.float64), np.asarray(known, np.float64)
    sum_known = float(known.sum())
    if known.size >= of_pixels:
        rmse = math.sqrt(sum_known / of_pixels)
        return ErrorEstimate(rmse, rmse, 1.0, of_pixels, of_pixels)
    totals = squared / np.asarray(probability, np.float64)  # each value estimates the sum over the other pixels
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
    """The lower quantile (below 0) of (mean - expectation) / standard error, by Hall's transformation."""
    z = NormalDist().inv_cdf(1.0 - confidence)
    n = values.size
    centred = values - values.mean()
    skewness = float(np.mean(centred**3) / np.mean(centred**2) ** 1.5)
    a = skewness / math.sqrt(n)
    if abs(a) < 1e-6:
        return z
    return 3.0 / a * float(np.cbrt(1.0 + a * (z - a / 6.0)) - 1.0)
