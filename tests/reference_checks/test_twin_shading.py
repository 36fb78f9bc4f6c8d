"""The twin's lighting: Blinn-Phong and environments, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.twin_scenes import absorbed, along_z, constant_function, ramp, ray, scene
from reference.environment import EnvironmentMap, cube_texels, latlong_texels

from clvol import TransferFunction

COLOR = np.array([0.8, 0.5, 0.2])
OPACITY = absorbed(0.1, 15.0)
MATERIAL = {"ambient": 0.15, "diffuse": 0.6, "specular": 0.0, "shininess": 12.0}
BLOCK = np.zeros((16, 16, 16))


def from_angle(degrees, **keys):
    """A light whose direction is that far from the normal of a ramp along z, seen along z."""
    a = np.radians(degrees)
    return {"type": "directional", "direction": [np.sin(a), 0.0, np.cos(a)], **keys}


def lit_color(resolved, **how):
    """What the ray's premultiplied colour is a multiple of: all samples are lit alike."""
    rgba = along_z(resolved, **how)
    assert rgba[3] == pytest.approx(OPACITY)
    return rgba[:3] / rgba[3]


@pytest.mark.parametrize("classification", ["pre", "post", "preintegrated"])
@pytest.mark.parametrize("slope", [3.0, -3.0])
def test_lambert_on_a_ramp(classification, slope):
    light = from_angle(35.0, color=[1.0, 0.5, 0.25], intensity=1.5)
    s = scene(ramp(slope), light=[light], material=MATERIAL,
              integration={"classification": classification})  # fmt: skip
    arriving = 1.5 * np.array([1, 0.5, 0.25]) * np.cos(np.radians(35))
    assert lit_color(s) == pytest.approx(COLOR * (0.15 + 0.6 * arriving), abs=1e-9)


@pytest.mark.parametrize("filter", ["nearest", "cubic", "catmull-rom"])
def test_every_filter_lights_a_ramp_alike(filter):
    s = scene(ramp(3.0), light=[from_angle(35.0)], material=MATERIAL,
              integration={"filter": filter})  # fmt: skip
    inner = along_z(s, start=2.0)[:3] - (1 - absorbed(0.1, 11.0)) * along_z(s, start=13.0)[:3]
    expected = COLOR * (0.15 + 0.6 * np.cos(np.radians(35))) * absorbed(0.1, 11.0)
    assert inner == pytest.approx(expected, abs=1e-9)


def test_lights_add_up_and_those_behind_do_not():
    lights = [from_angle(0), from_angle(60), from_angle(120)]
    s = scene(ramp(), light=lights, material=MATERIAL)
    assert lit_color(s) == pytest.approx(COLOR * (0.15 + 0.6 * 1.5))


def test_black_lights_light_nothing():
    s = scene(ramp(), light=[from_angle(0, intensity=0.0)], material=MATERIAL)
    assert lit_color(s) == pytest.approx(COLOR)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 50.0, 89.0])
def test_the_highlight_falls_with_half_the_lights_angle(degrees):
    material = {**MATERIAL, "ambient": 0.0, "diffuse": 0.0, "specular": 0.4}
    s = scene(ramp(), light=[from_angle(degrees)], material=material)
    expected = 0.4 * np.cos(np.radians(degrees / 2)) ** 12
    assert lit_color(s) == pytest.approx(np.full(3, expected))


def test_headlights_shine_from_the_eye_and_point_lights_from_their_place():
    material = {**MATERIAL, "specular": 0.2}
    s = scene(ramp(), light=[{"type": "headlight"}], material=material)
    found = ray(s, (1.0, 7.0, -2.0), (3, 0, 4))
    expected = COLOR * (0.15 + 0.6 * 0.8) + 0.2 * 0.8**12
    assert found[:3] / found[3] == pytest.approx(expected)
    s = scene(ramp(), light=[{"type": "point", "position": [0, 6, -1e7]}], material=MATERIAL)
    assert lit_color(s) == pytest.approx(COLOR * 0.75, abs=1e-5)
    near = scene(ramp(), constant_function(1.0), material=MATERIAL,
                 light=[{"type": "point", "position": [10.3, 6.1, -3.5]}])  # fmt: skip
    found = along_z(near, step=1.0)[:3]  # lit at z = 0.5: 3 away, 4 before
    assert found == pytest.approx(COLOR * (0.15 + 0.6 * 0.8))


