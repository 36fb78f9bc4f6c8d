"""Iso-surfaces by the method "pyramid": against its twin, and the ray caster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.pyramid_scenes import CAMERA, rendered, twin_picture
from helpers.small_scenes import SMOOTH, picture, rms, waves

from clvol import Scene, TransferFunction, Volume
from clvol.device.brick_pool import ReadBricks
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.features import reduced_for_frames
from clvol.integrators.pyramid.bricks import BrickPyramidCaster
from clvol.integrators.pyramid.caster import PyramidCaster
from clvol.integrators.raycast.bricks import BrickVolume
from clvol.integrators.registry import check_scene
from clvol.store.volume_blocks import VolumeBlocks

CLEAR = TransferFunction([0.0, 255.0], [0.0, 0.0], [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
FOG = TransferFunction(
    [0.0, 90.0, 100.0, 255.0], [0.0, 0.0, 0.2, 0.3],
    [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.2, 0.5, 1.0], [1.0, 0.2, 0.2]],
)  # fmt: skip
SUN = {"type": "directional", "direction": (0.5, 0.6, 1.0)}
PLANE = {"point": (20.0, 15.0, 18.0), "normal": (1.0, 0.6, 0.3)}
THIN = {"value": 140.0, "color": [0.9, 0.3, 0.2], "back_color": [0.2, 0.4, 0.9], "opacity": 0.6}
SOLID = {"value": 170.0, "color": [0.3, 0.9, 0.2]}
ALONG_Z = {"projection": "orthographic"}
BALL_CAMERA = {"position": (-70.0, -50.0, -90.0), "target": (32.0, 32.0, 32.0), "fov_degrees": 36.0}


def scene(array=None, function=SMOOTH, size=(40, 36), camera=CAMERA, **tables):
    integration = {
        "classification": "preintegrated", "step": 0.7, "method": "pyramid", "early_termination": 0.0,
        "step_error": 0.0, **tables.pop("integration", {}),
    }  # fmt: skip
    array = waves((40, 37, 45), np.uint8) if array is None else array
    return Scene(
        volume=array if isinstance(array, Volume) else Volume(array), transfer_function=function, camera=camera,
        image={"width": size[0], "height": size[1]}, integration=integration, **tables,
    ).resolve()  # fmt: skip


def ball() -> np.ndarray:
    """uint8 [64, 64, 64]: 200 in a middle, and 8 less a voxel away from it."""
    z, y, x = np.mgrid[:64, :64, :64]
    return np.clip(200.0 - 8.0 * np.sqrt((x - 20.0) ** 2 + (y - 32) ** 2 + (z - 32) ** 2), 0, 255).astype(np.uint8)


def cast(context, resolved, **integration):
    """The ray caster's ``FrameData``."""
    changed = resolved.integration.model_copy(update={"method": "raycast", **integration})
    return picture(context, replace(resolved, integration=changed))


def assert_same_depths(found, wanted, atol=2e-4) -> None:
    np.testing.assert_array_equal(np.isfinite(found.depth), np.isfinite(wanted.depth))
    there = np.isfinite(wanted.depth)
    assert there.any()
    np.testing.assert_allclose(found.depth[there], wanted.depth[there], atol=atol)


TABLES = {
    "lit": {"light": [SUN], "isosurface": [THIN, SOLID]},
    "unlit": {"isosurface": [THIN]},
    "cut and cued": {
        "light": [SUN], "clip": [PLANE], "isosurface": [THIN, SOLID], "depth_cue": {"start": 60.0, "end": 110.0},
    },
    "cubic": {"light": [SUN], "isosurface": [THIN], "integration": {"filter": "cubic"}},
    "by gradients": {
        "light": [SUN], "isosurface": [THIN],
        "gradient_opacity": {"points": [{"magnitude": 0, "opacity": 0}, {"magnitude": 8, "opacity": 1}]},
    },
}  # fmt: skip


