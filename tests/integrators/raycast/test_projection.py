"""Projections: the extreme, the mean or the attenuated maximum of the values on each ray."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import axis_camera, picture, waves
from reference import render_twin

from clvol import Camera, Scene, TransferFunction, Volume
from clvol.explanation import kernel_hash
from clvol.features import reduced
from clvol.render import Renderer
from clvol.scene import ImageSettings

MODES = ("maximum", "minimum", "average", "attenuated-maximum")
GREY = TransferFunction([0.0, 30.0], [0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 0.5, 0.25]])
SPREAD = TransferFunction([0.0, 255.0], [0.05, 0.9], [[0.1, 0.9, 0.3], [1.0, 0.5, 0.25]], 3.0)
PERSPECTIVE = {"position": (70.0, 50.0, -60.0), "target": (37.0, 33.0, 45.0), "fov_degrees": 40.0}


def projected(mode, array, function=GREY, *, camera=None, size=(4, 4), grid=None, **tables):
    """A reduced scene; by default one ray of each 4 x 4 goes along z through a voxel's middle."""
    centre = [(n - 1) / 2 for n in array.shape[::-1]]
    integration = {"compositing": mode, "step": 1.0, **tables.pop("integration", {})}
    scene = Scene(
        volume=Volume(array, **(grid or {})),
        transfer_function=function,
        camera=Camera(**(camera or axis_camera(centre, axis=2, height=4.0))),
        image=ImageSettings(width=size[0], height=size[1]),
        integration=integration,
        **tables,
    )
    return reduced(scene.resolve())


def ramp(size=16) -> np.ndarray:
    """float32 [size, size, size], rising from 0 by 1 along z."""
    return np.broadcast_to(np.arange(size, dtype=np.float32)[:, None, None], (size,) * 3).copy()


def shown(value, factor=1.0):
    """What GREY shows of a value."""
    alpha = value / 30 * factor
    return [*(np.array([1, 0.5, 0.25]) * value / 30 * alpha), alpha]


def blobs(dtype=np.float32) -> np.ndarray:
    """Bright spots of several sizes in a field that varies slowly, 75 x 67 x 91 voxels."""
    z, y, x = np.meshgrid(np.arange(91.0), np.arange(67.0), np.arange(75.0), indexing="ij")
    field = 20.0 + 10.0 * np.cos(x / 9) * np.cos(y / 7) * np.cos(z / 8)
    rng = np.random.default_rng(5)
    for height, width in zip((225, 200, 170, 120, 90, 60), (3.0, 2.0, 5.0, 4.0, 7.0, 2.5)):
        at = rng.uniform(10, 60, 3)
        square = (x - at[0]) ** 2 + (y - at[1]) ** 2 + (z - at[2]) ** 2
        field = np.maximum(field, height * np.exp(-square / (2 * width**2)))
    return field.astype(dtype)


@pytest.mark.parametrize(
    "mode, step, value, place",
    [
        ("maximum", 1.0, 14.5, 14.5), ("minimum", 1.0, 0.5, 0.5), ("average", 1.0, 7.5, np.inf),
        ("maximum", 4.0, 13.5, 13.5), ("average", 4.0, 7.5, np.inf),
    ],
)  # fmt: skip
def test_extremes_and_mean_of_a_ramp(context, mode, step, value, place):
    """Segments count at their middles; the last one, from 12 to 15, is shorter."""
    found = picture(context, projected(mode, ramp(), integration={"step": step}))
    np.testing.assert_allclose(found.rgba, np.broadcast_to(shown(value), (4, 4, 4)), atol=2e-6)
    np.testing.assert_allclose(found.depth, 40.0 - 7.5 + place, rtol=1e-6)
    assert found.samples <= 16 * np.ceil(15 / step)


def test_of_equal_values_the_first_is_where_it_lies(context):
    found = picture(context, projected("maximum", np.full((16, 16, 16), 12.0, np.float32)))
    np.testing.assert_allclose(found.rgba, np.broadcast_to(shown(12.0), (4, 4, 4)), atol=2e-6)
    np.testing.assert_allclose(found.depth, 40.0 - 7.5 + 0.5, rtol=1e-6)


