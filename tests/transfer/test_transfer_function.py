"""Properties of the transfer function between, at and beyond its control points."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clvol import TransferFunction
from clvol.errors import SceneError

RAMP = TransferFunction([0, 10], [0.0, 0.8], [[0, 0, 0], [1, 0.5, 0.25]])
STEP = TransferFunction([0, 5, 5, 9], [0.1, 0.3, 1.0, 0.2], np.eye(4, 3))

finite = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def functions(draw) -> TransferFunction:
    values = sorted(draw(st.lists(finite, min_size=1, max_size=6, unique=True)))
    share = st.floats(0, 1)
    opacities = draw(st.lists(share, min_size=len(values), max_size=len(values)))
    colors = draw(
        st.lists(st.tuples(share, share, share), min_size=len(values), max_size=len(values))
    )
    return TransferFunction(values, opacities, colors)


def test_opacity_and_color_are_linear_between_points():
    s = np.linspace(0, 10, 11)
    np.testing.assert_allclose(RAMP.opacity(s), 0.08 * s, rtol=1e-15)
    np.testing.assert_allclose(RAMP.color(s), s[:, None] / 10 * [1, 0.5, 0.25], rtol=1e-15)


@given(functions())
def test_control_points_are_met_exactly(function):
    np.testing.assert_array_equal(function.opacity(function.values), function.opacities)
    np.testing.assert_array_equal(function.color(function.values), function.colors)


@given(functions(), st.floats())
def test_nothing_leaves_the_range_of_the_points(function, s):
    opacity, color = function.opacity(s), function.color(s)
    assert opacity.shape == () and color.shape == (3,)
    assert (color >= function.colors.min(axis=0)).all()
    assert (color <= function.colors.max(axis=0)).all()
    if not math.isnan(s):
        assert function.opacities.min() <= opacity <= function.opacities.max()


def test_outside_the_points_the_end_points_hold():
    s = np.array([-np.inf, -1e300, -1.0, 11.0, 1e300, np.inf])
    np.testing.assert_array_equal(RAMP.opacity(s), [0, 0, 0, 0.8, 0.8, 0.8])
    np.testing.assert_array_equal(RAMP.color(s)[3:], np.tile([1, 0.5, 0.25], (3, 1)))


def test_a_step_takes_the_later_point_at_the_shared_value():
    below = np.nextafter(5.0, 0.0)
    np.testing.assert_allclose(STEP.opacity([below, 5.0]), [0.3, 1.0], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(STEP.color(5.0), [0, 0, 1])


def test_a_step_at_the_ends_holds_outside():
    edge = TransferFunction([1, 1, 2, 2], [0, 0.5, 0.5, 0.9], np.zeros((4, 3)))
    np.testing.assert_array_equal(edge.opacity([0.9, 1, 1.5, 2, 3]), [0, 0.5, 0.5, 0.9, 0.9])


def test_one_point_is_a_constant():
    constant = TransferFunction([7], [0.25], [[0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(constant.opacity([-1, 7, 100]), [0.25] * 3)
    np.testing.assert_array_equal(constant.color([-1, 7, 100]), [[0.1, 0.2, 0.3]] * 3)


def test_nan_is_transparent_and_does_not_spread():
    s = np.array([4.0, np.nan, 6.0])
    np.testing.assert_array_equal(STEP.opacity(s)[1], 0.0)
    np.testing.assert_array_equal(STEP.extinction(s)[1], 0.0)
    assert np.isfinite(STEP.color(s)).all()


def test_extinction_absorbs_the_opacity_over_one_unit():
    function = TransferFunction([0, 1], [0.0, 0.999], np.zeros((2, 3)), opacity_unit=2.5)
    s = np.linspace(0, 1, 101)
    absorbed = -np.expm1(-function.extinction(s) * 2.5)
    np.testing.assert_allclose(absorbed, function.opacity(s), rtol=1e-13, atol=1e-300)


def test_small_opacities_keep_their_digits():
    thin = TransferFunction([0], [1e-12], np.zeros((1, 3)))
    np.testing.assert_allclose(thin.extinction(0.0), 1e-12 + 0.5e-24, rtol=1e-15)


def test_opacity_one_has_infinite_extinction_and_zero_has_none():
    assert STEP.extinction(5.0) == np.inf
    zero = RAMP.extinction(-1.0)
    assert zero == 0.0 and not np.signbit(zero)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3), (2, 3, 5)])
def test_any_shape_of_values_is_taken(shape):
    s = np.full(shape, 5.0, dtype=np.float32)
    assert RAMP.opacity(s).shape == shape
    assert RAMP.extinction(s).shape == shape
    assert RAMP.color(s).shape == (*shape, 3)
    assert RAMP.opacity(s).dtype == RAMP.color(s).dtype == np.float64


def test_the_widest_range_of_doubles_does_not_overflow():
    widest = TransferFunction([-1.7e308, 1.7e308], [0, 1], np.zeros((2, 3)))
    np.testing.assert_allclose(widest.opacity([-1.7e308, 0, 1.7e308]), [0, 0.5, 1])


def test_points_are_copied_and_cannot_be_changed():
    values = np.array([0.0, 1.0])
    function = TransferFunction(values, [0, 1], np.zeros((2, 3)))
    values[0] = 0.5
    assert function.values[0] == 0.0
    with pytest.raises(ValueError):
        function.opacities[0] = 0.3


def test_equal_functions_are_equal():
    again = TransferFunction([0, 10], [0.0, 0.8], [[0, 0, 0], [1, 0.5, 0.25]])
    assert again == RAMP and hash(again) == hash(RAMP)
    assert TransferFunction([0, 10], [0, 0.8], again.colors, opacity_unit=2.0) != RAMP


BLACK = [[0, 0, 0], [0, 0, 0], [0, 0, 0]]


@pytest.mark.parametrize(
    ("values", "opacities", "colors", "unit", "key"),
    [
        ([], [], np.zeros((0, 3)), 1.0, "values"),
        (3.0, [0.1], BLACK[:1], 1.0, "values"),
        (["a"], [0.1], BLACK[:1], 1.0, "values"),
        ([1, 0], [0, 0], BLACK[:2], 1.0, "values.1"),
        ([0, 0, 0], [0, 0, 0], BLACK, 1.0, "values.2"),
        ([0, np.nan], [0, 0], BLACK[:2], 1.0, "values.1"),
        ([0, np.inf], [0, 0], BLACK[:2], 1.0, "values.1"),
        ([0, 1], [0], BLACK[:2], 1.0, "opacities"),
        ([0, 1], [0, 1.5], BLACK[:2], 1.0, "opacities.1"),
        ([0, 1], [-0.1, 1], BLACK[:2], 1.0, "opacities.0"),
        ([0, 1], [0, np.nan], BLACK[:2], 1.0, "opacities.1"),
        ([0, 1], [0, 1], BLACK, 1.0, "colors"),
        ([0, 1], [0, 1], [[0, 0, 0], [0, 2, 0]], 1.0, "colors.1.1"),
        ([0, 1], [0, 1], BLACK[:2], 0.0, "opacity_unit"),
        ([0, 1], [0, 1], BLACK[:2], -1.0, "opacity_unit"),
        ([0, 1], [0, 1], BLACK[:2], np.inf, "opacity_unit"),
        ([0, 1], [0, 1], BLACK[:2], None, "opacity_unit"),
    ],
)
def test_impossible_points_are_refused(values, opacities, colors, unit, key):
    with pytest.raises(SceneError) as refused:
        TransferFunction(values, opacities, colors, unit)
    assert refused.value.where == f"transfer_function: {key}"
    assert refused.value.expected
