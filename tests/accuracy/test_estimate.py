"""A picture's error from some of its pixels: no bias, and a bound that holds as often as it says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clvol.accuracy.estimate import draw, estimate

N = 40_000


def errors_of(kind: str, rng) -> np.ndarray:
    """Squared errors of pictures: most are small, a few are not."""
    if kind == "lognormal":
        return np.exp(rng.normal(-12, 1.5, N))
    if kind == "edges":
        return np.where(rng.random(N) < 0.02, rng.exponential(1e-4, N), 1e-8 * rng.random(N))
    return np.where(rng.random(N) < 0.5, rng.exponential(1e-6, N), 0.0)  # half of it is background


@pytest.mark.parametrize("kind", ["lognormal", "edges", "background"])
@pytest.mark.parametrize("idea", ["good", "rough", "none", "wrong"])
def test_bounds_hold_as_often_as_they_say_and_estimates_have_no_bias(kind, idea):
    rng = np.random.default_rng(7)
    squared = errors_of(kind, rng)
    rough = {
        "good": squared * rng.uniform(0.5, 2.0, N),
        "rough": squared * np.exp(rng.normal(0, 1, N)),
        "none": np.zeros(N),
        "wrong": errors_of(kind, rng),
    }[idea]
    true = math.sqrt(squared.mean())
    rounds, confidence = 400, 0.95
    held, estimates, bounds = 0, [], []
    for _ in range(rounds):
        at, probability = draw(rough, 2048, rng)
        found = estimate(squared[at], probability, N, confidence)
        held += found.bound >= true
        estimates.append(found.rmse**2)
        bounds.append(found.bound)
    # 95 % of 400, less three standard deviations of that count.
    assert held >= confidence * rounds - 3 * math.sqrt(rounds * confidence * (1 - confidence))
    spread = np.std(estimates) / math.sqrt(rounds)
    assert abs(np.mean(estimates) - true**2) < 4 * spread + 1e-12 * true
    if idea == "good":
        assert np.median(bounds) < 1.05 * true  # which is what the idea is for


def test_drawing_follows_the_idea_and_leaves_no_pixel_out():
    rough = np.array([0.0, 1.0, 3.0, 0.0])
    rng = np.random.default_rng(1)
    at, probability = draw(rough, 40_000, rng)
    shares = np.bincount(at, minlength=4) / at.size
    np.testing.assert_allclose(shares, 0.3 / 4 + 0.7 * rough / 4, atol=5e-3)
    np.testing.assert_allclose(probability, (0.3 / 4 + 0.7 * rough / 4)[at])


def test_what_is_left_out_is_never_drawn():
    rough, left_out = np.ones(1000), np.zeros(1000, bool)
    left_out[::3] = left_out[-1] = True
    at, probability = draw(rough, 20_000, np.random.default_rng(1), left_out)
    assert not left_out[at].any()
    np.testing.assert_allclose(probability, 1 / np.count_nonzero(~left_out))


@pytest.mark.parametrize("rough", [np.zeros(5), np.array([np.inf, 1.0, 1.0])])
def test_an_idea_that_says_nothing_is_left_aside(rough):
    _, probability = draw(rough, 10, np.random.default_rng(0))
    np.testing.assert_allclose(probability, 1 / rough.size)


def test_all_pixels_known_is_no_estimate():
    known = np.array([1e-4, 4e-4, 0.0])
    found = estimate([], [], 3, 0.95, known)
    assert found.rmse == found.bound == pytest.approx(math.sqrt(known.mean()))
    assert found.confidence == 1.0 and found.pixels == found.of_pixels == 3


def test_known_pixels_count_once_each():
    known, drawn = np.full(50, 4e-4), np.full(25, 1e-4)
    found = estimate(drawn, np.full(25, 1 / 50), 100, 0.95, known)
    assert found.rmse == pytest.approx(math.sqrt((4e-4 + 1e-4) / 2))
    assert found.bound == pytest.approx(found.rmse)
    assert found.pixels == 75 and found.of_pixels == 100


def test_what_is_not_finite_bounds_nothing():
    assert estimate([np.inf, 1.0], [0.1, 0.1], 10, 0.95).bound == np.inf
    assert estimate([1.0], [0.1], 10, 0.95).bound == np.inf
