"""Gradients in the kernels, on the fly and precomputed, against their definitions in float64."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.field_points import (
    TYPES,
    at_points,
    evaluate,
    lattice_points,
    rough,
    spline_at,
    voxel_gradients,
)
from helpers.small_scenes import waves

from clvol import Volume
from clvol.device.gradients import gradient_switch, precompute
from clvol.device.volume import DeviceVolume
from clvol.features import GRADIENTS
from clvol.features.gradient_storage import DeviceLimits, chosen_storage, gradient_bytes
from clvol.volume import voxel_layout as layout

OPERATORS = ("central", "sobel")
THIN = [(1, 5, 6), (5, 1, 6), (5, 6, 1), (1, 1, 4), (1, 1, 1), (2, 2, 2), (3, 2, 5)]
ROUNDING = 1e-6  # of the largest value: some ten roundings of float32


def span(dtype):
    return (-100, 100) if np.dtype(dtype).kind == "i" else (0, 255)


def noise(shape, dtype):
    return rough(shape, dtype, *span(dtype))


def expected(array, at, operator, filter="linear"):
    if filter == "nearest":
        at = np.floor(at + 0.5)
    return at_points(voxel_gradients(array, operator), at)


def agree(found, wanted, resident, largest=255.0):
    gain = resident.values.gain
    np.testing.assert_allclose(found, wanted * gain, rtol=0, atol=ROUNDING * largest * gain)


# --- on the fly ------------------------------------------------------------------------------------


@pytest.mark.parametrize("lanes", [1, 16])
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("operator", OPERATORS)
def test_on_the_fly_it_is_the_voxels_differences_interpolated(context, operator, dtype, lanes):
    array = noise((6, 7, 9), dtype)
    at = lattice_points(array.shape)
    found, _, resident = evaluate(context, array, operator, at, lanes=lanes)
    agree(found, expected(array, at, operator), resident)
    other = expected(array, at, OPERATORS[operator == "central"])
    assert np.abs(other * resident.values.gain - found).max() > 0.1 * np.abs(found).max()


@pytest.mark.parametrize("shape", THIN)
@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
@pytest.mark.parametrize("operator", OPERATORS)
def test_an_axis_of_one_voxel_has_no_derivative_and_two_have_one(context, operator, dtype, shape):
    array = noise(shape, dtype)
    at = lattice_points(shape, 64)
    found, _, resident = evaluate(context, array, operator, at)
    held = np.minimum(at, np.array(shape[::-1]) - 1)
    agree(found, expected(array, held, operator), resident)


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_under_the_nearest_filter_it_is_that_of_the_nearest_voxel(context, operator, dtype):
    array = noise((6, 7, 9), dtype)
    at = lattice_points(array.shape)
    found, _, resident = evaluate(context, array, operator, at, filter="nearest")
    agree(found, expected(array, at, operator, "nearest"), resident)
    stored, _, _ = evaluate(
        context, array, "precomputed", at, filter="nearest", operator=operator
    )
    assert np.abs(stored - found).max() < 0.01 * np.abs(found).max()


@pytest.mark.parametrize("dtype", [np.uint8, np.int16])
def test_its_bits_do_not_depend_on_what_else_is_in_the_packet(context, dtype):
    """Points at faces of the volume among the others, and each point in a packet of its own."""
    array = rough((9, 11, 10), dtype)
    at = lattice_points(array.shape, 64)
    together, _, _ = evaluate(context, array, "central", at)
    alone, _, _ = evaluate(context, array, "central", np.repeat(at, 16, axis=0))
    assert np.array_equal(together, alone[::16])


@pytest.mark.parametrize("operator", OPERATORS)
def test_large_8_bit_volumes_are_not_held_as_pairs(context, monkeypatch, operator):
    array = noise((6, 7, 9), np.uint8)
    at = lattice_points(array.shape)
    pairs, _, _ = evaluate(context, array, operator, at)
    monkeypatch.setattr(layout, "_LARGEST_PAIRS", 100)
    plain, _, resident = evaluate(context, array, operator, at)
    assert resident.switches["VOXEL_PAIRS"] == 0
    np.testing.assert_allclose(plain, pairs, atol=ROUNDING * 255)


@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize("dtype", TYPES)
def test_a_constant_field_has_exactly_none(context, gradient, dtype):
    filters = ("cubic", "catmull-rom") if gradient == "analytic" else ("linear", "nearest")
    array = np.full((5, 6, 7), 77.7 if np.dtype(dtype).kind == "f" else 77, dtype)
    for filter in filters:
        found, _, _ = evaluate(
            context, array, gradient, lattice_points(array.shape, 64), filter=filter
        )
        assert not found.any()


@pytest.mark.parametrize("gradient", ["central", "sobel", "precomputed"])
@pytest.mark.parametrize("dtype", [np.uint8, np.float64])
def test_of_a_linear_field_it_is_the_slope_everywhere(context, gradient, dtype):
    slope = np.array([5.0, 7.0, 3.0])
    z, y, x = np.indices((5, 6, 7))
    array = (slope[0] * x + slope[1] * y + slope[2] * z + 9).astype(dtype)
    found, _, resident = evaluate(context, array, gradient, lattice_points(array.shape))
    wanted = np.broadcast_to(slope * resident.values.gain, found.shape)
    tolerance = 1 / 254 * 7 if gradient == "precomputed" else ROUNDING * 100
    np.testing.assert_allclose(found, wanted, atol=tolerance * resident.values.gain)


@pytest.mark.parametrize("magnitude", [1e-30, 1e30])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("gradient", ["central", "sobel", "precomputed"])
def test_the_magnitude_of_the_values_does_not_matter(context, gradient, dtype, magnitude):
    array = waves((6, 7, 8), np.float64, -1, 1)
    at = lattice_points(array.shape, 64)
    found, _, resident = evaluate(context, (array * magnitude).astype(dtype), gradient, at)
    wanted = expected(array, at, "central" if gradient == "precomputed" else gradient)
    scale = resident.values.gain * magnitude
    tolerance = 0.01 * np.abs(wanted).max() if gradient == "precomputed" else ROUNDING
    np.testing.assert_allclose(found, wanted * scale, atol=tolerance * scale)


# --- the filters' own derivative -------------------------------------------------------------------


@pytest.mark.parametrize("lanes", [1, 16])
@pytest.mark.parametrize("filter", ["cubic", "catmull-rom"])
@pytest.mark.parametrize("dtype", TYPES)
def test_the_analytic_gradient_is_the_derivative_of_the_field(context, filter, dtype, lanes):
    array = noise((6, 7, 9), dtype)
    check_derivative(context, array, filter, lanes)


@pytest.mark.parametrize("shape", [s for s in THIN if 1 not in s])
@pytest.mark.parametrize("filter", ["cubic", "catmull-rom"])
def test_the_analytic_gradient_of_thin_volumes(context, filter, shape):
    check_derivative(context, noise(shape, np.uint16), filter, 16)


def check_derivative(context, array, filter, lanes):
    at = lattice_points(array.shape)
    found, values, resident = evaluate(
        context, array, "analytic", at, filter=filter, lanes=lanes
    )
    h = 1e-6  # the field's slope is continuous, and its curvature jumps: an error of the order of h
    at = at.astype(np.float64)
    wanted = np.stack(
        [
            (spline_at(array, at + h * e, filter) - spline_at(array, at - h * e, filter)) / (2 * h)
            for e in np.eye(3)
        ],
        -1,
    )
    gain = resident.values.gain
    np.testing.assert_allclose(found, wanted * gain, rtol=0, atol=3e-6 * 255 * gain)
    field = (spline_at(array, at, filter) - resident.values.bias) * gain
    np.testing.assert_allclose(values, field, rtol=0, atol=ROUNDING * 255 * gain)


@pytest.mark.parametrize("filter", ["cubic", "catmull-rom"])
def test_analytic_an_axis_of_one_voxel_has_no_derivative(context, filter):
    array = noise((1, 5, 6), np.uint8)
    found, _, _ = evaluate(context, array, "analytic", lattice_points((1, 5, 6)), filter=filter)
    assert np.abs(found[:, 2]).max() < ROUNDING * 255 < np.abs(found[:, 0]).max()


# --- precomputed -----------------------------------------------------------------------------------


def stored_bound(wanted, edges):
    """What four bytes may be off by at a voxel, [nz, ny, nx, 3], of ``wanted`` the gradients a lattice
    unit: half of 1/127 of the length's unit, whose root is rounded up to a multiple of 1/255."""
    metric = np.abs(wanted) / edges
    longest, largest = metric.max(-1), metric.max()
    unit = (np.sqrt(longest) + np.sqrt(largest) / 255) ** 2
    return (0.5 + 1e-3) / 127 * unit[..., None] * edges


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.3, 2.0, 0.7), (1e-20, 7e-20, 3e-20)])
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("operator", OPERATORS)
def test_precomputed_it_is_the_same_within_four_bytes(context, operator, dtype, spacing):
    array = noise((6, 7, 9), dtype)
    array[3:] = np.rint(array[3:] * 0.02)  # short ones beside long ones
    at = lattice_points(array.shape)
    found, _, resident = evaluate(
        context, Volume(array, spacing), "precomputed", at, operator=operator
    )
    voxels = voxel_gradients(array, operator)
    bound = at_points(stored_bound(voxels, np.array(spacing) / min(spacing)), at)
    gain = resident.values.gain
    error = np.abs(found - at_points(voxels, at) * gain)
    assert np.all(error <= (bound + ROUNDING * 255) * gain)
    assert error.max() > 0.1 * bound.max() * gain  # the bound says something


