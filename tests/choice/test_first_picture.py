"""The first picture of a volume: what it is recognised as, that it shows, and that nothing stated is overridden."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.first_volumes import HARD, KINDS, dark_solid, hounsfield, solid, two_materials

import clvol
from clvol.choice.first_picture import FirstPicture
from clvol.choice.hounsfield import hounsfield_offset
from clvol.choice.sample import sample_of
from clvol.choice.statistics import half_sample_mode, statistics_of
from clvol.scene.write import to_toml
from clvol.transfer import preset

SMALL = {"width": 48, "height": 40}


def in_picture(camera: clvol.Camera, points: np.ndarray, aspect: float) -> np.ndarray:
    """Largest distance of each point from the middle of the picture: 1 at its edge."""
    forward, right, up = camera.basis()
    away = points - np.asarray(camera.position)
    half = np.tan(np.radians(camera.fov_degrees) / 2) * (away @ forward)
    return np.maximum(np.abs(away @ up) / half, np.abs(away @ right) / half / aspect)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_data_is_recognised(kind):
    assert FirstPicture(KINDS[kind]()).natural.kind == kind


@pytest.mark.parametrize("kind", KINDS)
def test_the_whole_object_is_in_view(kind):
    scene = clvol.Scene(volume=KINDS[kind](), image=SMALL)
    completed = scene.completed()
    view = scene.first_picture().view(scene.first_picture().natural.points)
    reached = in_picture(completed.camera, view.points, 48 / 40)
    assert 0.6 < reached.max() <= 1.0, reached.max()


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "noise"])
def test_the_picture_shows_the_object_and_neither_fog_nor_a_box(kind, device):
    with clvol.Renderer(clvol.Scene(volume=KINDS[kind](), image=SMALL), devices=[device]) as renderer:
        frame = renderer.render()
    alpha = frame.rgba[..., 3]
    assert "warnings" not in frame.stats
    assert 0.04 < np.mean(alpha > 0.3), "hardly anything shows"
    assert np.mean(alpha < 0.02) > 0.1, "nothing but the object's background is empty"
    assert np.ptp(frame.rgba[..., :3][alpha > 0.3], axis=0).max() > 0.1, "flat"
    assert np.mean(np.all(frame.rgba[..., :3] > 0.97, axis=-1)) < 0.02, "a white blob"
    assert frame.stats["chosen"]["kind"] == kind


@pytest.mark.parametrize("case", HARD)
def test_hard_cases_have_a_look_and_a_camera(case):
    completed = clvol.Scene(volume=HARD[case](), image=SMALL).completed()
    resolved = completed.resolve()
    assert resolved.transfer_function.values.size >= 1
    assert np.isfinite(resolved.camera.position).all() and resolved.chosen["why"]


@pytest.mark.parametrize("case", ["constant", "one bright voxel", "one slice", "huge", "tiny", "far from zero"])
def test_hard_cases_show(case, device):
    with clvol.Renderer(clvol.Scene(volume=HARD[case](), image=SMALL), devices=[device]) as renderer:
        assert renderer.render().rgba[..., 3].max() > 0.25


def test_the_choice_is_the_same_each_time():
    volume = KINDS["microscopy"]()
    first, second = (clvol.Scene(volume=clvol.Volume(volume.data.copy())).completed() for _ in range(2))
    assert to_toml(first) == to_toml(second)


def test_the_choice_depends_on_the_sample_alone_and_the_sample_is_small():
    volume = clvol.Volume(np.zeros((300, 200, 250), np.uint8))
    sample = sample_of(volume)
    assert sample.values.size <= 2_500_000
    corner = np.array(sample.values.shape) - 1
    last = sample.world(np.array([corner]))[0]
    assert np.all(last <= np.array([249, 199, 299])) and np.all(last >= np.array([249, 199, 299]) - 2 * sample.step)


def test_what_is_stated_is_kept():
    stated = dict(
        volume=solid(), image={"width": 30, "height": 20, "background": [0.5, 0.25, 0.0]},
        camera={"position": (200.0, 3.0, 4.0), "fov_degrees": 41.0}, light=[{"type": "headlight", "intensity": 2.0}],
        material={"ambient": 0.6}, integration={"filter": "linear", "step": 0.75},
    )  # fmt: skip
    completed = clvol.Scene(**stated).completed()
    assert completed.image.background == (0.5, 0.25, 0.0)
    assert completed.camera.position == (200.0, 3.0, 4.0) and completed.camera.fov_degrees == 41.0
    assert [light.intensity for light in completed.light] == [2.0]
    assert completed.material.ambient == 0.6 and completed.material.shininess > 20.0
    assert completed.integration.filter == "linear" and completed.integration.step == 0.75


def test_a_stated_transfer_function_leaves_the_scene_as_it_is():
    points = [{"value": 0.0, "opacity": 0.0, "color": [0, 0, 0]}, {"value": 900.0, "opacity": 0.5, "color": [1, 1, 1]}]
    for stated in ({"points": points}, {"preset": "grayscale"}, {"opacity_unit": 2.0}):
        scene = clvol.Scene(volume=solid(), transfer_function=stated)
        assert scene.completed() is scene and scene.resolve().chosen is None


def test_grayscale_is_the_ramp_over_the_range():
    volume = solid()
    resolved = clvol.Scene(volume=volume, transfer_function={"preset": "grayscale"}).resolve()
    assert resolved.transfer_function == preset("grayscale", volume.value_range, 39 / 32)
    assert resolved.lights == ()


@pytest.mark.parametrize("spacing", [1e-6, 1e6])
def test_the_look_does_not_depend_on_the_unit_of_length(spacing):
    data = solid().data
    one, other = (clvol.Scene(volume=clvol.Volume(data, spacing=(s,) * 3)).resolve() for s in (1.0, spacing))
    assert np.array_equal(one.transfer_function.values, other.transfer_function.values)
    assert other.transfer_function.opacity_unit == pytest.approx(spacing * one.transfer_function.opacity_unit, rel=1e-5)
    scaled = np.asarray(one.camera.position) * spacing
    assert np.allclose(other.camera.position, scaled, rtol=1e-3, atol=1e-3 * np.abs(scaled).max())


def test_slope_and_offset_move_the_choice_with_the_values():
    data = solid().data
    plain = clvol.Scene(volume=clvol.Volume(data)).completed().transfer_function.points
    moved = clvol.Scene(volume=clvol.Volume(data, slope=2.0, offset=-50.0)).completed().transfer_function.points
    assert [p.value for p in moved] == pytest.approx([2 * p.value - 50 for p in plain])
    assert [p.opacity for p in moved] == [p.opacity for p in plain]


def test_the_darker_one_of_two_is_the_object_where_the_faces_are_bright():
    bright, dark = statistics_of(sample_of(solid())), statistics_of(sample_of(dark_solid()))
    assert (bright.sign, dark.sign) == (1, -1)
    assert bright.value(bright.edge) == pytest.approx(800, abs=120)
    assert dark.value(dark.edge) == pytest.approx(2200, abs=120)
    look = FirstPicture(dark_solid()).natural
    assert look.opacities(np.array([1800.0]))[0] > 0.5 and look.opacities(np.array([2600.0]))[0] == 0


def test_two_materials_are_told_apart_at_the_valley():
    found = statistics_of(sample_of(two_materials()))
    assert 85 < found.value(found.materials[-1]) < 185
    look = FirstPicture(two_materials()).natural
    shell, core = look.opacities(np.array([80.0, 200.0]))
    assert 0 < shell < 0.2 and core > 0.7


@pytest.mark.parametrize(("offset", "dtype"), [(0, np.int16), (1000, np.uint16), (1024, np.uint16)])
def test_an_offset_of_hounsfield_units_is_found(offset, dtype):
    assert hounsfield_offset(sample_of(hounsfield(offset, dtype))) == offset
    assert hounsfield_offset(sample_of(solid())) is None


def test_labels_keep_their_values_and_have_colours_of_their_own():
    volume = KINDS["labels"]()
    look = FirstPicture(volume).natural
    function = clvol.Scene(volume=volume).resolve().transfer_function
    found = [value for value in np.unique(volume.data) if value]
    colors = function.color(found)
    assert len({tuple(color) for color in colors.round(6)}) == len(found)
    assert (look.opacities(np.array(found, float)) == 1).all() and look.opacities(np.array([0.0]))[0] == 0
    assert clvol.Scene(volume=volume).completed().integration.filter == "nearest"


def test_the_mode_of_a_sample_is_found_among_outliers():
    random = np.random.default_rng(0)
    sample = np.concatenate([random.normal(5, 0.1, 500), random.uniform(-100, 100, 400)])
    assert half_sample_mode(sample) == pytest.approx(5, abs=0.2)
    assert half_sample_mode(np.array([3.0, 1.0, 1.0, 2.0])) == 1.0


@pytest.mark.parametrize("integration", [
    {"method": "multiresolution"}, {"method": "pyramid"}, {"method": "reference"}, {"method": "slicing"},
    {"quadrature": "cells"},
])  # fmt: skip
def test_methods_without_lights_get_none(integration, device):
    scene = clvol.Scene(volume=two_materials(), image={"width": 16, "height": 16}, integration=integration)
    completed = scene.completed()
    assert completed.light == () and completed.integration.filter == "linear"
    with clvol.Renderer(scene, devices=[device]) as renderer:
        assert renderer.render().rgba[..., 3].max() > 0.3


def test_a_projection_gets_a_ramp_and_surfaces_are_shown_alone():
    maximum = clvol.Scene(volume=solid(), integration={"compositing": "maximum"}).completed()
    assert maximum.light == () and [p.opacity for p in maximum.transfer_function.points] == [0.0, 1.0]
    surface = clvol.Scene(volume=solid(), isosurface=[{"value": 800.0}]).completed()
    assert all(p.opacity == 0 for p in surface.transfer_function.points) and len(surface.light) == 2


def test_of_a_store_one_coarse_level_is_read(tmp_path):
    from clvol.store.build import build_store

    data = np.repeat(np.repeat(np.repeat(two_materials().data, 2, 0), 2, 1), 2, 2)
    build_store(clvol.Volume(data), tmp_path / "v.zarr", edge=16)
    stored, plain = clvol.load_volume(tmp_path / "v.zarr"), clvol.Volume(data)
    sample = sample_of(stored, most=40**3)
    assert "data" not in vars(stored) and sample.values.shape == (40, 40, 40)
    assert sample.world(np.array([[0, 0, 0]])).tolist() == [[0.5, 0.5, 0.5]]
    assert np.allclose(sample.values, two_materials().data)
    found, expected = statistics_of(sample), statistics_of(sample_of(plain))
    assert found.value(found.edge) == pytest.approx(expected.value(expected.edge), rel=0.2)
