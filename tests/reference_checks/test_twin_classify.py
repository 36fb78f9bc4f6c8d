"""The twin's segments, against adaptive quadrature and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from reference.classify import (
    MovedFunction,
    curvature_shift,
    layer_weights,
    of_chord,
    of_value,
    of_voxels,
)

from clvol import TransferFunction

PEAKS = TransferFunction(
    [0.0, 1.0, 2.0, 2.0, 3.0, 4.0],
    [0.0, 0.9, 0.1, 0.6, 1.0, 0.0],
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1]],
    opacity_unit=0.7,
)
CHORDS = [(0.0, 1.0), (1.0, 0.2), (0.3, 2.7), (2.9, 0.1), (2.0, 2.5), (1.0, 1.0 + 1e-9), (0.5, 0.5)]


def quadrature(function, front, back, length, slices=40000):
    """(light, depth) of a chord in thin slices; they narrow towards the function's breaks."""
    span = back - front
    breaks = (function.breaks() - front) / (span or 1.0)
    breaks = np.unique(np.concatenate([[0.0, 1.0], breaks[(breaks > 0) & (breaks < 1)]]))
    u = np.linspace(0, 1, slices + 1)
    smooth = u**3 * (10 - 15 * u + 6 * u**2)
    x = np.concatenate([a + (b - a) * smooth for a, b in zip(breaks, breaks[1:])])
    value, width = front + 0.5 * (x[1:] + x[:-1]) * span, np.diff(x)
    depth = function.extinction(value) * width * length
    before = np.concatenate([[0.0], np.cumsum(depth)[:-1]])
    return (np.exp(-before) * -np.expm1(-depth)) @ function.color(value), depth.sum()


@pytest.mark.parametrize("front, back", CHORDS)
@pytest.mark.parametrize("length", [0.01, 0.8])
@pytest.mark.parametrize("shift", [0.0, 0.3])
def test_chords_are_the_integral(front, back, length, shift):
    function = MovedFunction(PEAKS, (0.0, 4.0), shift)
    color, depth = of_chord(function, *(np.array([v]) for v in (front, back, length)))
    light, expected = quadrature(function, front, back, length)
    assert depth[0] == pytest.approx(expected, rel=1e-7)
    assert color[0] * -np.expm1(-depth[0]) == pytest.approx(light, rel=1e-7, abs=1e-9)


def test_a_chord_of_one_value_is_that_value():
    function = MovedFunction(PEAKS)
    value, length = np.array([0.4, 2.0, 3.0, np.nan]), np.full(4, 0.5)
    flat, chord = of_value(function, value, length), of_chord(function, value, value, length)
    assert np.allclose(flat[1][:2], chord[1][:2], rtol=1e-12)
    assert chord[1][2] > 1e20 and chord[1][3] == flat[1][3] == 0
    assert np.allclose(flat[0][:3], chord[0][:3])


def test_a_chord_into_opaque_shows_what_lies_before():
    wall = TransferFunction([0, 1, 1, 2], [0, 0, 1, 1], [[1, 0, 0]] * 2 + [[0, 1, 0]] * 2)
    color, depth = of_chord(MovedFunction(wall), np.array([0.5]), np.array([1.5]), np.ones(1))
    assert np.allclose(color, [[0, 1, 0]]) and depth[0] > 1e20


def test_cycling_by_whole_ranges_changes_nothing_and_values_wrap():
    value = np.linspace(0, 4, 9)
    for shift in (1.0, -2.0):
        moved = MovedFunction(PEAKS, (0.0, 4.0), shift)
        assert np.array_equal(moved.color(value), PEAKS.color(value))
    moved = MovedFunction(PEAKS, (0.0, 4.0), 0.25)
    assert moved.color(np.array([3.5]))[0] == pytest.approx(PEAKS.color(np.array(0.5)))
    assert np.array_equal(moved.opacity(value), PEAKS.opacity(value))  # colours alone move
    assert moved.color(np.array([-1.0]))[0] == pytest.approx(PEAKS.color(np.array(0.0)))


def test_the_shifted_chord_has_the_parabolas_mean():
    def parabola(t):
        return 3.0 + 0.2 * t + 0.05 * t**2

    for length in (1.0, 0.4):
        before, front, back = (np.array([parabola(t)]) for t in (-1.0, 0.0, length))
        first, last = curvature_shift(before, front, back, np.array([length]), "linear")
        t = np.linspace(0, length, 100001)
        mean = np.trapezoid(parabola(t), t) / length
        assert 0.5 * (first + last)[0] == pytest.approx(mean, rel=1e-9)


def test_shifted_chords_stay_within_the_samples():
    front, back = curvature_shift(*(np.array([v]) for v in (0.0, 0.0, 10.0, 1.0)), "linear")
    assert front[0] == 0.0 and back[0] < 10.0


def test_pre_classification_interpolates_emission_and_extinction():
    function = MovedFunction(TransferFunction([0, 1], [0.2, 0.5], [[1, 0, 0], [0, 1, 0]]))
    weights = np.array([[0.25, 0.75]])
    color, depth = of_voxels(function, np.array([[0.0, 1.0]]), weights, np.array([2.0]))
    tau = -np.log([0.8, 0.5])
    assert depth[0] == pytest.approx(2 * (0.25 * tau[0] + 0.75 * tau[1]))
    assert color[0] * depth[0] / 2 == pytest.approx([0.25 * tau[0], 0.75 * tau[1], 0])


def test_layers_are_linear_and_the_last_one_holds():
    weights = layer_weights(np.array([0.0, 1.0, 3.0, 9.0]), np.array([0.0, 2.0, 4.0]))
    assert np.allclose(weights, [[1, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0.5], [0, 0, 1]])
