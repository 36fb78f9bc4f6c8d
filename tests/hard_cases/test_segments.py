"""Segments: opacities, lengths and transfer functions at the ends of what numbers hold."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import axis_camera, exact, make_scene, picture, rms, waves

from clvol import TransferFunction
from clvol.transfer.preintegration import preintegrate

CLASSIFICATIONS = ("pre", "post", "preintegrated")
FILTERED = [(name, "linear") for name in CLASSIFICATIONS] + [("preintegrated", "nearest")]
TYPES = (np.uint8, np.int16, np.float32, np.float64)
GREY = [[0.3, 0.5, 0.7]]
LENGTH = 8.0  # of the slab along x


def slab_scene(array, function, **keys):
    """Rays along x through the middle of ``array`` [n, n, 9]."""
    middle = (array.shape[0] - 1) / 2
    keys = {"width": 3, "height": 2, "table_size": 64, **keys}
    return make_scene(array, function, camera=axis_camera([4.0, middle, middle], 0, 0.3), **keys)


def slab(function, value=42, dtype=np.uint8, **keys):
    return slab_scene(np.full((3, 3, 9), value, dtype), function, **keys)


def grey(values, opacities, unit=1.0) -> TransferFunction:
    return TransferFunction(values, opacities, np.tile(GREY, (len(values), 1)), unit)


def check_slab(rgba, depth, rtol):
    """Every pixel shows ``depth`` optical depths of grey."""
    opacity = -np.expm1(-depth)
    expected = np.append(opacity * np.array(GREY[0]), opacity)
    np.testing.assert_allclose(rgba, np.broadcast_to(expected, rgba.shape), rtol=rtol, atol=0)


# --- lengths and opacities -------------------------------------------------------------------------


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("exponent", [-12, -9, -6, -3, -1, 0, 1, 3, 6, 12])
def test_optical_depths_from_1e_12_to_1e12_are_the_closed_form(
    device, context, exponent, classification
):
    depth = 10.0**exponent
    by_unit = grey([0], [0.5], LENGTH * np.log(2.0) / depth)
    for step in (0.37, 1.0, 100.0):
        scene = slab(by_unit, step=step, classification=classification)
        check_slab(picture(context, scene).rgba, depth, 3e-6)
    check_slab(exact(device, slab(by_unit, classification=classification)), depth, 1e-11)
    if exponent <= 1:
        by_opacity = grey([0], [-np.expm1(-depth / LENGTH)])
        scene = slab(by_opacity, step=0.37, classification=classification)
        check_slab(picture(context, scene).rgba, depth, 3e-6)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_opacity_0_shows_exactly_nothing(device, context, classification, unit):
    scene = slab(grey([0, 100, 200], [0, 0, 1], unit), classification=classification)
    data = picture(context, scene)
    assert not data.rgba.any() and np.isinf(data.depth).all()
    assert not exact(device, scene).any()


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("step", [0.37, 1.0, 100.0])
def test_opacity_1_is_opaque_at_once(device, context, classification, unit, step):
    scene = slab(grey([0], [1.0], unit), classification=classification, step=step)
    data, reference = picture(context, scene), exact(device, scene)
    for rgba in (data.rgba, reference):
        assert (rgba[..., 3] == 1.0).all()
        np.testing.assert_allclose(rgba[..., :3], np.broadcast_to(GREY, (2, 3, 3)), rtol=1e-6)
    # The slab's front is 36 from the camera's plane; within its first step it is opaque.
    assert (data.depth >= 36 - 1e-4).all() and (data.depth <= 36 + min(step, LENGTH)).all()


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_an_opaque_voxel_among_transparent_ones_hides_and_is_hidden(
    device, context, classification
):
    array = np.zeros((5, 5, 9), np.uint8)
    array[2, 2, 4], array[2, 2, 6] = 2, 1
    function = TransferFunction(
        [0, 0.5, 0.5, 1.5, 1.5], [0, 0, 1, 1, 1], [[0, 0, 0]] * 2 + [[0, 1, 0]] * 2 + [[1, 0, 0]]
    )
    scene = slab_scene(array, function, filter="nearest", classification=classification, step=0.1)
    for rgba in (picture(context, scene).rgba, exact(device, scene)):
        np.testing.assert_allclose(rgba, np.broadcast_to([1, 0, 0, 1], (2, 3, 4)), atol=1e-6)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("below_one", [1e-7, 1e-12, 2.0**-53])
def test_opacity_correction_just_below_1(device, context, classification, below_one):
    share = 0.05  # of an opacity unit: q^0.05 is far from 0 however small q is
    function = grey([0], [1.0 - below_one], LENGTH / share)
    depth = -share * np.log(1.0 - (1.0 - below_one))
    for step in (0.37, 1.0, 100.0):
        scene = slab(function, step=step, classification=classification)
        check_slab(picture(context, scene).rgba, depth, 2e-6)
    check_slab(exact(device, scene), depth, 1e-12)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("opacity", [1e-7, 1e-12, 1e-30])
def test_opacity_correction_just_above_0(device, context, classification, opacity):
    function = grey([0], [opacity], 0.01)
    depth = -LENGTH / 0.01 * np.log1p(-opacity)
    for step in (0.37, 1.0, 100.0):
        scene = slab(function, step=step, classification=classification)
        check_slab(picture(context, scene).rgba, depth, 2e-6)
    check_slab(exact(device, scene), depth, 1e-12)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("total", [0.9, 0.5, 1e-2, 1e-4])
def test_thousands_of_nearly_transparent_segments_add_up(context, classification, total):
    # 20 000 segments. The sum's rounding is 2^-25 of it each, and never all one way but where the
    # segments hardly shrink, which is where the sum is small: 1e-5 of all light holds everywhere.
    function = grey([0], [total], LENGTH)
    scene = slab(function, step=4e-4, classification=classification)
    rgba = picture(context, scene).rgba.astype(np.float64)
    assert np.abs(rgba[..., 3] - total).max() < min(1e-5, 1e-3 * total)
    np.testing.assert_allclose(
        rgba[..., :3], rgba[..., 3:] * np.array(GREY[0]), rtol=2e-3 if total < 1e-3 else 1e-4
    )


def test_thousands_of_nearly_transparent_cells_add_up_in_the_reference(device):
    scene = slab(grey([0], [1e-9]))
    array = np.full((2, 2, 20001), 1.0)
    camera = axis_camera([10000, 0.5, 0.5], 0, 0.3, distance=20000.0)
    scene = make_scene(array, grey([0], [1e-7]), camera=camera, width=1, height=1)
    opacity = -np.expm1(20000 * np.log1p(-1e-7))
    np.testing.assert_allclose(exact(device, scene)[..., 3], opacity, rtol=1e-12)


# --- equal and nearly equal ends -------------------------------------------------------------------

SMOOTH = TransferFunction(
    [0.0, 0.3, 0.6, 1.0], [0.0, 0.2, 0.05, 0.6], [GREY[0], [1, 0, 0], [0, 1, 0], GREY[0]], 3.0
)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("wide", [True, False])
@pytest.mark.parametrize("value", [0.3, 0.45, 0.6, 1e-3])
def test_ends_that_are_equal_or_one_ulp_apart_show_the_constant_segment(
    device, context, classification, wide, value
):
    """``wide``: elsewhere the volume spans 0 to 1; else its whole range is one ulp."""
    value = np.float32(value)
    above = np.nextafter(value, np.float32(1.0))
    expected = preintegrate(SMOOTH, value, value, LENGTH)
    for pattern in ((value, value), (value, above), (above, value)):
        array = np.empty((5, 5, 9), np.float32)
        array[:, :, 0::2], array[:, :, 1::2] = pattern
        if wide:
            array[0, 0, 0], array[0, 0, 1] = 0.0, 1.0
        scene = slab_scene(array, SMOOTH, classification=classification, step=0.7)
        rgba = picture(context, scene).rgba
        # A kink of the function, here in its colour, is cut short between nodes.
        limit = 5e-4 if wide else 2e-6
        np.testing.assert_allclose(rgba, np.broadcast_to(expected, rgba.shape), atol=limit)
        np.testing.assert_allclose(
            exact(device, scene), np.broadcast_to(expected, rgba.shape), atol=1e-6
        )


# --- steps, peaks, points next to one another ------------------------------------------------------

SPANS = {np.uint8: (0, 255), np.int16: (-32768, 32767), np.float32: (0, 1), np.float64: (0, 1)}


def plateau(values, dtype, **keys):
    """Rays through voxels of one value, of ``values`` in turn, in a volume that spans SPANS."""
    low, high = SPANS[dtype]
    scenes = []
    for value in values:
        array = np.full((5, 5, 9), value, dtype)
        array[0, 0, 0], array[0, 0, 1] = low, high  # not met by a ray
        scenes.append(slab_scene(array, step=0.5, **keys))
    return scenes


@pytest.mark.parametrize("classification, filter_name", FILTERED)
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("place", [0.3, 0.7001, 1.0])
def test_a_step_at_exactly_a_voxels_value_shows_what_is_behind_it(
    device, context, classification, dtype, filter_name, place
):
    low, high = SPANS[dtype]
    at = dtype(low + place * (high - low))
    function = grey([low, at, at], [0.05, 0.05, 0.3])
    just_below = at - dtype(1) if np.dtype(dtype).kind in "iu" else dtype(at - 2e-4)
    scenes = plateau(
        (at, just_below), dtype, function=function, classification=classification,
        filter=filter_name,
    )  # fmt: skip
    for scene, opacity in zip(scenes, (0.3, 0.05)):
        depth = -LENGTH * np.log1p(-opacity)
        check_slab(exact(device, scene), depth, 1e-12)
        check_slab(picture(context, scene).rgba, depth, 1e-5)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("place", [0.3, 0.7001])
def test_voxels_at_a_peak_narrower_than_a_table_cell_show_the_peak(
    device, context, classification, dtype, place
):
    low, high = SPANS[dtype]
    at = dtype(low + place * (high - low))
    width = 1 if dtype == np.uint8 else (high - low) / 8000
    function = grey([low, at - width, at, at + width, high], [0, 0, 0.3, 0, 0])
    (scene,) = plateau((at,), dtype, function=function, classification=classification)
    depth = -LENGTH * np.log1p(-0.3)
    check_slab(exact(device, scene), depth, 1e-9)
    # Float32 places a value among 65536 bins to 1/100 of a bin, here 1/1000 of the peak's slope.
    check_slab(picture(context, scene).rgba, depth, 2e-3)


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6, 1e-9])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_field_that_crosses_a_narrow_peak_gathers_all_of_it(device, context, width, dtype):
    """Pre-integration does not step over it: as long as the ray's values are linear, at any step."""
    array = np.broadcast_to(np.linspace(0, 1, 9, dtype=dtype), (3, 3, 9))
    at = 0.37
    function = grey([0, at - width, at, at + width, 1], [0, 0, 0.9, 0, 0], width)
    for step in (0.3, 1.0):
        scene = slab_scene(array, function, step=step, table_size=256)
        reference = exact(device, scene)
        assert reference[..., 3].min() > 0.9
        np.testing.assert_allclose(picture(context, scene).rgba, reference, atol=4e-3)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("low", [-0.01, -1.0])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_control_points_1e_30_apart_are_a_step(device, context, classification, low, dtype):
    array = waves((9, 9, 9), dtype, low, 1.0)
    near = TransferFunction([low, 0, 1e-30, 1], [0, 0.01, 0.1, 0.3], np.eye(4, 3) * 0.5)
    step = TransferFunction([low, 0, 0, 1], [0, 0.01, 0.1, 0.3], np.eye(4, 3) * 0.5)
    scenes = [
        make_scene(array, function, classification=classification, step=0.05)
        for function in (near, step)
    ]
    one, other = (exact(device, scene) for scene in scenes)
    np.testing.assert_allclose(one, other, atol=1e-9)
    assert one[..., 3].max() > 0.1
    assert rms(picture(context, scenes[0]).rgba, one) < 1e-3
    assert rms(picture(context, scenes[1]).rgba, one) < 1e-3
