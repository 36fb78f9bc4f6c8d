"""Bounded stepping sees all of a transfer function, also what lies between two nodes."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import TransferFunction
from clvol.transfer.step_bounds import most_steps

NODES = np.linspace(0.0, 1.0, 257)
WHITE = [1.0, 1.0, 1.0]


def steps_for(function, low, high, midpoints):
    curvature, slope = 1e-3 * (high - low), 0.1 * (high - low)
    bounds = np.array([[curvature, slope, low, high]], np.float32)
    return int(most_steps(bounds, function, NODES, 1.0, 1.0, 1e-3, 16, midpoints)[0])


@pytest.mark.parametrize("midpoints", [False, True])
def test_a_peak_between_two_nodes_shortens_steps(midpoints):
    flat = TransferFunction([0.0, 1.0], [0.05, 0.05], [WHITE] * 2)
    centre = 0.5 * (NODES[100] + NODES[101])
    points = [0.0, centre - 1e-4, centre, centre + 1e-4, 1.0]
    peak = TransferFunction(points, [0.05, 0.05, 0.9, 0.05, 0.05], [WHITE] * 5)
    assert steps_for(flat, 0.2, 0.6, midpoints) == 16
    assert steps_for(peak, 0.2, 0.6, midpoints) == 1
    assert steps_for(peak, 0.5, 0.6, midpoints) == 16


def test_a_step_between_two_nodes_shortens_steps():
    at = 0.5 * (NODES[100] + NODES[101])
    step = TransferFunction([0.0, at, at, 1.0], [0.1, 0.1, 0.6, 0.6], [WHITE] * 4)
    assert steps_for(step, 0.2, 0.6, True) == 1 and steps_for(step, 0.2, 0.6, False) == 1


def test_a_single_value_bounds_nothing():
    function = TransferFunction([0.0, 255.0], [0.1, 0.3], [[1.0, 0.5, 0.25]] * 2)
    bounds = np.array([[0.0, 0.0, 100.0, 100.0]] * 3)
    for midpoints in (False, True):
        nodes = np.linspace(100.0, 100.0, 257)
        steps = most_steps(bounds, function, nodes, 1.0, 1.0, 1e-3, 8, midpoints, per_step=True)
        assert steps.tolist() == [8, 8, 8]