@pytest.mark.parametrize(
    "name", ["lit", *(pytest.param(name, marks=pytest.mark.slow) for name in TABLES if name != "lit")]
)
def test_the_picture_is_the_twins(context, name):
    resolved = scene(size=(28, 25), **TABLES[name])
    caster = PyramidCaster(context, resolved)
    data, twin = rendered(caster), twin_picture(caster, reduced_for_frames(resolved).clips)
    difference = np.abs(data.rgba - twin.rgba).max(axis=-1)
    # A ray that just touches a cell's face may take another way round it in float32.
    assert np.quantile(difference, 0.99) < 5e-6 and difference.max() < 1e-3
    assert data.counters["accumulations"] == twin.accumulations
    assert data.samples - data.counters["surface_tests"] <= twin.samples  # columns sleep
    assert 0 < data.counters["surface_hits"] <= 2 * 2 * 28 * 25


@pytest.mark.parametrize("tables", [{}, pytest.param({"clip": [PLANE]}, marks=pytest.mark.slow)])
def test_surfaces_alone_are_the_ray_casters(context, tables):
    """Nothing needs samples: the same rays look into the same cells, and show the same bits where nothing cuts them."""
    asked = scene(function=CLEAR, isosurface=[THIN, SOLID], light=[SUN], **tables)
    shown, wanted = rendered(PyramidCaster(context, asked)), cast(context, asked)
    np.testing.assert_allclose(shown.rgba, wanted.rgba, rtol=0, atol=2e-6 if tables else 0)
    assert_same_depths(shown, wanted)
    assert shown.counters["surface_hits"] == wanted.counters["surface_hits"] > 100
    if not tables:
        assert shown.counters["surface_tests"] == wanted.counters["surface_tests"] == shown.samples
    assert shown.counters["accumulations"] == shown.counters["syntheses"] == shown.counters["oracle_samples"] == 0


@pytest.mark.parametrize("lights", [[SUN], pytest.param([], marks=pytest.mark.slow)])
def test_full_levels_are_the_ray_casters_where_samples_are_the_same(context, lights):
    """In views along an axis, with whole steps, slices are where the ray caster has its samples."""
    camera = {**ALONG_Z, "position": (22.0, 18.0, -30.0), "target": (22.0, 18.0, 20.0), "height": 45.0}
    asked = scene(
        camera=camera, isosurface=[THIN], light=lights, pyramid={"oracle": "minimum"}, integration={"step": 1.0}
    )  # fmt: skip
    shown, wanted = rendered(PyramidCaster(context, asked)), cast(context, asked)
    np.testing.assert_allclose(shown.rgba, wanted.rgba, atol=2e-6)
    assert_same_depths(shown, wanted)
    assert shown.samples == wanted.samples
    assert shown.counters["surface_hits"] == wanted.counters["surface_hits"] > 100
    assert rms(shown.rgba, cast(context, replace(asked, isosurfaces=())).rgba) > 0.02


def test_full_levels_converge_to_the_ray_caster_elsewhere(context):
    errors = []
    for step in (0.7, 0.2):
        asked = scene(
            isosurface=[THIN], light=[SUN], pyramid={"oracle": "minimum"}, integration={"step": step}, size=(28, 25)
        )  # fmt: skip
        errors.append(rms(rendered(PyramidCaster(context, asked)).rgba, cast(context, asked).rgba))
    assert errors[0] < 2e-3 and errors[1] < 0.5 * errors[0]