def test_a_back_face_gets_ambient_light_alone():
    for slope, lit in ((1.0, True), (-1.0, False)):
        for two_sided in (True, False):
            s = scene(ramp(slope), light=[from_angle(0)],
                      material={**MATERIAL, "two_sided": two_sided})  # fmt: skip
            share = 0.75 if lit or two_sided else 0.15
            assert lit_color(s) == pytest.approx(COLOR * share)


def test_small_gradients_fade_to_the_unshaded_colour():
    s = scene(ramp(0.5), light=[from_angle(0)], material={**MATERIAL, "fade": 2.0})
    assert lit_color(s) == pytest.approx(COLOR * (0.75 + 0.25 * 0.75))


def test_without_a_gradient_colours_stay_unshaded():
    s = scene(BLOCK, light=[from_angle(0)], material=MATERIAL)
    assert lit_color(s) == pytest.approx(COLOR)


def test_cut_faces_have_the_clips_normal_for_one_edge():
    clip = {"point": [0, 0, 4.0], "normal": [0, 0, 1]}
    wall = constant_function(1.0)
    s = scene(BLOCK, wall, light=[from_angle(40)], material=MATERIAL, clip=[clip])
    lit = COLOR * (0.15 + 0.6 * np.cos(np.radians(40)))
    assert along_z(s, step=1e-6)[:3] == pytest.approx(lit, abs=1e-5)
    assert along_z(s, step=0.5)[:3] == pytest.approx(lit)
    assert along_z(s, step=2.0)[:3] == pytest.approx(COLOR)


def test_a_cut_face_goes_over_to_the_gradients_normal():
    clip = {"type": "sphere", "center": [7.3, 6.1, 8], "radius": 4.0}
    array = ramp(-1.0, axis=2)  # normals along x
    s = scene(array, constant_function(1.0), light=[{**from_angle(90), "direction": [-1, 0, 1]}],
              material=MATERIAL, clip=[clip])  # fmt: skip
    at_cut, beyond = along_z(s, step=1e-6)[:3], along_z(s, step=2.5)[:3]
    assert at_cut == pytest.approx(COLOR * (0.15 + 0.6 * np.sqrt(0.5)), abs=1e-5)
    assert beyond == pytest.approx(COLOR * (0.15 + 0.6 * np.sqrt(0.5)))
    middle = along_z(s, step=1.0)[:3]  # normals (1, 0, 0) and (0, 0, -1) in equal parts
    assert middle == pytest.approx(COLOR * 0.75)


# --- environments


def latlong(radiance, rows=96):
    directions, _ = latlong_texels((rows, 2 * rows))
    return np.repeat(radiance(directions).reshape(rows, 2 * rows, 1), 3, axis=2)


def cube(radiance, size=48):
    directions, _ = cube_texels(size)
    return np.repeat(radiance(directions).reshape(6 * size, size, 1), 3, axis=2)


NORMALS = np.array([[0, 1, 0], [0.6, 0, 0.8], [-0.6, 0.48, -0.64], [0, -1, 0]], float)
AXIS = np.array([0.36, 0.48, 0.8])


@pytest.mark.parametrize("make, layout", [(latlong, "latlong"), (cube, "cube")])
def test_means_over_an_environment(make, layout):
    """Radiance 1 + a.w has the mean 1 + 2/3 a.n under a cosine, and 1 + (p + 1) / (p + 2) a.r in a
    lobe of power p."""
    map_ = EnvironmentMap(make(lambda w: 1 + w @ AXIS), layout, intensity=2.0)
    along = (NORMALS @ AXIS)[:, None]
    assert np.allclose(map_.diffuse(NORMALS), 2 + 4 / 3 * along, atol=2e-3)
    assert np.allclose(map_.specular(NORMALS, 20.0), 2 + 2 * 6 / 7 * along, atol=4e-3)
    assert np.allclose(map_.radiance(NORMALS), 2 + 2 * along, atol=0.06)


@pytest.mark.parametrize("make, layout", [(latlong, "latlong"), (cube, "cube")])
def test_a_direction_sees_its_own_texel(make, layout):
    texels = make(lambda w: w @ np.array([1.0, 2.0, 4.0]))
    directions = latlong_texels(texels.shape[:2])[0]
    if layout == "cube":
        directions = cube_texels(texels.shape[1])[0]
    found = EnvironmentMap(texels, layout).radiance(directions)
    assert np.allclose(found, texels.reshape(-1, 3), atol=1e-9)