@pytest.mark.parametrize("attenuation", [0.5, 20.0])
@pytest.mark.parametrize("rises", [True, False], ids=["rising", "falling"])
def test_the_attenuated_maximum_by_its_definition(context, rises, attenuation):
    values = np.arange(15) + 0.5 if rises else 14.5 - np.arange(15)
    best, passed = (-1.0, 0.0, 0.0, 0.0), 0.0
    for k, value in enumerate(values):
        factor = np.exp(-attenuation * passed / 15)
        best = max(best, (value / 15 * factor, -k, value, factor))
        passed += value / 15
    array = ramp() if rises else ramp()[::-1].copy()
    scene = projected("attenuated-maximum", array, integration={"attenuation": attenuation})
    found = picture(context, scene)
    expected = np.broadcast_to(shown(best[2], best[3]), (4, 4, 4))
    np.testing.assert_allclose(found.rgba, expected, atol=3e-6)
    np.testing.assert_allclose(found.depth, 40.0 - 7.5 + 0.5 - best[1], rtol=1e-6)


def test_not_attenuated_it_is_the_maximum(context):
    scene = projected("attenuated-maximum", ramp(), integration={"attenuation": 0.0})
    assert kernel_hash(scene) == kernel_hash(projected("maximum", ramp()))


def test_what_is_not_finite_does_not_count(context):
    array = ramp()
    array[6:] = np.nan
    array[3, :, 12:] = np.inf
    for mode, value in (("maximum", 4.5), ("average", 2.5), ("minimum", 0.5)):
        rgba = picture(context, projected(mode, array)).rgba
        np.testing.assert_allclose(rgba, np.broadcast_to(shown(value), (4, 4, 4)), atol=2e-6)


@pytest.mark.parametrize("mode", MODES)
def test_a_ray_without_a_value_shows_nothing(context, mode):
    array = ramp()
    array[:, :, :8] = np.nan
    opaque = TransferFunction([0.0], [0.7], [[1.0, 1.0, 1.0]])
    camera = axis_camera((7.5, 7.5, 7.5), axis=2, height=32.0)
    found = picture(context, projected(mode, array, opaque, camera=camera, size=(32, 4)))
    seen = found.rgba[1, :, 3] > 0
    assert np.isinf(found.depth[1][~seen]).all() and np.all(found.rgba[1][~seen] == 0)
    assert 0 < seen.sum() < 16  # beside the volume, and behind what is not finite
    if mode != "attenuated-maximum":
        np.testing.assert_allclose(found.rgba[1][seen], 0.7, atol=1e-6)


@pytest.mark.parametrize("mode, value", [("maximum", 8.5), ("minimum", 2.5), ("average", 5.5)])
def test_clips_cut_what_counts(context, mode, value):
    planes = [{"point": [0, 0, 9], "normal": [0, 0, -1]}, {"point": [0, 0, 2], "normal": [0, 0, 1]}]
    rgba = picture(context, projected(mode, ramp(), clip=planes)).rgba
    np.testing.assert_allclose(rgba, np.broadcast_to(shown(value), (4, 4, 4)), atol=3e-6)


def test_a_ray_goes_on_behind_a_hole(context):
    hole = [{"type": "box", "lower": [0, 0, 4], "upper": [20, 20, 11], "keep": "outside"}]
    for mode, value in (("maximum", 14.5), ("average", (4 * 2 + 4 * 13) / 8)):
        rgba = picture(context, projected(mode, ramp(), clip=hole)).rgba
        np.testing.assert_allclose(rgba, np.broadcast_to(shown(value), (4, 4, 4)), atol=3e-6)


@pytest.mark.parametrize("mode", MODES)
def test_pictures_are_the_twins(context, mode):
    array = waves((15, 12, 13))
    camera = {"position": (25.0, 19.0, -14.0), "target": (6.0, 5.5, 7.0), "fov_degrees": 35.0}
    for filter in ("linear", "catmull-rom"):
        scene = projected(
            mode, array, SPREAD, camera=camera, size=(12, 10), integration={
                "filter": filter, "step": 0.7, "attenuation": 3.0}, clip=[
                {"type": "sphere", "center": (6, 5, 7), "radius": 6.0}],
            grid={"spacing": (1.0, 1.2, 0.8)},
        )  # fmt: skip
        found, expected = picture(context, scene).rgba, render_twin(scene)
        np.testing.assert_allclose(found, expected, atol=2e-4)
        assert expected[..., 3].max() > 0.1


