"""Fields: sizes, spacings and values at the ends of what a volume may hold."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, axis_camera, exact, make_scene, picture, waves

from clvol import Scene, TransferFunction, Volume
from clvol.errors import RenderError, SceneError
from clvol.features import called_for, reduced

CLASSIFICATIONS = ("pre", "post", "preintegrated")
FILTERED = [(name, "linear") for name in CLASSIFICATIONS] + [("preintegrated", "nearest")]
TYPES = (np.uint8, np.int16, np.float32, np.float64)
GREY = [[0.3, 0.5, 0.7]]


def agree(device, context, scene, atol=5e-4):
    """The ray caster's picture is the reference's, and there is something to be seen."""
    rgba, reference = picture(context, scene).rgba, exact(device, scene)
    assert np.isfinite(rgba).all() and np.isfinite(reference).all()
    assert reference[..., 3].max() > 0.02
    np.testing.assert_allclose(rgba, reference, atol=atol)
    return rgba, reference


# --- sizes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("value", [0, 42, 127])
def test_a_constant_field_shows_its_value(device, context, dtype, classification, value):
    scene = make_scene(
        np.full((5, 4, 6), value, dtype), SMOOTH, classification=classification, step=0.7,
        table_size=64,
    )  # fmt: skip
    rgba, reference = picture(context, scene).rgba, exact(device, scene)
    np.testing.assert_allclose(rgba, reference, atol=3e-6)
    assert (reference[..., 3].max() > 0.01) == (value > 0)


@pytest.mark.parametrize(
    "shape",
    [(1, 1, 1), (1, 8, 8), (8, 1, 8), (8, 8, 1), (1, 1, 8), (1, 8, 1), (8, 1, 1), (2, 2, 2),
     (2, 1, 2)],
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("filter_name", ["linear", "nearest"])
def test_thin_volumes_are_slabs_one_voxel_thick(device, context, shape, dtype, filter_name):
    array = waves(shape, dtype) if np.prod(shape) > 1 else np.full(shape, 200, dtype)
    scene = make_scene(array, step=0.01, filter=filter_name)
    agree(device, context, scene, 3e-3 if filter_name == "nearest" else 5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("shape", [(3, 5, 7), (11, 2, 9), (17, 9, 3), (2, 33, 10), (8, 16, 24)])
def test_sizes_that_are_multiples_of_nothing(device, context, shape, classification):
    for dtype in (np.uint8, np.float32):
        scene = make_scene(waves(shape, dtype), step=0.05, classification=classification)
        agree(device, context, scene)


# --- spacings --------------------------------------------------------------------------------------


@pytest.mark.parametrize("edge", [1e-30, 1e-6, 1e6, 1e28])
def test_the_voxel_edge_does_not_matter(device, context, edge):
    # An orthographic default view: its fields are all lengths.
    plain = make_scene(waves((9, 10, 11)), camera={"projection": "orthographic"}, step=0.5)
    function = TransferFunction(SMOOTH.values, SMOOTH.opacities, SMOOTH.colors, edge)
    scaled = make_scene(
        waves((9, 10, 11)), function, camera={"projection": "orthographic"}, step=0.5,
        grid={"spacing": (edge,) * 3},
    )  # fmt: skip
    one, other = (picture(context, scene) for scene in (plain, scaled))
    assert one.rgba[..., 3].max() > 0.2
    np.testing.assert_allclose(other.rgba, one.rgba, atol=1e-5)
    seen = np.isfinite(one.depth)
    np.testing.assert_allclose(other.depth[seen] / edge, one.depth[seen], rtol=1e-4)
    np.testing.assert_allclose(exact(device, scaled), exact(device, plain), atol=1e-9)


def test_edges_that_no_float32_depth_can_hold_are_refused(context):
    function = TransferFunction([0], [0.5], GREY)
    tiny = make_scene(waves((5, 5, 5)), function, grid={"spacing": (1e-60,) * 3})
    with pytest.raises(RenderError, match="camera: numbers beyond float32, expected .* units"):
        picture(context, tiny)
    with pytest.raises(SceneError, match="camera"):
        make_scene(waves((5, 5, 5)), function, grid={"spacing": (1e60,) * 3})


@pytest.mark.parametrize("spacing", [(1, 1, 1000), (1000, 1, 1), (1, 1000, 1000), (1e-3, 1, 1)])
@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_anisotropy_of_a_thousand(device, context, spacing, classification):
    longest = int(np.argmax(spacing))
    volume = Volume(waves((5, 6, 7)), spacing=spacing)
    centre = volume.grid.world_corners().mean(axis=0)
    # Along the longest edges and, from the middle of the volume, obliquely to all of them.
    oblique = {"position": centre.tolist(), "target": (centre + [3, 2, 1]).tolist(),
               "up": [0, 0, 1], "fov_degrees": 80.0}  # fmt: skip
    height = 2.0 * float(np.sort(np.ptp(volume.grid.world_corners(), axis=0))[0])
    for camera, unit in ((axis_camera(centre, longest, height, distance=1e4), max(spacing)),
                         (oblique, min(spacing))):  # fmt: skip
        function = TransferFunction(SMOOTH.values, SMOOTH.opacities, SMOOTH.colors, unit)
        scene = make_scene(
            volume, function, camera=camera, step=0.125, classification=classification
        )
        agree(device, context, scene)


# --- values ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("top", [1e-45, 1e-41, 1e-38, 1e-30, 1e30, 3e38])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_magnitude_of_the_values_does_not_matter(device, context, top, dtype, classification):
    """Down to fields that are denormal everywhere."""
    if dtype == np.float64 and top < 1e-30:
        top = {1e-45: 5e-322, 1e-41: 1e-310, 1e-38: 1e-300}[top]
    # A power of two, at least the smallest number there is, so that nothing is rounded.
    smallest = 2.0 ** np.floor(np.log2(top / 100)) if top > 1e-30 else top / 100
    smallest = max(float(np.finfo(dtype).smallest_subnormal), 2.0 ** np.ceil(np.log2(smallest)))
    array = np.round(waves((7, 8, 9), np.float64, 0, 100))
    pictures = []
    for scale in (1.0, smallest):
        function = TransferFunction(
            np.array([0.0, 25.0, 60.0, 100.0]) * scale, SMOOTH.opacities, SMOOTH.colors
        )
        scene = make_scene(
            (array * scale).astype(dtype), function, step=0.1, classification=classification
        )
        pictures.append(agree(device, context, scene, 1e-3))
    for plain, scaled in zip(*pictures):
        np.testing.assert_allclose(scaled, plain, atol=1e-5)


@pytest.mark.parametrize("offset", [1e3, -1e6])
@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_a_small_range_far_from_zero(device, context, offset, classification):
    array = (offset + waves((7, 8, 9), np.float64, 0, 1)).astype(np.float32)
    function = TransferFunction(
        offset + np.array([0, 0.25, 0.6, 1.0]), SMOOTH.opacities, SMOOTH.colors
    )
    scene = make_scene(array, function, step=0.1, classification=classification)
    # At -1e6 neighbouring float32 are 1/16 of this range apart: sums of them round as coarsely.
    agree(device, context, scene, 5e-4 if offset == 1e3 else 2e-2)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_int16_over_its_full_range(device, context, classification):
    array = waves((9, 10, 11), np.int16, -32768, 32767)
    assert array.min() == -32768 and array.max() == 32767
    function = TransferFunction(
        [-32768, -10000, 0, 32767], SMOOTH.opacities, SMOOTH.colors
    )
    agree(device, context, make_scene(array, function, step=0.1, classification=classification))


@pytest.mark.parametrize("classification, filter_name", FILTERED)
@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
def test_a_checkerboard(device, context, dtype, classification, filter_name):
    """The steepest field there is, alternating between the ends of the range."""
    low, high = (-32768, 32767) if dtype == np.int16 else (0, 255)
    array = np.where(np.indices((8, 9, 10)).sum(axis=0) % 2, high, low).astype(dtype)
    function = TransferFunction(
        low + SMOOTH.values / 255 * (high - low), SMOOTH.opacities, SMOOTH.colors
    )
    scene = make_scene(
        array, function, step=0.01, classification=classification, filter=filter_name
    )
    agree(device, context, scene, 5e-3 if filter_name == "nearest" else 1e-3)


# --- voxels that are not numbers -------------------------------------------------------------------


def box_camera(height=8.0):
    return axis_camera([4, 4, 4], 2, height)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_voxel_that_is_not_a_number_is_transparent_and_does_not_spread(
    device, context, classification, dtype, bad
):
    function = TransferFunction([0], [0.2], GREY)
    array = np.full((9, 9, 9), 50, dtype)
    keys = {"camera": box_camera(9.0), "width": 9, "height": 9, "step": 0.02}
    keys["classification"] = classification
    array[4, 4, 4] = bad
    alpha = picture(context, make_scene(array, function, **keys)).rgba[..., 3]
    # Nine pixels over nine voxel lengths: rays in planes of voxels, all but one of which give the
    # hole no weight. That one loses the cell before and the cell behind.
    expected = np.full((9, 9), 1 - 0.8**8)
    expected[4, 4] = 1 - 0.8**6
    np.testing.assert_allclose(alpha, expected, atol=5e-3)
    np.testing.assert_allclose(np.delete(alpha, 40), np.delete(expected, 40), rtol=1e-6)
    reference = exact(device, make_scene(array, function, **keys))[..., 3]
    np.testing.assert_allclose(reference, expected, rtol=1e-12)
    # Between voxels every ray within one of the hole loses its two cells.
    keys["camera"] = box_camera(8.0)
    scene = make_scene(array, function, **keys)
    np.testing.assert_allclose(
        picture(context, scene).rgba, exact(device, scene), atol=5e-3
    )


@pytest.mark.parametrize("classification, filter_name", FILTERED)
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_plane_of_voxels_that_are_not_numbers(
    device, context, classification, filter_name, axis, bad
):
    array = waves((9, 9, 9))
    np.moveaxis(array, axis, 0)[4] = bad
    keys = {"step": 0.02, "classification": classification, "filter": filter_name}
    shown = []
    for camera in (box_camera(9.0), None):
        scene = make_scene(array, camera=camera, width=18, height=18, **keys)
        # Where the hole begins is known to a step.
        shown.append(agree(device, context, scene, 1e-2))
    whole = exact(device, make_scene(waves((9, 9, 9)), width=18, height=18, **keys))
    assert shown[-1][0][..., 3].sum() < 0.95 * whole[..., 3].sum()


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("shape", [(1, 1, 1), (4, 5, 6)])
def test_nothing_but_voxels_that_are_not_numbers_shows_nothing(
    device, context, classification, dtype, bad, shape
):
    function = TransferFunction([0], [1.0], GREY)
    scene = make_scene(np.full(shape, bad, dtype), function, classification=classification)
    data = picture(context, scene)
    assert not data.rgba.any() and data.samples == 0
    assert not exact(device, scene).any()


# --- lights ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("array", [np.full((5, 5, 5), 7, np.uint8), np.zeros((1, 1, 1), np.float32)])
def test_shading_where_gradients_are_zero_is_not_called_for(array):
    for intensity in (1.0, 0.0):
        light = {"type": "headlight", "intensity": intensity}
        scene = Scene(volume=Volume(array), light=(light,)).resolve()
        assert called_for(scene) == ["emission-absorption"]
        assert reduced(scene).lights == ()
