"""The method "pyramid" against its plain twin, and against itself where nothing may differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pyramid_scenes import (
    CAMERA,
    SHELL,
    pyramid_picture,
    pyramid_scene,
    rendered,
    twin_picture,
)
from reference.pyramid import _March
from small_scenes import axis_camera, picture, rms, waves

from clvol import Volume
from clvol.errors import RenderError
from clvol.integrators.pyramid.caster import PyramidCaster
from clvol.integrators.pyramid.oracles import names
from clvol.scene.clip import Clip

CLOSE = 3e-4  # the tables' interpolation
COUNTED = ("syntheses", "accumulations")


def check(caster, tolerance=CLOSE, clips=()) -> None:
    """The twin's picture, from as many segments."""
    data, twin = rendered(caster), twin_picture(caster, clips)
    difference = np.abs(data.rgba - twin.rgba).max(axis=-1)
    # Where a distance is just at a bound rounding decides, rarely.
    assert np.quantile(difference, 0.998) < tolerance and difference.max() < 0.05
    assert twin.rgba[..., 3].max() > 0.3
    counted = data.counters["accumulations"]
    assert abs(counted - twin.accumulations) <= 2 + 0.002 * counted


@pytest.mark.parametrize("oracle", names())
def test_every_oracles_picture_is_the_twins(context, oracle):
    check(PyramidCaster(context, pyramid_scene(oracle=oracle)))


@pytest.mark.parametrize("levels", (0, 1, 2, 4, 5))
def test_any_number_of_levels(context, levels):
    check(PyramidCaster(context, pyramid_scene(levels=levels, epsilon=0.03)))


@pytest.mark.parametrize(
    ("dtype", "low", "high"),
    [("int8", -100, 100), ("uint8", 0, 255), ("uint16", 0, 3000), ("float32", 0, 1e25), ("float64", 0, 1)],
)
def test_other_types(first_device, contexts, dtype, low, high):
    array = waves((40, 37, 45), dtype, low, high)
    at = low + np.array([0.0, 0.24, 0.55, 1.0]) * (float(high) - low)
    function = SHELL.__class__(at, [0.0, 0.02, 0.1, 0.3], [[0.2, 0.5, 0.9]] * 4)
    for oracle in ("error", "visible", "opacity-gradient", "bandwidth"):
        scene = pyramid_scene(array, function, oracle=oracle)
        check(PyramidCaster(contexts(first_device), scene))


@pytest.mark.parametrize("filter", ("cubic", "catmull-rom"))
def test_wide_filters(first_device, contexts, filter):
    scene = pyramid_scene(filter=filter, width=24, height=20)
    check(PyramidCaster(contexts(first_device), scene))


def test_views_between_rays_and_slices(context):
    """Parallel rays, rays much nearer than slices, much farther, and an eye inside the volume."""
    centre = (22.13, 18.29, 19.57)
    for camera, more in [
        (axis_camera(centre, axis=2, height=40.37), {}),
        (axis_camera(centre, axis=0, height=40.37), {"step": 1.83}),
        ({**CAMERA, "fov_degrees": 8.0}, {"step": 1.0}),
        ({**CAMERA, "fov_degrees": 60.0}, {"step": 0.3, "width": 17, "height": 13}),
        ({"position": centre, "target": (40.0, 20.0, 25.0), "fov_degrees": 70.0}, {}),
    ]:
        check(PyramidCaster(context, pyramid_scene(camera=camera, **more)))


def test_grids_that_are_not_cubes(context):
    grid = {"spacing": (0.7, 1.9, 1.1), "origin": (3.0, -20.0, 5.0)}
    array = waves((30, 21, 45))
    camera = {"position": (-70.0, -60.0, -50.0), "target": (18.0, 0.0, 21.0), "fov_degrees": 34.0}
    check(PyramidCaster(context, pyramid_scene(array, camera=camera, grid=grid)))


