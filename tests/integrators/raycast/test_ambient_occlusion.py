"""Ambient occlusion: what of the light from all around arrives, against closed forms and the plain twin."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.shadow_scenes import BALL, BLOCK, DIFFUSE, SLANTED, ball
from helpers.twin_scenes import constant_function, scene
from reference import render_twin
from reference.medium import Medium
from reference.occlusion import Occlusion

import clvol
from clvol import Renderer, TransferFunction
from clvol.device.occlusion_volume import check_occlusion_fits, filled, occlusion_bytes, sphere_directions
from clvol.errors import SceneError, VolumeError
from clvol.features.gradient_storage import DeviceLimits
from clvol.integrators.raycast.caster import Raycaster

TAU = -np.log(0.9)  # of constant_function(), a world length
NEAR = {"directions": 12, "resolution": 9, "distance": 9.0}
SMALL = {"width": 16, "height": 16}


def occluded(array, function=None, table=NEAR, **tables):
    return scene(array, function, ambient_occlusion=table, image=SMALL, **tables)


def points(context, resolved, **how):
    """[z, y, x, 4] of the device's grid, and its caster."""
    caster = Raycaster(context, resolved, **how)
    return context.read(caster.effects.arrays["occlusion"]), caster


def picture(context, resolved, **how):
    return Raycaster(context, resolved, **how).render(resolved.camera, 16, 16)


# --- closed forms -----------------------------------------------------------------------------------


def test_fog_takes_what_the_integral_says_and_from_everywhere_alike(context):
    reach = 5.0
    table = {"directions": 16, "resolution": 16, "distance": reach, "step": 0.1}
    found, _ = points(context, occluded(BLOCK, table=table))
    expected = 1.0 - ((1.0 - np.exp(-TAU * reach)) * -1.0 / (TAU * reach) + 1.0)
    middle = found[6:10, 6:10, 6:10]
    np.testing.assert_allclose(middle[..., 0], expected, atol=1e-4)
    np.testing.assert_allclose(middle[..., 1:], 0.0, atol=1e-5)


def test_what_is_in_the_open_gets_all(context):
    array = np.zeros((16, 16, 16), np.float32)
    array[:4] = 1.0
    wall = TransferFunction([0, 0.5, 0.5, 1], [0, 0, 1, 1], [[1, 1, 1]] * 4)
    table = {"directions": 400, "distance": 3.0, "resolution": 16, "step": 0.1}
    found, _ = points(context, occluded(array, wall, table))
    assert (found[8:] == [1.0, 0.0, 0.0, 0.0]).all()  # farther than the distance
    beside = found[4, 6:-6, 6:-6]  # half a voxel before the wall
    u = (np.arange(10000) + 0.5) / 10000  # cosines of the half of the directions that meet it
    taken = np.maximum(1.0 - 0.5 / (3.0 * u), 0.0)
    np.testing.assert_allclose(beside[..., 0], 1 - 0.5 * taken.mean(), atol=0.01)
    np.testing.assert_allclose(beside[..., 3], 0.5 * (taken * u).mean(), atol=0.01)
    assert np.abs(found[2, 3:-3, 3:-3]).max() < 0.02  # inside of it, but for half a step


def test_a_corner_is_darker_than_a_wall_and_a_wall_than_an_edge(context):
    """Faces of three opaque blocks, unlit: the colour is the share of light."""
    z, y, x = np.mgrid[:32, :32, :32]
    solid = TransferFunction([0, 0.4, 0.6, 1], [0, 0, 1, 1], [[1, 1, 1]] * 4)
    table = {"directions": 64, "resolution": 32, "distance": 12.0}

    def brightness(solid_at, u, v):
        of = scene(solid_at.astype(np.float32), solid, ambient_occlusion=table,
                   image={"width": 32, "height": 32},
                   camera={"projection": "orthographic", "height": 32.0, "position": [15.5, 15.5, -20.0],
                           "target": [15.5, 15.5, 15.5], "up": [0.0, -1.0, 0.0]})  # fmt: skip
        return Raycaster(context, of).render(of.camera, 32, 32).rgba[v, u, :3].mean()

    floor = z > 20
    wall = brightness(floor, 16, 16)
    crease = brightness(floor | (x > 17), 16, 16)
    corner = brightness(floor | (x > 17) | (y > 17), 16, 16)
    assert 0.9 < wall <= 1.0 and crease < wall - 0.1 and corner < crease - 0.1