@pytest.mark.slow  # programs
@pytest.mark.parametrize("oracle", ["error", "visible", "bandwidth", "opacity-gradient"])
def test_every_oracle_finds_surfaces_in_fog_and_in_empty_space(context, oracle):
    """Columns sleep where one of the surfaces is; segments are long where the other one is."""
    surfaces = [{"value": 40.0, "opacity": 0.3}, {"value": 120.0, "opacity": 0.5}]
    asked = scene(
        ball(), FOG, camera=BALL_CAMERA, isosurface=surfaces, light=[SUN], size=(80, 72),
        pyramid={"oracle": oracle, "levels": 2, "epsilon": 0.01},
    )  # fmt: skip
    shown, wanted = rendered(PyramidCaster(context, asked)), cast(context, asked, step=0.1)
    assert np.abs(shown.rgba - wanted.rgba).max() < 0.01
    assert_same_depths(shown, wanted, atol=0.1)  # steps are 0.7
    assert shown.counters["surface_hits"] == wanted.counters["surface_hits"] > 200
    awake = rendered(PyramidCaster(context, asked, leap=False))
    np.testing.assert_array_equal(shown.rgba, awake.rgba)
    np.testing.assert_array_equal(shown.depth, awake.depth)
    assert shown.counters["surface_hits"] == awake.counters["surface_hits"]
    assert shown.counters["syntheses"] < awake.counters["syntheses"]


def test_a_segment_that_meets_a_surface_is_sampled_at_every_step(context):
    """Values rise evenly and so does opacity: no oracle needs any sample; the surface lies where it lies."""
    array = np.broadcast_to(4 * np.arange(48, dtype=np.uint8)[:, None, None], (48, 24, 24)).copy()
    function = TransferFunction([0.0, 200.0], [0.0, 0.3], [[0.1, 0.3, 1.0], [1.0, 0.3, 0.1]])
    camera = {**ALONG_Z, "position": (12.0, 12.0, -40.0), "target": (12.0, 12.0, 0.0), "height": 20.0}
    surface = {"value": 101.0, "color": [1.0, 1.0, 1.0], "opacity": 0.5}
    asked = scene(
        array, function, camera=camera, isosurface=[surface], light=[SUN], integration={"step": 1.0},
        pyramid={"levels": 4, "epsilon": 0.02},
    )  # fmt: skip
    shown, wanted = rendered(PyramidCaster(context, asked)), cast(context, asked)
    assert rms(shown.rgba, wanted.rgba) < 2e-3 < 0.01 * wanted.rgba[..., 3].max()
    assert_same_depths(shown, wanted, atol=0.1)
    counted = shown.counters
    hits = counted["surface_hits"]
    assert hits == 40 * 36 == wanted.counters["surface_hits"]
    # One segment of each ray is 16 of a step, each with a gradient, and the surface has one.
    assert counted["gradients"] == counted["accumulations"] + (16 - 1 + 1) * hits
    assert counted["accumulations"] < 10 * hits


@pytest.mark.slow  # programs of one pixel a work-item
def test_lanes_and_tiles_do_not_show(context):
    asked = scene(isosurface=[THIN], light=[SUN], size=(37, 35))
    packets, single, large = (
        rendered(PyramidCaster(context, asked, **how))
        for how in ({"lanes": 16}, {"lanes": 1, "workers": 16}, {"lanes": 16, "tile": 64})
    )
    np.testing.assert_allclose(single.rgba, packets.rgba, atol=3e-6)
    assert single.counters == packets.counters and single.samples == packets.samples
    np.testing.assert_array_equal(large.rgba, packets.rgba)
    np.testing.assert_array_equal(large.depth, packets.depth)


