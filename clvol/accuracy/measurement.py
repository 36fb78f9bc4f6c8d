"""Measures the error of a whole picture at the pilot's pixels, and at others that did not influence the settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from clvol.accuracy.estimate import ErrorEstimate, draw, estimate
from clvol.accuracy.ground_truth import GroundTruth
from clvol.accuracy.trials import Trial, Trials

CONFIDENCE = 0.95
_DRAWN_PIXELS = 2_048  # at first; the number doubles until the bound gives an answer
_DRAWN_AREAS = 512  # of pixels that are integrated, by many rays each


class Measurement:
    """Measures errors of pictures of one scene.

    ``pilot``: the trials by which settings are chosen; its pixels count with their known errors. ``tolerance``: that
    of the exact integral. ``timed(work)`` calls ``work``, records its time and returns its result. ``area``: whether
    the truth is the integral over each pixel, which the pilot's pixels do not know.
    """

    def __init__(
        self,
        pilot: Trials,
        truth: GroundTruth,
        rng: np.random.Generator,
        tolerance: float,
        timed: Callable[[Callable[[], Any]], Any],
        area: bool = False,
    ) -> None:
        self._area = area
        self._pilot, self._truth, self._rng, self._tolerance = pilot, truth, rng, tolerance
        self._size, self._timed = pilot.size, timed

    def of(
        self, picture: Trial, finer: Callable[[], np.ndarray], attempt: int, limit: float | None
    ) -> ErrorEstimate:
        """The error of ``picture``, which must have its ``rgba``.

        ``finer()`` returns a picture [height, width, 4] that shows roughly where ``picture`` is wrong. ``attempt``: 1
        for the first picture of a search, and one more for each further one. ``limit``: the largest permitted error;
        pixels are drawn until the bound shows whether the picture is below it. Each check has half the probability of
        a wrong result that the one before has, so that all together have at least the confidence CONFIDENCE.
        """
        width, height = self._size
        count_all = width * height
        rgba = picture.picture.reshape(count_all, 4)
        pilot, known = np.zeros(0, int), np.zeros(0)
        if not self._area:
            pilot = np.asarray(self._pilot.lattice.pixels(width, height) @ (width, 1), int)
            known = _squared(rgba[pilot], self._pilot.exact().reshape(-1, 4))
        left_out = np.zeros(count_all, bool)
        left_out[pilot] = True
        others = count_all - len(pilot)
        rough = np.zeros(count_all)
        first = _DRAWN_AREAS if self._area else _DRAWN_PIXELS
        if others > first:
            rough = _squared(rgba, finer().reshape(count_all, 4))
        squared = probability = np.zeros(0)
        look, count = 0, first
        while True:
            look += 1
            if squared.size + count >= others:  # measuring all pixels costs no more
                rest = self._errors(rgba, np.flatnonzero(~left_out)) if others else np.zeros(0)
                found = estimate([], [], count_all, 1.0, [*known, *rest])
                return replace(found, bound=found.bound + self._truth.error)
            at, p = draw(rough, count, self._rng, left_out)
            squared = np.append(squared, self._errors(rgba, at))
            probability = np.append(probability, p)
            chance = (1.0 - CONFIDENCE) / 2.0 ** (attempt + look)
            found = estimate(squared, probability, count_all, 1.0 - chance, known)
            found = replace(found, bound=found.bound + self._truth.error)
            if limit is None or found.bound <= limit or found.rmse > limit:
                return replace(found, confidence=CONFIDENCE)
            count = squared.size

    def _errors(self, rgba: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Squared errors of the pixels ``at`` [n] of ``rgba`` [height * width, 4]."""
        pixels = np.stack(np.divmod(at, self._size[0]), axis=1)
        exact, _ = self._timed(lambda: self._truth.pixels(pixels, self._tolerance))
        return _squared(rgba[at], exact)


def where_measured(found: ErrorEstimate) -> str:
    """Describes the pixels from which ``found`` was derived."""
    if found.pixels >= found.of_pixels:
        return "all pixels"
    return "the pixels that settings were chosen by, and at others, drawn where errors are expected"


def _squared(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The squared difference, averaged over the channels, [...]; inf where a channel is not finite."""
    with np.errstate(invalid="ignore"):
        squared = np.square(np.asarray(a, np.float64) - b).mean(axis=-1)
    return np.where(np.isfinite(squared), squared, np.inf)