def test_directions_are_even_over_the_sphere():
    ways = sphere_directions(48)
    assert np.abs(ways.sum(axis=0)).max() < 1e-12
    np.testing.assert_allclose(ways.T @ ways / 48, np.eye(3) / 3, atol=0.02)
    assert np.linalg.norm(ways, axis=1) == pytest.approx(np.ones(48))


def test_points_inside_of_matter_take_what_is_around_them():
    seen, clear = np.zeros((3, 3, 3, 4), np.float32), np.zeros((3, 3, 3), np.float32)
    seen[0], clear[0] = [0.8, 0.0, 0.0, -0.2], 1.0
    made = filled(seen, clear)
    np.testing.assert_allclose(made[:2], np.broadcast_to(seen[0, 0, 0], (2, 3, 3, 4)), atol=1e-6)
    assert (made[2] == 0).all()  # nothing open is beside those


# --- the twin ---------------------------------------------------------------------------------------

SURFACE = {"isosurface": [{"value": 7.0, "opacity": 0.6, "color": [0.4, 1, 1]}]}
LIT = {"light": [SLANTED], "material": {"ambient": 0.4, "diffuse": 0.6, "specular": 0.3}}
SCENES = {
    "unlit": {},
    "lit": LIT,
    "ambient": {**LIT, "table": {**NEAR, "darkens": "ambient", "intensity": 0.7}},
    "fading": {**LIT, "material": {**DIFFUSE, "fade": 1.5}},
    "clipped": {**LIT, "clip": [{"point": [11, 12, 9], "normal": [1, 0.3, 0.1]}]},
    "surface": {**LIT, **SURFACE},
    "unlit surface": SURFACE,
    "shadowed": {**LIT, "shadow": {"resolution": 12}},
    "preintegrated": {**LIT, "integration": {"classification": "preintegrated"}},
    "pre": {"integration": {"classification": "pre"}},
}


def of(name):
    tables = dict(SCENES[name])
    return occluded(ball(), BALL, tables.pop("table", NEAR), **tables)


_FAST = ("unlit", "lit", "surface")  # others compile two more programs each


@pytest.mark.parametrize("name", [
    name if name in _FAST else pytest.param(name, marks=pytest.mark.slow) for name in SCENES
])  # fmt: skip
def test_pictures_are_the_twins(context, name):
    resolved = of(name)
    found, caster = points(context, resolved)
    expected = Occlusion(resolved, Medium(resolved, None, None)).points()
    # A surface that is only grazed between samples is seen by the twin, which looks closer.
    assert np.abs(found - expected).max() < (2e-2 if "surface" in name else 2e-3)
    frame, twin = caster.render(resolved.camera, 16, 16), render_twin(resolved)
    assert np.abs(frame.rgba - twin).max() < (6e-3 if "surface" in name else 1e-3)
    bare = scene(ball(), BALL, image=SMALL, **{k: t for k, t in SCENES[name].items() if k != "table"})
    assert np.abs(picture(context, bare).rgba - twin).max() > 0.02
    assert frame.counters["occlusion_samples"] == caster.occlusion_samples > 0


@pytest.mark.parametrize("name", ["unlit", "surface"])
def test_leaps_and_packets_change_nothing(context, name):
    resolved = of(name)
    found, caster = points(context, resolved)
    looks, slower = points(context, resolved, skip=False)
    assert np.array_equal(found, looks) and caster.occlusion_samples < slower.occlusion_samples