@pytest.mark.parametrize("shape", [(1, 30, 25), (25, 1, 1), (3, 2, 5)])
def test_thin_volumes(context, shape):
    array = waves((7, 30, 25))[: shape[0], : shape[1], : shape[2]]
    scene = pyramid_scene(Volume(array), camera=None, width=21, height=34, step=0.25)
    data, twin = (f(PyramidCaster(context, scene)) for f in (rendered, twin_picture))
    np.testing.assert_allclose(data.rgba, twin.rgba, atol=CLOSE)


def test_holes_stay_where_they_are(context):
    """A voxel that is not a number is seen by the samples that use it, and by no others."""
    array = waves((40, 37, 45))
    array[20, 18, 5:40:7] = np.nan
    array[5:9, 30, 10:13] = np.inf
    caster = PyramidCaster(context, pyramid_scene(array, epsilon=0.1))
    check(caster)
    data = rendered(caster)
    assert np.isfinite(data.rgba).all()
    full = pyramid_picture(context, pyramid_scene(array, oracle="minimum"))
    assert rms(data.rgba, full.rgba) < 0.01


def test_a_hole_is_the_same_in_a_packet_and_alone(first_device, contexts):
    """What follows a hole depends on no neighbour."""
    context = contexts(first_device)
    array = waves((40, 37, 45))
    array[::6, 18:21, ::5] = np.nan
    scene = pyramid_scene(array, oracle="minimum")
    packets, single = (
        pyramid_picture(context, scene, **how) for how in ({"lanes": 16}, {"lanes": 1, "workers": 16})
    )
    assert rms(packets.rgba, single.rgba) < 1e-5
    check(PyramidCaster(context, scene, lanes=1, workers=16))


def test_what_is_visible_by_overshoot_alone_is_seen(context):
    """No voxel shows, but what Catmull and Rom's filter makes of them does."""
    array = np.zeros((30, 30, 30), np.float32)
    array[10:20, 10:20, 10:20] = 100.0
    function = SHELL.__class__([0.0, 101.0, 103.0, 200.0], [0.0, 0.0, 0.5, 0.5], [[1.0, 0.8, 0.6]] * 4)
    camera = axis_camera((14.5, 14.5, 14.5), axis=2, height=32.0)
    for oracle in ("visible", "error"):
        asked = {"filter": "catmull-rom", "camera": camera, "oracle": oracle, "step": 0.5}
        scene = pyramid_scene(array, function, **asked)
        sleeping, awake = (pyramid_picture(context, scene, leap=leap) for leap in (True, False))
        assert rms(sleeping.rgba, awake.rgba) < 2e-5
        plain = replace(scene, integration=scene.integration.model_copy(update={"method": "raycast"}))
        shown = picture(context, plain)
        assert shown.rgba[..., 3].max() > 0.1 and rms(sleeping.rgba, shown.rgba) < 0.02


def test_rays_stop_where_they_are_opaque(context):
    dense = SHELL.__class__([0.0, 255.0], [0.0, 0.9], [[0.2, 0.5, 0.9]] * 2)
    scene = pyramid_scene(function=dense, early_termination=0.05)
    check(PyramidCaster(context, scene))
    stopped = pyramid_picture(context, scene)
    whole = pyramid_picture(context, pyramid_scene(function=dense))
    assert stopped.samples < whole.samples
    assert np.abs(stopped.rgba - whole.rgba).max() <= 0.05


# ---- clips ----

_PLANE = Clip(point=(20.0, 15.0, 18.0), normal=(1.0, 0.6, 0.3))
_BOX = Clip(type="box", lower=(5.0, 4.5, 6.0), upper=(33.3, 31.0, 28.0))


