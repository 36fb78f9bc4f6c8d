"""The cubic B-spline filter of the ray caster, against the exact integral and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, make_scene, rms, waves

from clvol import TransferFunction
from clvol.device.volume import DeviceVolume
from clvol.explanation import explain
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.reference.picture import render_reference
from clvol.volume import voxel_layout as layout

CLASSIFICATIONS = ("pre", "post", "preintegrated")
TYPES = (np.uint8, np.int8, np.uint16, np.int16, np.float32, np.float64)
PEAKS = TransferFunction(
    [0, 95, 100, 105, 175, 180, 185, 255],
    [0, 0, 0.7, 0, 0, 0.9, 0, 0],
    [[1, 0, 0]] * 4 + [[0, 1, 0]] * 4,
)
GREY = [[0.3, 0.5, 0.7]]


def cubic_scene(array=None, function=SMOOTH, **keys):
    return make_scene(array, function, filter="cubic", **keys)


def picture(context, resolved, **how):
    caster = Raycaster(context, resolved, **how)
    return caster.render(resolved.camera, resolved.image.width, resolved.image.height)


def exact(device, resolved):
    return render_reference(resolved, device)[0]


def rough(shape, dtype=np.uint8, low=0, high=255):
    """Noise, which no other reconstruction of the same voxels agrees with."""
    return np.random.default_rng(6).integers(low, high + 1, shape).astype(dtype)


def along_z(size, **keys):
    """An orthographic view along z with one pixel for each column of voxels, 0 ... size - 1."""
    centre = (size - 1) / 2
    camera = {
        "projection": "orthographic", "position": [centre, centre, -9],
        "target": [centre, centre, 2], "up": [0, -1, 0], "height": float(size),
    }  # fmt: skip
    return {"camera": camera, "width": size, "height": size, **keys}


# --- against the exact integral --------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("dtype", TYPES)
def test_every_voxel_type_agrees_with_the_exact_integral(device, context, dtype):
    low, high = (-100, 100) if np.dtype(dtype).kind == "i" else (0, 255)
    function = TransferFunction(
        SMOOTH.values / 255 * (high - low) + low, SMOOTH.opacities, SMOOTH.colors
    )
    scene = cubic_scene(rough((12, 13, 14), dtype, low, high), function, step=0.05)
    reference = exact(device, scene)
    assert rms(picture(context, scene).rgba, reference) < 1e-5
    linear = make_scene(scene.volume, function, step=0.05)
    assert rms(exact(device, linear), reference) > 0.01  # the test can tell the filters apart


@pytest.mark.slow
@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("lanes", [1, 16])
def test_every_classification_agrees_with_the_exact_integral(
    device, context, classification, lanes
):
    scene = cubic_scene(rough((12, 13, 14)), step=0.05, classification=classification)
    assert rms(picture(context, scene, lanes=lanes).rgba, exact(device, scene)) < 1e-5


@pytest.mark.parametrize(
    "shape", [(1, 8, 8), (8, 1, 8), (8, 8, 1), (1, 1, 8), (1, 1, 1), (2, 2, 2), (3, 2, 5)]
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_thin_volumes_agree_with_the_exact_integral(device, context, shape, dtype):
    array = rough(shape, dtype) if max(shape) > 1 else np.full(shape, 200, dtype)
    scene = cubic_scene(array, step=0.02)
    reference = exact(device, scene)
    assert reference[..., 3].max() > 0.01
    np.testing.assert_allclose(picture(context, scene).rgba, reference, atol=1e-4)


@pytest.mark.slow
def test_large_8_bit_volumes_are_not_held_as_pairs(device, context, monkeypatch):
    scene = cubic_scene(rough((12, 13, 14)), step=0.05)
    pairs = picture(context, scene)
    monkeypatch.setattr(layout, "_LARGEST_PAIRS", 100)
    caster = Raycaster(context, scene)
    assert caster.switches["VOXEL_PAIRS"] == 0
    assert np.array_equal(caster.render(scene.camera, 24, 20).rgba, pairs.rgba)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_it_converges_with_second_order_down_to_1e_5(device, context, classification):
    array = waves((33, 35, 37))
    scenes = [
        cubic_scene(
            array, width=16, height=16, step=step, classification=classification, table_size=512
        )
        for step in (4.0, 2.0, 1.0, 0.5, 0.25, 0.0625)
    ]
    reference = exact(device, scenes[0])
    errors = [rms(picture(context, scene).rgba, reference) for scene in scenes]
    order = np.log2(errors[0] / errors[4]) / 4
    assert order > (1.7 if classification == "preintegrated" else 1.5), errors
    assert errors[-1] < 1e-5, errors


# --- closed forms ----------------------------------------------------------------------------------


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("dtype, value", [(np.uint8, 77), (np.int16, -3001), (np.float32, 0.1)])
def test_a_constant_field_is_exactly_constant(context, dtype, value, classification):
    """A step in the transfer function right at the value would show the slightest rounding."""
    array = np.full((6, 7, 8), value, dtype)
    at = float(dtype(value))
    function = TransferFunction([at, at], [0.0, 0.35], GREY * 2, opacity_unit=1.7)
    if classification == "preintegrated":  # whose tables hold no step within a cell of their nodes
        function = TransferFunction([at], [0.35], GREY, opacity_unit=1.7)
    keys = {"step": 0.37, "classification": classification}
    linear = picture(context, make_scene(array, function, **keys))
    cubic = picture(context, cubic_scene(array, function, **keys))
    assert linear.rgba[..., 3].max() > 0.5
    if classification == "pre":
        np.testing.assert_allclose(cubic.rgba, linear.rgba, atol=2e-6)
    else:
        assert np.array_equal(cubic.rgba, linear.rgba)


def test_one_bright_column_is_the_b_spline_of_the_distance(context):
    """Classified first, it absorbs as the product of two splines, wherever the ray runs."""
    array = np.zeros((5, 9, 9), np.uint8)
    array[:, 4, 4] = 255
    function = TransferFunction([0.0, 255.0], [0.0, 0.9], GREY * 2)
    keys = along_z(9, step=0.25, classification="pre")
    keys["width"] = keys["height"] = 45
    alpha = picture(context, cubic_scene(array, function, **keys)).rgba[..., 3]
    d = np.abs((np.arange(45) - 22) / 5)
    spline = np.where(d < 1, 2 / 3 - d**2 + d**3 / 2, np.clip(2 - d, 0, None) ** 3 / 6)
    np.testing.assert_allclose(alpha, 1 - 0.1 ** (4 * np.outer(spline, spline)), atol=2e-6)


def test_a_linear_field_stays_linear_away_from_the_faces(context):
    x, y, z = np.arange(12.0), np.arange(12.0)[:, None], np.arange(4.0)[:, None, None]
    array = (10 * x + 7 * y + 0 * z).astype(np.float32)
    keys = along_z(12, step=0.5)
    linear = picture(context, make_scene(array, **keys)).rgba
    cubic = picture(context, cubic_scene(array, **keys)).rgba
    assert np.ptp(linear[..., 3]) > 0.1
    np.testing.assert_allclose(cubic[1:-1, 1:-1], linear[1:-1, 1:-1], atol=2e-6)
    assert np.abs(cubic - linear)[0].max() > 1e-3  # beyond a face the field does not go on


# --- what must not change the picture --------------------------------------------------------------


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("lanes", [1, 16])
def test_leaping_over_empty_space_changes_no_bit_and_takes_fewer_samples(
    context, classification, lanes
):
    array = np.zeros((70, 60, 50), np.uint8)
    array[9, 17, 33] = 255  # a voxel inside a cell is seen in the cell before
    array[23, 39, 15] = 255  # and in the one behind
    array[50:60, 40:55, 5:9] = rough((10, 15, 4))
    rising = TransferFunction([0, 1, 255], [0, 0.02, 0.5], GREY * 3)
    for function in (rising, PEAKS):
        scene = cubic_scene(
            array, function, width=64, height=64, classification=classification, step=0.6
        )
        leaping = picture(context, scene, lanes=lanes)
        walking = picture(context, scene, lanes=lanes, skip=False)
        assert leaping.rgba.max() > 0.1
        assert np.array_equal(leaping.rgba, walking.rgba)
        assert np.array_equal(leaping.depth, walking.depth)
        assert leaping.samples < 0.5 * walking.samples


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
@pytest.mark.parametrize("sign", [1, -1])
def test_rounding_never_leaves_the_range_of_the_voxels(context, dtype, sign):
    """Else a cell with no more than the last transparent value in it would not be transparent."""
    array = np.full((40, 40, 40), 3001)
    array[np.random.default_rng(7).random(array.shape) < 0.003] -= 1000 * sign
    array[30:] += 500 * sign
    function = TransferFunction([3001, 3001.001, 4000], [0, 0.99, 0.99], GREY * 3, 1e-3)
    if sign == -1:
        function = TransferFunction([0, 3000.999, 3001], [0.99, 0.99, 0], GREY * 3, 1e-3)
    scene = cubic_scene(
        array.astype(dtype), function, classification="post", step=0.5, width=64, height=64
    )
    leaping, walking = (picture(context, scene, skip=skip) for skip in (True, False))
    assert leaping.rgba[..., 3].max() > 0.1
    if dtype == np.uint16:  # of float values so near a control point none can be told transparent
        assert leaping.samples < 0.7 * walking.samples
    assert np.array_equal(leaping.rgba, walking.rgba)


@pytest.mark.slow
@pytest.mark.parametrize("first, second", [("linear", "cubic"), ("cubic", "linear")])
def test_ray_casters_of_two_filters_may_share_a_volume(context, first, second):
    array = np.zeros((33, 33, 33), np.uint8)
    array[9, 17, 25] = 255
    function = TransferFunction([0, 1, 255], [0, 0.02, 0.5], GREY * 3)
    scenes = {
        name: make_scene(array, function, filter=name, step=0.4, width=64, height=64)
        for name in (first, second)
    }
    shared = DeviceVolume(context, scenes[first].volume)
    for name in (first, second, first):
        together = picture(context, scenes[name], volume=shared)
        walking = picture(context, scenes[name], skip=False)
        assert together.rgba.max() > 0.01
        assert np.array_equal(together.rgba, walking.rgba) and together.samples < walking.samples
        assert together.samples == picture(context, scenes[name]).samples


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_a_packet_and_a_single_ray_give_the_same_picture(context, classification):
    scene = cubic_scene(waves((21, 19, 23)), PEAKS, classification=classification)
    packet, single = (picture(context, scene, lanes=lanes) for lanes in (16, 1))
    np.testing.assert_allclose(packet.rgba, single.rgba, atol=2e-5)


@pytest.mark.parametrize("magnitude", [1e-30, 1e30])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_magnitude_of_the_values_does_not_matter(context, magnitude, dtype):
    array = waves((12, 13, 14), np.float64, 0, 1)
    plain, scaled = (
        picture(context, cubic_scene((array * scale).astype(dtype), TransferFunction(
            SMOOTH.values / 255 * scale, SMOOTH.opacities, SMOOTH.colors))).rgba
        for scale in (1.0, magnitude)
    )  # fmt: skip
    assert plain[..., 3].max() > 0.2
    np.testing.assert_allclose(plain, scaled, atol=1e-4)


# --- not a number ----------------------------------------------------------------------------------


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_voxel_that_is_not_a_number_reaches_two_voxels_and_no_further(
    context, classification, dtype, bad
):
    function = TransferFunction([0], [0.2], GREY)
    array = np.full((13, 13, 13), 50, dtype)
    keys = along_z(13, step=0.25, classification=classification)
    whole = picture(context, cubic_scene(array, function, **keys)).rgba
    array[6, 6, 6] = bad
    hurt = picture(context, cubic_scene(array, function, **keys)).rgba
    assert np.isfinite(hurt).all()
    # One ray a column of voxels: at a distance of exactly two voxels the bad one has no weight.
    distance = np.abs(np.arange(13) - 6)
    touched = (distance[:, None] < 2) & (distance[None, :] < 2)
    assert np.array_equal(hurt[~touched], whole[~touched])
    # Along the others four voxel lengths of twelve are gone.
    np.testing.assert_allclose(hurt[touched][:, 3], 1 - 0.8**8, atol=0.02)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_a_hole_agrees_with_the_exact_integral(device, context, classification):
    array = rough((11, 12, 13), np.float32)
    array[4, 5, 6], array[0, 2, 12], array[10, 3, 1] = np.nan, np.inf, -np.inf
    scene = cubic_scene(array, step=0.01, classification=classification)
    np.testing.assert_allclose(picture(context, scene).rgba, exact(device, scene), atol=2e-3)


# --- what a scene calls for ------------------------------------------------------------------------


def test_explain_names_the_kernel_of_the_cubic_filter():
    array = waves((8, 8, 8), np.uint8)
    listed = explain(cubic_scene(array)), explain(make_scene(array))
    called = [{e["name"] for e in told["effects"] if e["called_for"]} for told in listed]
    assert called[0] == called[1] | {"cubic filter"}
    assert listed[0]["kernel_hash"] != listed[1]["kernel_hash"]