@pytest.mark.slow
@pytest.mark.parametrize("name", ["unlit", "surface"])
def test_single_rays_find_the_same(context, name):
    (found, _), (single, _) = (points(context, of(name), lanes=lanes) for lanes in (16, 1))
    # Roots on faces of cells are rounded otherwise.
    assert np.abs(single - found).max() < (1e-2 if name == "surface" else 1e-5)


def test_devices_agree(each_device):
    resolved = of("lit")
    with Renderer(resolved, devices=[each_device]) as renderer:
        frame = renderer.render()
    assert np.abs(frame.rgba - render_twin(resolved)).max() < 1e-3
    assert frame.stats["counters"]["occlusion_samples"] > 0 and "ambient occlusion" in frame.stats["effects"]


def test_it_outlives_the_camera_but_not_the_transfer_function(context):
    resolved = of("unlit")
    found, caster = points(context, resolved)
    kept = caster.effects.arrays["occlusion"]
    caster.render(resolved.camera.model_copy(update={"position": [0, 0, -40]}), 8, 8)
    assert caster.effects.arrays["occlusion"] is kept
    caster.set_transfer_function(constant_function())
    assert not np.array_equal(context.read(caster.effects.arrays["occlusion"]), found)


# --- only what is called for --------------------------------------------------------------------------


@pytest.mark.parametrize("table, reason", [
    ({"intensity": 0.0}, "the ambient occlusion's intensity is 0"),
    (None, "the scene has no ambient occlusion"),
])  # fmt: skip
def test_without_consequence_nothing_is_compiled(table, reason):
    from clvol.explanation import explain

    bare, idle = (explain(scene(ball(), BALL, **LIT, **more)) for more in ({}, {"ambient_occlusion": table}))
    assert idle["kernel_hash"] == bare["kernel_hash"]
    told = {effect["name"]: effect for effect in idle["effects"]}["ambient occlusion"]
    assert told["reason"] == reason and not told["called_for"]
    called = explain(occluded(ball(), BALL, **LIT))
    assert called["kernel_hash"] != bare["kernel_hash"]


def test_its_distance_is_an_eighth_of_the_diagonal_unless_stated():
    resolved = occluded(ball(), BALL, {})
    assert resolved.ambient_occlusion.distance == pytest.approx(23 * np.sqrt(3) / 8)
    assert occluded(ball(), BALL).ambient_occlusion.distance == 9.0


@pytest.mark.parametrize("integration", [{"method": "pyramid"}, {"method": "slicing"}])
def test_methods_without_it_say_so(integration):
    with pytest.raises(SceneError, match="ambient occlusion"), \
         Renderer(clvol.Scene(volume=clvol.Volume(ball()), transfer_function=BALL, ambient_occlusion=NEAR,
                              integration=integration, image=SMALL)):  # fmt: skip
        pass


def test_a_grid_that_does_not_fit_is_refused():
    resolved = occluded(BLOCK, table={"resolution": 100})
    needed = occlusion_bytes(resolved)
    assert needed == 16 * 100**3
    check_occlusion_fits(resolved, DeviceLimits(memory=needed, buffer=needed))
    with pytest.raises(SceneError, match="ambient_occlusion.resolution: got 100"):
        check_occlusion_fits(resolved, DeviceLimits(memory=2**40, buffer=needed - 1))
    with pytest.raises(VolumeError, match="memory cap"):
        Renderer(resolved, memory_cap=needed)


@pytest.mark.parametrize("keys, key", [
    ({"directions": 13}, "directions"), ({"directions": 4}, "directions"), ({"distance": 0.0}, "distance"),
    ({"intensity": 1.2}, "intensity"), ({"darkens": "light"}, "darkens"), ({"resolution": 3}, "resolution"),
    ({"radius": 3.0}, "radius"),
])  # fmt: skip
def test_wrong_keys_are_named(keys, key):
    with pytest.raises(SceneError, match=f"ambient_occlusion.{key}"):
        occluded(BLOCK, table=keys)
