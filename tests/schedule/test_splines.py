"""Curves through values at given times, beside closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.schedule.splines import catmull_rom, monotone, slerp

TIMES = np.array([0.0, 1.0, 2.5, 3.0, 5.0])
CURVES = (catmull_rom, monotone)


@pytest.mark.parametrize("curve", CURVES)
def test_curves_pass_through_their_values_and_hold_the_ends(curve):
    values = np.random.default_rng(3).normal(size=(5, 3))
    for time, value in zip(TIMES, values):
        np.testing.assert_allclose(curve(TIMES, values, time), value, atol=1e-12)
    np.testing.assert_array_equal(curve(TIMES, values, -7.0), values[0])
    np.testing.assert_array_equal(curve(TIMES, values, 70.0), values[-1])
    np.testing.assert_array_equal(curve([2.0], values[:1], 9.0), values[0])


@pytest.mark.parametrize("curve", CURVES)
def test_straight_lines_stay_straight(curve):
    for times in (TIMES, TIMES[:2]):
        for at in np.linspace(0.0, times[-1], 23):
            np.testing.assert_allclose(curve(times, 2.0 - 3.0 * times, at), 2.0 - 3.0 * at, atol=1e-12)


@pytest.mark.parametrize("curve", CURVES)
def test_speeds_do_not_jump(curve):
    values, h = np.array([0.0, 1.0, 4.0, 4.5, 9.0]), 1e-6
    for time in TIMES[1:-1]:
        before = (curve(TIMES, values, time) - curve(TIMES, values, time - h)) / h
        after = (curve(TIMES, values, time + h) - curve(TIMES, values, time)) / h
        assert abs(before - after) < 1e-4


def test_even_times_give_the_weights_of_catmull_and_rom():
    values = np.array([3.0, 1.0, 4.0, 1.0, 5.0])
    x = 0.3
    weights = 0.5 * np.array([
        -x + 2 * x**2 - x**3, 2 - 5 * x**2 + 3 * x**3, x + 4 * x**2 - 3 * x**3, -(x**2) + x**3
    ])  # fmt: skip
    np.testing.assert_allclose(catmull_rom(np.arange(5.0), values, 1.0 + x), weights @ values[:4])


def test_parabolas_are_reproduced_between_inner_values():
    values = 1.0 + TIMES - 2.0 * TIMES**2
    for at in np.linspace(1.0, 3.0, 9):
        np.testing.assert_allclose(catmull_rom(TIMES, values, at), 1.0 + at - 2.0 * at**2, atol=1e-12)


def test_monotone_curves_stay_between_their_values():
    rng = np.random.default_rng(8)
    for _ in range(50):
        times, values = np.cumsum(rng.uniform(0.1, 3.0, 6)), rng.choice([0.0, 0.5, 1.0, 1.0], 6)
        for k in range(5):
            found = [monotone(times, values, at) for at in np.linspace(times[k], times[k + 1], 17)]
            low, high = sorted((values[k], values[k + 1]))
            assert low - 1e-12 <= min(found) and max(found) <= high + 1e-12
            assert np.all(np.diff(found) * np.sign(values[k + 1] - values[k]) >= -1e-12)


def test_directions_turn_evenly():
    directions = [[2.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 3.0]]
    for share in (0.0, 0.25, 0.7):
        angle = np.radians(90.0 * share)
        np.testing.assert_allclose(slerp([0, 1, 3], directions, share), [np.cos(angle), np.sin(angle), 0], atol=1e-12)
        expected = [0, np.cos(angle), np.sin(angle)]
        np.testing.assert_allclose(slerp([0, 1, 3], directions, 1.0 + 2.0 * share), expected, atol=1e-12)
    np.testing.assert_array_equal(slerp([0, 1], [[0, 0, 4], [0, 0, 4]], 0.5), [0, 0, 1])


def test_times_must_ascend():
    with pytest.raises(ValueError, match="ascend"):
        monotone([0.0, 0.0], [1.0, 2.0], 0.5)