@pytest.mark.parametrize("mode", ["maximum", "minimum", "attenuated-maximum"])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_leaping_changes_no_bit_and_takes_fewer_samples(context, mode, dtype):
    array = blobs(dtype) if mode != "minimum" else 255 - blobs(dtype)
    integration = {"step": 0.25, "attenuation": 30.0}
    scene = projected(
        mode, array, SPREAD, camera=PERSPECTIVE, size=(40, 32), integration=integration
    )
    leaping, every = (picture(context, scene, skip=skip) for skip in (True, False))
    assert np.array_equal(leaping.rgba, every.rgba)
    assert np.array_equal(leaping.depth, every.depth)
    assert every.rgba[..., 3].std() > 0.02
    assert leaping.samples < 0.7 * every.samples


def test_leaping_knows_filters_that_overshoot_and_holes(context):
    array = blobs()
    array[20:24, 10:50, 15:50] = np.nan
    for filter in ("nearest", "catmull-rom"):
        scene = projected(
            "maximum", array, SPREAD, camera=PERSPECTIVE, size=(40, 32),
            integration={"step": 0.5, "filter": filter},
        )  # fmt: skip
        leaping, every = (picture(context, scene, skip=skip) for skip in (True, False))
        assert np.array_equal(leaping.rgba, every.rgba) and leaping.samples < every.samples


def test_a_ray_ends_at_the_highest_value_of_all(context):
    array = np.zeros((64, 9, 9), np.uint8)
    array[8:10] = 255
    array[10:] = np.arange(9 * 9).reshape(9, 9) % 3
    found = picture(context, projected("maximum", array, SPREAD, integration={"step": 0.5}))
    assert found.samples <= 16 * 32  # of 126 on each ray
    np.testing.assert_allclose(found.depth, 40.0 - 31.5 + 8.25, rtol=1e-6)


@pytest.mark.parametrize("mode", MODES)
def test_lanes_agree(context, mode):
    scene = projected(
        mode, blobs(), SPREAD, camera=PERSPECTIVE, size=(20, 16), integration={"attenuation": 9.0}
    )
    one, sixteen = (picture(context, scene, lanes=lanes) for lanes in (1, 16))
    np.testing.assert_allclose(one.rgba, sixteen.rgba, atol=2e-5)


def test_opacity_is_the_functions_whatever_the_step(context):
    for step in (0.5, 2.0):
        scene = projected("maximum", np.full((9, 9, 9), 200, np.uint8), SPREAD,
                          integration={"step": step})  # fmt: skip
        alpha = float(SPREAD.opacity(200.0))
        np.testing.assert_allclose(picture(context, scene).rgba[..., 3], alpha, atol=1e-6)


def test_a_mean_that_no_cell_holds_is_seen(context):
    """Cells of 0 and of 255 alone: what is visible is between."""
    array = np.zeros((17, 9, 9), np.uint8)
    array[9:] = 255
    between = TransferFunction(
        [100.0, 110.0, 150.0, 160.0], [0.0, 0.5, 0.5, 0.0], [[1.0, 1.0, 1.0]] * 4
    )
    rgba = picture(context, projected("average", array, between)).rgba
    np.testing.assert_allclose(rgba[..., 3], 0.5, atol=1e-6)


def test_lights_surfaces_and_cues_change_nothing(device):
    tables = {
        "light": [{"type": "headlight"}], "isosurface": [{"value": 8.0}],
        "shadow": {"method": "rays"}, "depth_cue": {"color": [1.0, 1.0, 1.0]},
    }  # fmt: skip
    pictures = []
    for added in ({}, tables):
        with Renderer(projected("maximum", ramp(), **added), devices=[device]) as renderer:
            pictures.append(renderer.render().rgba)
    assert np.array_equal(*pictures)
