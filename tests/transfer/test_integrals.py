"""Integral functions of a transfer function, against the sum of extinction, and against segments in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.transfer import TransferFunction
from clvol.transfer.integrals import TransferIntegrals
from clvol.transfer.preintegration import preintegrate

COLORS = [[0.9, 0.1, 0.0], [0.0, 0.8, 0.1], [0.1, 0.2, 1.0], [0.7, 0.7, 0.2], [1.0, 0.0, 1.0]]
FUNCTIONS = {
    "ramps": ([0, 10, 25, 40, 63], [0, 0.01, 0.3, 0.05, 0.6]),
    "narrow peak": ([0, 20, 20.001, 20.002, 63], [0, 0, 0.95, 0, 0]),
    "touches opaque": ([0, 20, 30, 40, 63], [0, 0.2, 1, 0.2, 0]),
    "step": ([0, 30, 30, 45, 63], [0.02, 0.1, 0.9, 0.9, 0]),
    "one point": ([20], [0.3]),
}


def function_of(name: str) -> TransferFunction:
    values, opacities = FUNCTIONS[name]
    return TransferFunction(values, opacities, COLORS[: len(values)])


@pytest.mark.parametrize("name", FUNCTIONS)
def test_differences_of_integrals_are_the_optical_depths_of_segments(name):
    function = function_of(name)
    integrals = TransferIntegrals(function, 1e3)
    values = np.concatenate([np.linspace(-2, 65, 40), [20.0005, 20.0015, 30.0, 29.999]])
    front, back = values[:, None], values[None, :]
    depth = integrals.mean(front, back)[..., 0] * 0.3
    expected = preintegrate(function, front, back, 0.3)[..., 3]
    np.testing.assert_allclose(-np.expm1(-depth), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_colour_is_that_of_segments_too_thin_to_attenuate_themselves(name):
    function = function_of(name)
    values = np.linspace(-2, 65, 40)
    front, back = values[:, None], values[None, :]
    light = TransferIntegrals(function, 1e3).mean(front, back)[..., 1:] * 1e-6
    expected = preintegrate(function, front, back, 1e-6)[..., :3]
    np.testing.assert_allclose(light, expected, rtol=0, atol=1e-10)


def test_an_opacity_of_one_counts_as_the_extinction_that_is_given():
    function = TransferFunction([0, 10, 20], [1, 1, 0], COLORS[:3])
    integrals = TransferIntegrals(function, 7.0)
    assert integrals.mean(np.array([2.0]), np.array([8.0]))[0, 0] == pytest.approx(7.0)
    assert integrals.mean(np.array([5.0]), np.array([5.0]))[0, 0] == 7.0
    assert integrals.mean(np.array([-4.0]), np.array([-1.0]))[0, 0] == pytest.approx(7.0)


def test_a_whole_is_the_sum_of_its_parts():
    integrals = TransferIntegrals(function_of("ramps"), 1e3)
    ends = np.linspace(3.0, 61.0, 30)
    parts = integrals.mean(ends[:-1], ends[1:])
    np.testing.assert_array_equal(integrals.mean_along(ends), parts)
    np.testing.assert_allclose(parts.mean(axis=0), integrals.mean(ends[:1], ends[-1:])[0], rtol=1e-9)