@pytest.mark.parametrize("shape", THIN)
@pytest.mark.parametrize("operator", OPERATORS)
def test_precomputed_gradients_of_thin_volumes(context, operator, shape):
    array = noise(shape, np.int16)
    at = lattice_points(shape, 64)
    found, _, _ = evaluate(context, array, "precomputed", at, operator=operator)
    voxels = voxel_gradients(array, operator)
    held = np.minimum(at, np.array(shape[::-1]) - 1)
    bound = at_points(stored_bound(voxels, np.ones(3)), held) + ROUNDING * 255
    assert np.all(np.abs(found - at_points(voxels, held)) <= bound)


def test_directions_are_right_to_half_a_degree_also_in_flat_voxels(context):
    spacing = np.array([0.2, 1.0, 3.0])
    array = waves((12, 13, 14), np.float32)
    at = np.argwhere(np.ones(array.shape))[:, ::-1].astype(np.float32)
    at = at[: len(at) // 16 * 16]
    found, _, _ = evaluate(context, Volume(array, spacing), "precomputed", at)
    a, b = found / spacing, expected(array, at, "central") / spacing
    shown = np.linalg.norm(b, axis=1) > 1e-3 * np.linalg.norm(b, axis=1).max()
    assert shown.mean() > 0.9
    cosine = np.sum(a * b, 1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    assert np.degrees(np.arccos(np.clip(cosine[shown], -1, 1))).max() < 0.5


def test_the_scale_says_how_long_the_longest_is(context):
    array = noise((6, 7, 9), np.int16)
    resident = DeviceVolume(context, Volume(array, (0.5, 1.0, 2.0)))
    codes, scale = precompute(context, resident, "central")
    longest = (np.abs(voxel_gradients(array, "central")) / (1, 2, 4)).max()
    assert scale[3] == pytest.approx(longest) and codes.shape == array.shape
    # A stored number is at most 255^2 * 127.
    np.testing.assert_allclose(scale[:3] * 255**2 * 127, longest * np.array([1, 2, 4]), rtol=1e-6)


# --- not a number ----------------------------------------------------------------------------------


@pytest.mark.parametrize("lanes", [1, 16])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("gradient", ["central", "sobel", "precomputed"])
def test_what_uses_a_voxel_that_is_not_a_number_is_none_and_all_else_is_not_touched(
    context, gradient, bad, lanes
):
    operator = "central" if gradient == "precomputed" else gradient
    array = noise((8, 9, 10), np.float32)
    array[4, 4, 5] = array[0, 8, 0] = bad
    at = lattice_points(array.shape, 2048)
    found, _, resident = evaluate(context, array, gradient, at, lanes=lanes)
    with np.errstate(invalid="ignore"):
        voxels = voxel_gradients(array, operator)
        hurt = ~np.isfinite(voxels).all(-1)
        finite = np.where(hurt[..., None], 0.0, voxels)
    # A voxel of weight 0 does not count.
    touched = at_points(hurt.astype(float), at) > 0
    assert touched.any() and not found[touched].any()
    wanted = at_points(finite, at)
    bound = ROUNDING * 255 if gradient != "precomputed" else 0.01 * np.abs(finite).max()
    np.testing.assert_allclose(found[~touched], wanted[~touched], rtol=0, atol=bound)
    assert np.isfinite(found).all()


@pytest.mark.parametrize("filter", ["cubic", "catmull-rom"])
def test_the_analytic_gradient_is_none_where_a_voxel_is_not_a_number(context, filter):
    array = noise((9, 9, 9), np.float32)
    at = lattice_points(array.shape, 2048)
    whole, _, _ = evaluate(context, array, "analytic", at, filter=filter)
    array[4, 4, 4] = np.nan
    found, values, _ = evaluate(context, array, "analytic", at, filter=filter)
    beside = (np.abs(at - 4) >= 2).any(1)
    np.testing.assert_allclose(found[beside], whole[beside], atol=ROUNDING * 255)
    inside = (np.abs(at - 4) < 2).all(1) & (at % 1 != 0).all(1)
    assert inside.any() and not found[inside].any()
    assert np.isnan(values[inside]).all() and np.isfinite(values[beside]).all()


# --- where they are held ---------------------------------------------------------------------------


def test_gradients_are_precomputed_where_they_fit_and_save_words():
    small, wide = Volume(noise((8, 9, 10), np.uint8)), Volume(noise((8, 9, 10), np.float32))
    much = DeviceLimits(2**34, 2**32)
    assert gradient_bytes(small) == 4 * 720
    assert chosen_storage(small, "central", "auto", much) == "on-the-fly"
    assert chosen_storage(small, "sobel", "auto", much) == "precomputed"
    assert chosen_storage(wide, "central", "auto", much) == "precomputed"
    for little in (DeviceLimits(2**34, 2879), DeviceLimits(8000, 2**32)):
        assert chosen_storage(wide, "central", "auto", little) == "on-the-fly"
        assert chosen_storage(wide, "central", "precomputed", little) == "precomputed"
    assert gradient_switch(wide, "linear", "sobel", "on-the-fly", much) == GRADIENTS["sobel"]
    assert gradient_switch(wide, "linear", "sobel", "auto", much) == GRADIENTS["precomputed"]
    for filter in ("cubic", "catmull-rom"):
        assert gradient_switch(wide, filter, "sobel", "precomputed", much) == GRADIENTS["analytic"]