@pytest.mark.parametrize("clips", [(_PLANE,), (_BOX,), (_PLANE, _BOX)], ids=["plane", "box", "both"])
def test_clips_cut_rays_where_they_meet_them(context, clips):
    for more in ({}, {"camera": axis_camera((22.13, 18.29, 19.57), axis=1, height=40.37), "step": 1.3}):
        scene = pyramid_scene(clips=clips, **more)
        check(PyramidCaster(context, scene), clips=clips)
        plain = replace(scene, integration=scene.integration.model_copy(update={"method": "raycast"}))
        cut, whole = picture(context, plain).rgba, picture(context, replace(plain, clips=())).rgba
        shown = pyramid_picture(context, scene).rgba
        assert rms(shown, cut) < 0.01 < 0.3 * rms(whole, cut)


def test_clips_on_grids_that_are_turned_and_thin(context):
    turned = {"spacing": (0.7, 1.9, 1.1), "origin": (3.0, -20.0, 5.0), "direction": ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))}
    for array in (waves((30, 21, 45)), waves((30, 21, 1))):
        scene = pyramid_scene(array, camera=None, grid=turned, step=0.5)
        middle = scene.volume.grid.world_corners().mean(axis=0)
        clips = (Clip(point=tuple(middle), normal=(0.2, 1.0, -0.4)),)
        check(PyramidCaster(context, replace(scene, clips=clips)), clips=clips)


def test_a_moved_camera_is_clipped_as_well(context):
    scene = pyramid_scene(clips=(_PLANE,))
    caster = PyramidCaster(context, scene)
    other = caster.for_scene(replace(scene, camera=scene.camera.model_copy(update={"fov_degrees": 25.0})))
    check(other, clips=(_PLANE,))


# ---- what changes nothing ----


@pytest.mark.parametrize("size", [(40, 36), (67, 5), (33, 64), (1, 1), (8, 40)])
@pytest.mark.parametrize("function", ("smooth", "shell"))
def test_pictures_do_not_depend_on_tiles(context, size, function):
    more = {"function": SHELL} if function == "shell" else {}
    scene = pyramid_scene(width=size[0], height=size[1], **more)
    small = pyramid_picture(context, scene)
    large = pyramid_picture(context, scene, tile=64, volume=None)
    np.testing.assert_array_equal(small.rgba, large.rgba)
    np.testing.assert_array_equal(small.depth, large.depth)


@pytest.mark.parametrize("levels", (1, 3, 4))
@pytest.mark.parametrize("oracle", ("visible", "error"))
def test_columns_that_sleep_miss_nothing(context, levels, oracle):
    array = np.zeros((90, 30, 100), np.float32)
    array[10:14, 5:20, 80:90] = array[60:80, 12:15, 20:60] = 165.0
    camera = {"position": (-90.0, 20.0, -40.0), "target": (50.0, 15.0, 45.0), "fov_degrees": 40.0}
    scene = pyramid_scene(array, SHELL, camera=camera, levels=levels, oracle=oracle, width=64, height=48)
    sleeping = pyramid_picture(context, scene)
    awake = pyramid_picture(context, scene, leap=False)
    np.testing.assert_allclose(sleeping.rgba, awake.rgba, atol=2e-5)
    assert awake.rgba[..., 3].max() > 0.2
    assert sleeping.counters["accumulations"] <= awake.counters["accumulations"]
    if levels > 1:
        assert sleeping.counters["accumulations"] < 0.95 * awake.counters["accumulations"]


@pytest.mark.parametrize(
    "more", [{}, {"step": 1.7}, {"step": 0.2, "width": 12, "height": 9}, {"oracle": "minimum"}]
)
def test_values_that_are_not_sampled_are_not_missed(context, monkeypatch, more):
    """Coarse pixels from which nothing is synthesised."""
    caster = PyramidCaster(context, pyramid_scene(**more))
    few, data = twin_picture(caster), rendered(caster)
    monkeypatch.setattr(
        _March, "_needs_value", lambda self, level, k, spacing: np.ones(self.distance[level].shape, bool)
    )
    all_ = twin_picture(caster)
    np.testing.assert_array_equal(few.rgba, all_.rgba)
    assert few.samples < 0.95 * few.oracle_samples == 0.95 * all_.samples
    assert data.samples < 0.95 * data.counters["oracle_samples"]


