"""Scenes with noise and cycling colours: the kernels beside the twin, leaping, and animation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference import render_twin
from small_scenes import picture, waves

from clvol import Camera, Scene, TransferFunction, Volume, load_scene
from clvol.device.noise import perturbation
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.features import reduced
from clvol.integrators.raycast.caster import Raycaster
from clvol.render import Renderer
from clvol.scene import ImageSettings
from clvol.volume import Grid

DATA = Path(__file__).parents[2] / "data"
CAMERA = {"position": (26.0, 20.0, -15.0), "target": (6.0, 5.5, 7.0), "fov_degrees": 36.0}
PEAK = TransferFunction(
    [0.0, 90.0, 140.0, 190.0, 255.0], [0.0, 0.0, 0.5, 0.2, 0.1],
    [[0.1, 0.2, 0.9], [0.2, 0.9, 0.4], [0.9, 0.6, 0.2], [1.0, 0.2, 0.2], [1.0, 0.9, 0.9]], 2.0,
)  # fmt: skip
VALUE = {"target": "value", "amplitude": 60.0, "frequency": 0.7, "octaves": 3, "seed": 2}
PLACE = {"target": "coordinate", "amplitude": 2.0, "frequency": 0.8, "octaves": 2, "seed": 1}
MOVING = {**VALUE, "velocity": (0.3, -0.75, 0.5)}


def noisy(noise=(), array=None, function=PEAK, *, size=(12, 10), camera=CAMERA, **tables):
    """A resolved scene."""
    integration = {"early_termination": 0.0, "step": 0.5, **tables.pop("integration", {})}
    return Scene(
        volume=Volume(waves((15, 12, 13)) if array is None else array, spacing=(1.0, 1.2, 0.8)),
        transfer_function=function,
        camera=Camera(**camera),
        image=ImageSettings(width=size[0], height=size[1]),
        integration=integration,
        noise=list(noise),
        **tables,
    ).resolve()


def same_as_twin(context, scene, tolerance=3e-3) -> None:
    found, expected = picture(context, reduced(scene)).rgba, render_twin(scene)
    assert expected[..., 3].max() > 0.1
    np.testing.assert_allclose(found, expected, atol=tolerance)


@pytest.mark.parametrize("classification", ["post", "preintegrated"])
@pytest.mark.parametrize(
    "noise", [[VALUE], [PLACE], [PLACE, VALUE, {**VALUE, "seed": 9, "amplitude": -20.0}]],
    ids=["value", "coordinate", "three terms"],
)  # fmt: skip
def test_pictures_are_the_twins(context, noise, classification):
    scene = noisy(noise, integration={"classification": classification, "table_size": 1024})
    same_as_twin(context, scene)
    plain, moved = (render_twin(noisy(terms)) for terms in ((), noise))
    assert np.abs(moved - plain).max() > 0.05


def test_values_beyond_the_range_are_classified_as_they_are(context):
    """The transfer function says more of what only noise leads to."""
    beyond = TransferFunction([255.0, 290.0, 330.0], [0.0, 0.6, 0.0], [[1.0, 0.5, 0.2]] * 3)
    scene = noisy([{**VALUE, "amplitude": 90.0}], function=beyond)
    same_as_twin(context, scene)


def test_noise_over_a_constant_is_seen(context):
    array = np.full((15, 12, 13), 100, np.uint8)
    same_as_twin(context, noisy([{**VALUE, "amplitude": 80.0}], array))


def test_places_that_leave_the_volume_are_taken_to_its_faces(context):
    far = {**PLACE, "amplitude": 40.0, "octaves": 1}
    same_as_twin(context, noisy([far], integration={"classification": "post"}), 4e-3)


@pytest.mark.parametrize("noise", [[VALUE], [PLACE]], ids=["value", "coordinate"])
def test_noise_is_lit_by_its_own_gradient(context, noise):
    light = [{"type": "directional", "direction": (0.5, -0.3, 1.0)}]
    scene = noisy(noise, light=light, integration={"classification": "post"})
    same_as_twin(context, scene, 6e-3)
    unlit = render_twin(noisy(noise, integration={"classification": "post"}))
    assert np.abs(render_twin(scene) - unlit).max() > 0.05


def test_iso_surfaces_lie_where_noise_leads(context):
    hidden = TransferFunction([0.0], [0.0], [[1.0, 1.0, 1.0]])
    surface = [{"value": 150.0, "opacity": 0.6, "color": (1.0, 0.5, 0.2)}]
    found = picture(context, reduced(noisy([VALUE], function=hidden, isosurface=surface)))
    expected = render_twin(noisy([VALUE], function=hidden, isosurface=surface))
    differs = np.abs(found.rgba - expected).max(axis=-1) > 2e-3
    assert expected[..., 3].max() > 0.5 and differs.mean() < 0.03  # grazed by one, met by the other


def ball(dtype=np.uint8) -> np.ndarray:
    """A small ball in much empty space, 56 x 50 x 63 voxels."""
    z, y, x = np.meshgrid(np.arange(63.0), np.arange(50.0), np.arange(56.0), indexing="ij")
    distance = np.sqrt((x - 24) ** 2 + (y - 22) ** 2 + (z - 30) ** 2)
    return np.clip(255 - 16 * distance, 0, 255).astype(dtype)


@pytest.mark.parametrize(
    "noise, tables",
    [
        ([{**VALUE, "amplitude": 25.0}], {}),
        ([{**PLACE, "amplitude": 6.0}], {}),
        ([{**VALUE, "amplitude": 25.0}, {**PLACE, "amplitude": 6.0}],
         {"isosurface": [{"value": 120.0, "opacity": 0.5}]}),
        ([{**VALUE, "amplitude": 25.0}], {"integration": {"compositing": "maximum"}}),
        ([{**PLACE, "amplitude": 6.0}], {"integration": {"compositing": "maximum"}}),
    ],
    ids=["value", "coordinate", "surface", "maximum", "maximum of moved places"],
)  # fmt: skip
def test_leaping_changes_no_bit(context, noise, tables):
    camera = {"position": (70.0, 60.0, -60.0), "target": (27.0, 29.0, 24.0), "fov_degrees": 45.0}
    scene = reduced(noisy(noise, ball(), size=(40, 32), camera=camera, **tables))
    leaping, every = (picture(context, scene, skip=skip) for skip in (True, False))
    assert np.array_equal(leaping.rgba, every.rgba)
    assert every.rgba[..., 3].std() > 0.05 and leaping.samples < every.samples


@pytest.mark.parametrize("noise", [[VALUE, PLACE]])
def test_lanes_agree(context, noise):
    one, sixteen = (picture(context, noisy(noise), lanes=lanes) for lanes in (1, 16))
    np.testing.assert_allclose(one.rgba, sixteen.rgba, atol=2e-5)


def test_what_leaping_must_know_of_places():
    grid = Grid((65, 65, 65), (1.0, 2.0, 4.0))
    moved = perturbation(noisy([{**PLACE, "amplitude": 16.0, "octaves": 1}]).noise, grid)
    assert moved.added == 0 and moved.cells == (3, 2, 1)  # 16, 8 and 4 voxels, and a little
    added = perturbation(noisy([VALUE]).noise, grid, 0.5)
    assert added.cells == (0, 0, 0)
    assert added.added == pytest.approx(30.0 * 1.75, rel=1e-4)


def rendered(scene, device, *times):
    with Renderer(scene, devices=[device]) as renderer:
        return [renderer.render(time=time).rgba for time in times]


def test_an_amplitude_of_0_is_no_noise(device):
    still = [{**VALUE, "amplitude": 0.0}, {**PLACE, "amplitude": 0.0}]
    assert kernel_hash(noisy(still)) == kernel_hash(noisy())
    pictures = [rendered(noisy(noise), device, 0.0)[0] for noise in ((), still)]
    assert np.array_equal(*pictures)


def test_time_moves_noise_and_whole_tiles_bring_it_back(device):
    first, later, back, again = rendered(noisy([MOVING]), device, 0.0, 1.0, 20.0, 0.0)
    assert np.abs(later - first).max() > 0.05
    assert np.array_equal(first, again) and np.array_equal(first, back)
    (alone,) = rendered(noisy([MOVING], animation={"time": 1.0}), device, None)
    assert np.array_equal(alone, later)


@pytest.mark.parametrize("method", ["volume", "rays"])
def test_shadows_move_with_the_noise_that_casts_them(device, method):
    tables = {
        "light": [{"type": "directional", "direction": (0.5, -0.3, 1.0)}],
        "shadow": {"method": method, "resolution": 8},
    }  # fmt: skip
    _, moved = rendered(noisy([MOVING], **tables), device, 0.0, 1.0)
    (alone,) = rendered(noisy([MOVING], animation={"time": 1.0}, **tables), device, None)
    assert np.array_equal(alone, moved)


@pytest.mark.parametrize("noise", [(), [VALUE]], ids=["plain", "noise"])
def test_colours_cycle_while_opacity_stays(device, noise):
    scene = noisy(noise, animation={"cycle": 0.5})
    first, half, whole, other = rendered(scene, device, 0.0, 1.0, 2.0, -4.0)
    assert np.array_equal(first, whole) and np.array_equal(first, other)
    assert np.abs(half - first)[..., :3].max() > 0.1
    np.testing.assert_allclose(half[..., 3], first[..., 3], atol=1e-6)


@pytest.mark.parametrize("noise", [(), [VALUE]], ids=["plain", "noise"])
def test_cycled_pictures_are_the_twins(context, noise):
    scene = noisy(noise, animation={"cycle": 0.5, "time": 0.7}, integration={"table_size": 1024})
    same_as_twin(context, scene)


def test_without_a_move_cycling_shows_the_plain_picture(device):
    plain, cycling = (
        rendered(noisy(animation=animation), device, 0.0)[0] for animation in ({}, {"cycle": 0.5})
    )
    np.testing.assert_allclose(cycling, plain, atol=2e-3)  # nodes elsewhere


def test_another_time_compiles_and_uploads_nothing(context):
    scene = noisy([MOVING], animation={"cycle": 0.3, "time": 0.2})
    caster = Raycaster(context, scene)
    animation = scene.animation.model_copy(update={"time": 5.0})
    other = caster.for_scene(replace(scene, animation=animation))
    assert other.switches == caster.switches and other.volume is caster.volume
    assert other.effects.arrays["noise"] is caster.effects.arrays["noise"]
    assert other.distances is caster.distances
    changed = other.effects.numbers[0] != caster.effects.numbers[0]
    assert changed and caster.effects.numbers[0]["noise_terms"]["offset"][0, 0] == np.float32(0.06)


def test_classifying_voxels_is_refused():
    with pytest.raises(SceneError, match="integration.classification: got 'pre' in a scene that"):
        explain(noisy([VALUE], integration={"classification": "pre"}))
    explain(noisy([{**VALUE, "amplitude": 0.0}], integration={"classification": "pre"}))


@pytest.mark.parametrize("name", ["fireball", "cloud"])
def test_scenes_of_fire_and_clouds(device, name):
    overrides = ["image.width=48", "image.height=40"]
    scene = load_scene(DATA / f"{name}.toml", overrides)
    first, later = rendered(scene, device, 0.0, 0.5)
    shown = first[..., 3] > 0.5
    assert 0.05 < shown.mean() < 0.8 and not shown[0].any()
    assert np.abs(later - first).max() > 0.1
    red, _, blue = first[shown][:, :3].mean(axis=0)
    assert red > 4 * blue if name == "fireball" else red == pytest.approx(blue, rel=0.2)
