"""A transfer function that moves over the values and wraps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol.transfer import TransferFunction
from clvol.transfer.cycle import cycled

RANGE = (10.0, 110.0)
STEPS = TransferFunction(
    [0.0, 30.0, 30.0, 70.0, 90.0, 200.0],
    [0.0, 0.2, 0.6, 0.1, 1.0, 0.5],
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1]],
    2.0,
)


def wrapped(values, shift):
    low, high = RANGE
    return low + np.mod(values - low + shift * (high - low), high - low)


@given(shift=st.floats(-5, 5))
@settings(max_examples=60, deadline=None)
def test_it_is_the_function_at_wrapped_values(shift):
    values = np.random.default_rng(0).uniform(*RANGE, 300)
    at = wrapped(values, shift)
    breaks = np.array([*STEPS.values, *RANGE])
    clear = np.abs(at[:, None] - breaks).min(axis=1) > 1e-6  # the side of a step is rounding's
    moved = cycled(STEPS, shift, RANGE)
    np.testing.assert_allclose(moved.opacity(values)[clear], STEPS.opacity(at)[clear], atol=1e-9)
    np.testing.assert_allclose(moved.color(values)[clear], STEPS.color(at)[clear], atol=1e-9)
    assert moved.opacity_unit == 2.0


def test_it_goes_on_beyond_the_range_as_far_as_is_asked():
    values = np.linspace(-300.0, 400.0, 997)
    moved = cycled(STEPS, 0.37, RANGE, (-300.0, 400.0))
    expected = STEPS.opacity(wrapped(values, 0.37))
    np.testing.assert_allclose(moved.opacity(values), expected, atol=1e-9)
    assert cycled(STEPS, 0.1, RANGE, (-1e30, 1e30)).values.size < 2000


@pytest.mark.parametrize("shift", [0.0, 1.0, -3.0])
def test_whole_turns_change_nothing(shift):
    assert cycled(STEPS, shift, RANGE) is STEPS
    values = np.linspace(*RANGE, 201)
    moved = cycled(STEPS, shift, RANGE, (0.0, 200.0))
    np.testing.assert_allclose(moved.opacity(values[:-1]), STEPS.opacity(values[:-1]), atol=1e-12)


def test_colours_alone_move_where_opacity_is_to_stay():
    values = np.random.default_rng(1).uniform(0, 150, 400)
    moved = cycled(STEPS, 0.4, RANGE, opacity=False)
    np.testing.assert_allclose(moved.opacity(values), STEPS.opacity(values), atol=1e-12)
    inside = values[(values > 10) & (values < 110)]
    np.testing.assert_allclose(moved.color(inside), STEPS.color(wrapped(inside, 0.4)), atol=1e-9)


def test_a_range_of_one_value_cannot_cycle():
    assert cycled(STEPS, 0.3, (5.0, 5.0)) is STEPS


some_values = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=6, unique=True)


@given(shift=st.floats(0, 1), values=some_values)
@settings(max_examples=60, deadline=None)
def test_any_function_stays_a_function(shift, values):
    values = np.sort(values)
    n = values.size
    colors = np.linspace(0, 1, 3 * n).reshape(n, 3)
    function = TransferFunction(values, np.linspace(0, 1, n), colors)
    for opacity in (True, False):
        moved = cycled(function, shift, RANGE, (-50.0, 300.0), opacity=opacity)
        assert np.isfinite(moved.values).all() and (np.diff(moved.values) >= 0).all()