def test_solid_angles_fill_the_sphere():
    for _, areas in (latlong_texels((6, 12)), cube_texels(5)):
        assert areas.sum() == pytest.approx(4 * np.pi) and np.all(areas > 0)


def test_where_a_latlong_map_points():
    map_ = EnvironmentMap(latlong(lambda w: 1 + w[:, 0]))
    texels = np.arange(8.0).reshape(2, 4, 1) * np.ones(3)
    ahead = EnvironmentMap(texels).radiance(np.array([[0, 1, -1e-3], [0, -1, -1e-3]]))
    assert ahead[:, 0] == pytest.approx([1.5, 5.5], abs=1e-9)  # the middle column, top and bottom
    assert map_.radiance(np.array([[1.0, 0, 0]]))[0, 0] == pytest.approx(2.0, abs=1e-3)
    turned = EnvironmentMap(map_.texels, rotation_degrees=90.0)  # +x goes to -z
    assert turned.radiance(np.array([[0, 0, -1.0]]))[0, 0] == pytest.approx(2.0, abs=1e-3)
    assert turned.diffuse(np.array([[0, 0, -1.0]]))[0, 0] == pytest.approx(5 / 3, abs=1e-3)


@pytest.fixture
def environment_scene(tmp_path):
    """A scene lit by an environment alone; its picture is handed to the twin."""

    def make(array, function=None, **keys):
        (tmp_path / "sky.exr").touch()
        environment = {"file": str(tmp_path / "sky.exr"), **keys.pop("environment", {})}
        return scene(array, function, environment=environment, **keys)

    return make


def test_an_environment_lights_alone(environment_scene):
    texels = latlong(lambda w: 1 - 0.5 * w[:, 2], 48)
    material = {**MATERIAL, "specular": 0.3, "shininess": 12.0}
    s = environment_scene(ramp(), material=material, integration={"step": 3.0})
    diffuse, specular = 1 + 0.5 * 2 / 3, 1 + 0.5 * 4 / 5  # N and R are -z
    expected = COLOR * (0.15 + 0.6 * diffuse) + 0.3 * specular
    assert lit_color(s, environment_map=texels) == pytest.approx(expected, abs=2e-3)


def test_a_constant_environment_lights_all_normals_alike(environment_scene):
    z, y, x = np.meshgrid(*(np.arange(16.0),) * 3, indexing="ij")
    s = environment_scene(x * 2 + y * z, environment={"intensity": 0.5}, material=MATERIAL,
                          integration={"step": 3.0})  # fmt: skip
    found = lit_color(s, environment_map=np.ones((4, 8, 3)))
    assert found == pytest.approx(COLOR * (0.15 + 0.6 * 0.5))


def test_what_is_left_of_a_ray_shows_a_visible_environment(environment_scene):
    texels = latlong(lambda w: 1 - w[:, 2], 64)
    clear = TransferFunction([0.0], [0.1], [[0.0, 0.0, 0.0]])
    s = environment_scene(BLOCK, clear, environment={"visible": True})
    found = along_z(s, x=7.0, y=7.0, environment_map=texels)
    assert found == pytest.approx([0.0, 0.0, 0.0, 1.0], abs=2e-3)
    found = ray(s, (7, 7, 25), (0, 0, -1), environment_map=texels)
    assert found == pytest.approx([*np.full(3, 2 * (1 - OPACITY)), 1.0], abs=2e-3)
    missed = ray(s, (7, 7, 25), (0, 0, 1), environment_map=texels)
    assert missed == pytest.approx([0, 0, 0, 1], abs=2e-3)


def test_the_environment_is_read_from_its_file(tmp_path):
    import OpenEXR

    texels = np.random.default_rng(5).uniform(size=(4, 8, 3)).astype(np.float32)
    planes = {name: np.ascontiguousarray(texels[..., k]) for k, name in enumerate("RGB")}
    path = str(tmp_path / "sky.exr")
    OpenEXR.File({}, planes).write(path)
    s = scene(BLOCK, environment={"file": path, "visible": True, "intensity": 2.0})
    found = ray(s, (7, 7, 25), (0.3, -0.2, 1))
    expected = 2 * EnvironmentMap(texels).radiance(np.array([[0.3, -0.2, 1]]) / np.sqrt(1.13))[0]
    assert found == pytest.approx([*expected, 1.0])