@pytest.mark.slow
@pytest.mark.parametrize("function", [CLEAR, SMOOTH])
def test_holes_float64_and_big_endian(context, function):
    array = waves((40, 37, 45)).astype(">f8")
    array[10:14, 10:12, 20], array[30, 3, 5] = np.nan, np.inf
    integration = {"step": 0.2}
    asked = scene(
        array, function, isosurface=[THIN], light=[SUN], pyramid={"oracle": "minimum"}, integration=integration,
        size=(21, 18),
    )  # fmt: skip
    shown, wanted = rendered(PyramidCaster(context, asked)), cast(context, asked)
    assert np.isfinite(shown.rgba).all()
    assert rms(shown.rgba, wanted.rgba) < 5e-4
    assert shown.counters["surface_hits"] == wanted.counters["surface_hits"] > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("array", "camera"),
    [
        (waves((7, 30, 25))[:1].copy(), None),
        (None, {"position": (22.0, 18.0, 20.0), "target": (30.0, 18.0, 40.0), "fov_degrees": 60.0}),
    ],
)
def test_thin_volumes_and_an_eye_inside(context, array, camera):
    tables = {"isosurface": [THIN], "light": [SUN], "camera": camera, "size": (21, 18)}
    alone = scene(array, CLEAR, **tables)
    shown, wanted = rendered(PyramidCaster(context, alone)), cast(context, alone)
    np.testing.assert_array_equal(shown.rgba, wanted.rgba)
    fine = scene(array, integration={"step": 0.2}, pyramid={"oracle": "minimum"}, **tables)
    assert rms(rendered(PyramidCaster(context, fine)).rgba, cast(context, fine).rgba) < 2e-3


@pytest.mark.slow
def test_shadows_of_a_light_volume_are_the_ray_casters(context):
    tables = {"isosurface": [SOLID], "light": [SUN], "shadow": {"method": "volume", "resolution": 32}}
    alone = scene(function=CLEAR, **tables)
    np.testing.assert_array_equal(rendered(PyramidCaster(context, alone)).rgba, cast(context, alone).rgba)
    asked = scene(pyramid={"oracle": "minimum"}, integration={"step": 0.3}, **tables)
    caster = PyramidCaster(context, asked)
    assert rms(rendered(caster).rgba, cast(context, asked).rgba) < 1.5e-3
    moved = caster.for_scene(replace(asked, integration=asked.integration.model_copy(update={"step": 0.6})))
    np.testing.assert_array_equal(rendered(moved).rgba, rendered(PyramidCaster(context, moved.resolved)).rgba)


@pytest.mark.slow
def test_bricks_show_the_same_bits(context):
    asked = scene(isosurface=[THIN], light=[SUN], gradient={"storage": "on-the-fly"})
    bricks = BrickVolume(context, ReadBricks(context, VolumeBlocks(asked.volume, 8)), 1 << 26)
    shown, plain = rendered(BrickPyramidCaster(context, asked, bricks)), rendered(PyramidCaster(context, asked))
    np.testing.assert_allclose(shown.rgba, plain.rgba, atol=2e-6)
    assert shown.counters["surface_hits"] == plain.counters["surface_hits"] > 0


def test_surfaces_without_consequence_change_no_program():
    plain = scene()
    for unused in ({**THIN, "opacity": 0.0}, {**THIN, "value": 999.0}):
        assert kernel_hash(scene(isosurface=[unused])) == kernel_hash(plain)
    assert kernel_hash(scene(isosurface=[THIN])) != kernel_hash(plain)


def test_what_is_done_is_explained():
    def reason(function):
        listed = explain(scene(function=function, isosurface=[THIN]))["effects"]
        return next(effect["reason"] for effect in listed if effect["name"] == "isosurfaces")

    looks = "1 iso-value inside the data's range; each pixel's ray looks for them"
    assert reason(CLEAR) == looks
    assert reason(SMOOTH) == f"{looks}; where it meets one it is sampled at every step"


@pytest.mark.parametrize(
    ("tables", "what"),
    [
        ({"isosurface": [{**THIN, "refraction": 1.3}]}, "refraction"),
        ({"isosurface": [THIN], "noise": [{"target": "value", "amplitude": 3.0}]}, "noise"),
        ({"isosurface": [THIN], "ambient_occlusion": {}}, "ambient occlusion"),
    ],
)
def test_what_surfaces_do_not_take_is_refused_by_name(tables, what):
    with pytest.raises(SceneError, match=f"integration.method: got 'pyramid' in a scene that calls for {what}"):
        check_scene(scene(**tables))
    check_scene(scene(isosurface=[THIN]))