def test_one_pixel_a_work_item_makes_the_same_picture(first_device, contexts):
    """What a GPU runs: work-items that share a tile, on any device."""
    context = contexts(first_device)
    for more in ({}, {"function": SHELL}, {"levels": 1, "camera": {**CAMERA, "fov_degrees": 9.0}}):
        scene = pyramid_scene(width=37, height=30, **more)
        packets, single = (
            pyramid_picture(context, scene, **how) for how in ({"lanes": 16}, {"lanes": 1, "workers": 16})
        )
        np.testing.assert_allclose(single.rgba, packets.rgba, atol=2e-5)
        assert single.samples == pytest.approx(packets.samples, rel=0.01)


def test_a_frame_is_the_same_each_time(context):
    caster = PyramidCaster(context, pyramid_scene())
    first, second = rendered(caster), rendered(caster)
    np.testing.assert_array_equal(first.rgba, second.rgba)
    assert first.samples == second.samples and first.counters == second.counters


def test_columns_of_wide_views_wake_in_time(context):
    """Rays grow apart while their column sleeps."""
    array = np.zeros((24, 200, 200), np.uint8)
    array[4:6, 3:60:7, 3:60:7] = array[10:12, 120:190:9, 130:190:9] = 165
    camera = {"position": (100.0, 100.0, -70.0), "target": (100.0, 100.0, 12.0), "fov_degrees": 100.0}
    scene = pyramid_scene(array, SHELL, camera=camera, levels=5, oracle="visible", width=64, height=64)
    sleeping, awake = (pyramid_picture(context, scene, leap=leap) for leap in (True, False))
    np.testing.assert_allclose(sleeping.rgba, awake.rgba, atol=2e-5)
    assert sleeping.counters["syntheses"] <= awake.counters["syntheses"]


def test_another_step_asks_the_oracle_anew(context):
    scene = pyramid_scene()
    for step in (4.0, 0.5):
        other = pyramid_scene(step=step)
        found = PyramidCaster(context, scene).for_scene(other)
        fresh = pyramid_picture(context, other)
        np.testing.assert_array_equal(rendered(found).rgba, fresh.rgba)


def test_colours_that_cycle_are_asked_about_as_they_are(context):
    scene = pyramid_scene(function=SHELL, step=0.4)
    animation = scene.animation.model_copy(update={"cycle": 0.5, "time": 0.0})
    scene = replace(scene, animation=animation)
    later = replace(scene, animation=animation.model_copy(update={"time": 0.7}))
    found = rendered(PyramidCaster(context, scene).for_scene(later))
    np.testing.assert_array_equal(found.rgba, pyramid_picture(context, later).rgba)
    plain = replace(later, integration=later.integration.model_copy(update={"method": "raycast"}))
    assert rms(found.rgba, picture(context, plain).rgba) < 0.01
    assert rms(found.rgba, pyramid_picture(context, scene).rgba) > 0.02


def test_more_slices_than_can_be_told_apart_are_an_error(context):
    caster = PyramidCaster(context, pyramid_scene(step=5e-6))
    with pytest.raises(RenderError, match="slices by the method 'pyramid'"):
        rendered(caster)
    far = {"position": (1e9, 0.0, 0.0), "target": (22.0, 18.0, 20.0), "fov_degrees": 1e-6}
    assert np.isfinite(pyramid_picture(context, pyramid_scene(camera=far)).rgba).all()


def test_a_camera_move_compiles_nothing(first_device, contexts):
    context = contexts(first_device)
    scene = pyramid_scene(height=30)
    caster = PyramidCaster(context, scene)
    caster.warm_up(40, 30)
    before = context.compile_seconds, len(context._programs)
    for fov in (5.0, 36.0, 90.0):  # some of them with levels more across
        camera = scene.camera.model_copy(update={"fov_degrees": fov})
        caster.render(camera, 40, 30)
    assert (context.compile_seconds, len(context._programs)) == before
