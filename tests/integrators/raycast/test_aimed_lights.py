"""Spot lights and projected images: the kernels against the plain twin, and cases with a known picture."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import HAZE, MATERIAL, blobs, oblique, picture, scene, twin

from clvol import Renderer, Scene, TransferFunction, Volume
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.features import called_for, reduced
from clvol.schedule.keyframes import scene_at

ROUNDING = 3e-5  # as in test_effects_lighting.py
SHAPE = (15, 17, 19)
LIT = {"material": MATERIAL, "gradient": {"storage": "on-the-fly"}, "camera": oblique(SHAPE)}
ABOVE = {"position": [9.0, 30.0, 3.0], "direction": [0.1, -1.0, 0.2]}
SPOT = {"type": "spot", **ABOVE, "cone_degrees": 25.0, "penumbra": 0.6, "color": [1.0, 0.8, 0.5]}
CLAY = TransferFunction([0.0], [0.25], [[0.8, 0.5, 0.2]])


def write_picture(path, rgb):
    import OpenEXR

    channels = {name: np.ascontiguousarray(rgb[..., k], np.float32) for k, name in enumerate("RGB")}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))
    return str(path)


@pytest.fixture(scope="module")
def slide(tmp_path_factory):
    """Colours that change everywhere, dark at the border: there is no edge for float32 to miss."""
    y, x = np.meshgrid(np.linspace(-1, 1, 12), np.linspace(-1, 1, 20), indexing="ij")
    dark = (1 - x**2) * (1 - y**2)
    rgb = np.stack([dark, dark * (0.6 + 0.4 * x), dark * (0.5 - 0.5 * y)], axis=-1) * 1.5
    return write_picture(tmp_path_factory.mktemp("slides") / "slide.exr", rgb)


def image_light(file, **keys):
    return {"type": "image", **ABOVE, "up": [0.2, 0.1, -1.0], "fov_degrees": 40.0, "file": file, **keys}


def check(context, resolved, limit=ROUNDING):
    found, expected = picture(context, resolved).rgba, twin(resolved)
    assert expected[..., 3].max() > 0.1
    np.testing.assert_allclose(found, expected, rtol=0, atol=limit)
    return found


SPOTS = {
    "a spot": SPOT,
    "hardly any cone": {**SPOT, "cone_degrees": 0.01, "penumbra": 1.0},
    "a wide cone": {**SPOT, "cone_degrees": 140.0, "penumbra": 1.0},
    "all around, fading": {**SPOT, "cone_degrees": 180.0, "penumbra": 1.0},
    "in the volume": {**SPOT, "position": [9.1, 8.2, 7.3], "cone_degrees": 60.0},
    "far away": {**SPOT, "position": [1e14, 1e14, 0.0], "direction": [-1.0, -1.0, 0.1], "penumbra": 1.0},
}


@pytest.mark.parametrize("case", SPOTS)
def test_pictures_with_spots_are_the_twins(context, case):
    check(context, scene(blobs(SHAPE), light=[SPOTS[case], {"type": "headlight", "intensity": 0.2}], **LIT))


@pytest.mark.parametrize("case", ["an image", "in the volume", *(
    pytest.param(f"beside a spot, with shadows{how}", marks=pytest.mark.slow) for how in ("", " of volumes")
)])  # programs with shadows take long to compile
def test_pictures_with_projected_images_are_the_twins(context, slide, case):
    more = {"position": [9.1, 8.2, 7.3], "fov_degrees": 120.0} if case == "in the volume" else {}
    tables = {"light": [image_light(slide, **more)]}
    if "shadows" in case:
        tables = {"light": [*tables["light"], SPOT], "shadow": {"method": "rays", "bound": 0.0}}
    if "volumes" in case:
        tables["shadow"] = {"resolution": 12}
    check(context, scene(blobs(SHAPE), **tables, **LIT))


def wall(context, light):
    """What of ``light`` arrives at a ramp along z, float32 [64, 64, 3], as seen along z. (Switches are those of
    ``LIT``: one program.)"""
    ramp = np.broadcast_to(np.linspace(0.0, 1.0, 9, dtype=np.float32)[:, None, None], (9, 33, 33)).copy()
    camera = {"projection": "orthographic", "position": [16.0, 16.0, -9.0], "target": [16.0, 16.0, 8.0],
              "up": [0.0, 1.0, 0.0], "height": 32.0}  # fmt: skip
    material = {"ambient": 0.0, "diffuse": 1.0, "specular": 1e-9}
    white = TransferFunction(HAZE.values, [0.3, 0.31, 0.3, 0.31], np.ones((4, 3)))
    resolved = scene(ramp, white, size=(64, 64), light=[light], **{**LIT, "material": material, "camera": camera})
    rgba = picture(context, resolved).rgba
    return rgba[..., :3] / rgba[..., 3:]


BEFORE_WALL = {"position": [16.0, 16.0, -1e4], "direction": [0.0, 0.0, 1.0]}


def test_a_slide_is_upright_and_not_mirrored_to_who_looks_along_it(context, tmp_path):
    """Two by two texels: red, green / blue, white; its picture is as seen from the projector."""
    rgb = np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 1, 1]]], float)
    height = 2 * np.degrees(np.arctan(16.0 / 1e4))
    light = {"type": "image", **BEFORE_WALL, "up": [0.0, 1.0, 0.0], "file": write_picture(tmp_path / "a.exr", rgb),
             "fov_degrees": height}  # fmt: skip
    found = wall(context, light)
    for row in range(2):
        for column in range(2):
            corner = found[8 + 48 * row, 8 + 48 * column]
            np.testing.assert_allclose(corner, rgb[row, column], atol=1e-3)


def test_one_texel_is_a_rectangle_of_one_colour(context, tmp_path):
    path = write_picture(tmp_path / "one.exr", np.full((1, 1, 3), [0.5, 1.0, 0.25]))
    light = {"type": "image", **BEFORE_WALL, "file": path, "fov_degrees": 2 * np.degrees(np.arctan(8.0 / 1e4))}
    found = wall(context, light)
    inner, outer = found[20:44, 20:44], np.concatenate([found[:14].reshape(-1, 3), found[:, :14].reshape(-1, 3)])
    np.testing.assert_allclose(inner, np.broadcast_to([0.5, 1.0, 0.25], inner.shape), atol=1e-3)
    assert outer.max() < 1e-6


def test_a_hard_cone_is_a_disc(context):
    light = {"type": "spot", **BEFORE_WALL, "cone_degrees": np.degrees(np.arctan(10.0 / 1e4)), "penumbra": 0.0}
    found = wall(context, light)[..., 0]
    y, x = np.meshgrid((np.arange(64) - 31.5) / 2, (np.arange(64) - 31.5) / 2, indexing="ij")
    away = np.hypot(x, y)
    assert (found[away < 9.9] > 0.999).all() and found[away > 10.1].max() < 1e-6


def test_a_cone_of_180_degrees_is_a_point_light_and_one_of_0_is_none(context):
    around = scene(blobs(SHAPE), light=[{**SPOT, "cone_degrees": 180.0, "penumbra": 0.0}], **LIT)
    point = scene(blobs(SHAPE), light=[{k: SPOT[k] for k in ("position", "color")} | {"type": "point"}], **LIT)
    assert kernel_hash(around) == kernel_hash(point)
    assert np.array_equal(picture(context, around).rgba, picture(context, point).rgba)
    told = {e["name"]: e for e in explain(around)["effects"]}["spot lights"]
    assert not told["called_for"] and "all directions" in told["reason"]
    closed = scene(blobs(SHAPE), light=[{**SPOT, "cone_degrees": 0.0}], **LIT)
    assert called_for(closed) == ["emission-absorption"] and reduced(closed).lights == ()
    assert "a spot whose cone is 0" in {e["name"]: e for e in explain(closed)["effects"]}["lighting"]["reason"]


def test_unused_aimed_lights_compile_nothing(slide):
    sun = {"type": "directional", "direction": [0.0, -1.0, 0.0]}
    plain = scene(blobs(SHAPE), light=[sun], **LIT)
    for idle in ({**SPOT, "intensity": 0.0}, {**SPOT, "cone_degrees": 0.0}, image_light(slide, color=[0, 0, 0])):
        assert kernel_hash(scene(blobs(SHAPE), light=[sun, idle], **LIT)) == kernel_hash(plain)
    used = scene(blobs(SHAPE), light=[sun, SPOT, image_light(slide)], **LIT)
    assert kernel_hash(used) != kernel_hash(plain)
    assert {"spot lights", "image lights"} <= set(called_for(used))


@pytest.mark.slow  # compiles a program with shadows
def test_samples_that_no_cone_reaches_cast_no_shadow_rays(context):
    """Shadow rays of a spot are those of samples in its cone."""
    def rays(light):
        resolved = scene(blobs(SHAPE), light=[light], shadow={"method": "rays", "bound": 0.0}, **LIT)
        return picture(context, resolved).counters["shadow_rays"]

    point = rays({"type": "point", "position": ABOVE["position"]})
    assert 0 < rays({**SPOT, "cone_degrees": 5.0}) < 0.5 * point
    assert rays({**SPOT, "cone_degrees": 180.0}) == point


@pytest.mark.parametrize("bad", [
    ({"type": "spot", "position": [0, 0, 0]}, "light.0.direction"),
    ({"type": "spot", "direction": [0, 0, 1]}, "light.0.position"),
    ({**SPOT, "cone_degrees": 181.0}, "light.0.cone_degrees"),
    ({**SPOT, "penumbra": 1.5}, "light.0.penumbra"),
    ({"type": "point", "position": [0, 0, 0], "cone_degrees": 3.0}, "light.0.cone_degrees"),
    ({**SPOT, "file": "a.exr"}, "light.0.file"),
    ({"type": "image", **ABOVE}, "light.0.file"),
    ({"type": "image", **ABOVE, "file": "a.exr", "up": [-0.1, 1.0, -0.2]}, "light.0.up"),
    ({"type": "image", **ABOVE, "file": "a.exr", "up": [0, 0, 0]}, "light.0.up"),
    ({"type": "image", **ABOVE, "file": "no.exr"}, "light.0.file: got 'no.exr', no such file"),
    ({"type": "image", **ABOVE, "file": "a.toml"}, "light.0.file"),
])  # fmt: skip
def test_what_is_no_light_is_refused(bad):
    light, where = bad
    with pytest.raises(SceneError, match=where):
        Scene(volume=Volume(blobs(SHAPE)), transfer_function=CLAY, light=[light]).resolve()


@pytest.mark.parametrize("texel", [np.nan, np.inf, -0.5])
def test_texels_that_are_no_light_are_refused(device, tmp_path, texel):
    rgb = np.ones((3, 4, 3))
    rgb[1, 2, 0] = texel
    resolved = scene(blobs(SHAPE), light=[image_light(write_picture(tmp_path / "bad.exr", rgb))], **LIT)
    with pytest.raises(SceneError, match="1 of 12 texels"):
        explain(resolved)
    with pytest.raises(SceneError, match="1 of 12 texels"):
        Renderer(resolved, devices=[device])


@pytest.mark.slow  # compiles a program for each device
def test_every_device_shows_the_same_aimed_light(contexts, each_device, slide):
    resolved = scene(blobs(SHAPE), light=[SPOT, image_light(slide)], **LIT)
    check(contexts(each_device), resolved)


@pytest.mark.slow  # compiles a program of its own
def test_aimed_lights_are_moved_by_keyframes(device):
    frames = [{"time": float(t), "set": {"light.0.cone_degrees": 10.0 + 20.0 * t}} for t in range(2)]
    given = Scene(volume=Volume(blobs(SHAPE)), transfer_function=CLAY, light=[SPOT], material=LIT["material"],
                  camera=LIT["camera"], image={"width": 20, "height": 16}, animation={"keyframe": frames})  # fmt: skip
    wide = given.model_copy(update={"light": [{**SPOT, "cone_degrees": 30.0}], "animation": {}})
    with Renderer(scene_at(given, 1.0), devices=[device]) as renderer:
        found = renderer.render().rgba
    with Renderer(wide, devices=[device]) as renderer:
        np.testing.assert_array_equal(found, renderer.render().rgba)
