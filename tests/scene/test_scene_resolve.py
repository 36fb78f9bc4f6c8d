"""Scenes from files and from Python, their defaults, and their text."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import clvol
from clvol.errors import SceneError, VolumeError
from clvol.scene import Camera, ImageSettings, Light, load_scene
from clvol.transfer import preset, srgb_to_linear

CUBE = np.arange(27, dtype=np.float32).reshape(3, 3, 3)
RAMP = clvol.TransferFunction([0, 1], [0.0, 1.0], [[0, 0, 0], [1, 0.5, 0.25]], 2.0)

FULL = """\
version = 1
[volume]
file = "data/cube.npy"
spacing = [1, 2, 3]
nan = 0.5
[camera]
projection = "orthographic"
position = [600.0, 300.0, 500.0]
target = [127.5, 127.5, 63.5]
up = [0.0, 1.0, 0.0]
height = 33
[image]
width = 64
height = 48
background = [0.5, 0.25, 1.0]
[transfer_function]
opacity_unit = 3.0
color_space = "srgb"
points = [
  { value = 0.0,  opacity = 0.0, color = [0.0, 0.0, 0.0] },
  { value = 80.0, opacity = 0.2, color = [0.9, 0.6, 0.3] },
]
[integration]
method = "reference"
step = 0.5
classification = "post"
filter = "nearest"
early_termination = 0
table_size = 512
tolerance = 1e-7
[material]
ambient = 0.2
[[light]]
type = "directional"
direction = [-1.0, -1.0, -1.0]
[[light]]
type = "point"
position = [1, 2, 3]
intensity = 4
[[isosurface]]
value = 120.0
color = [0.5, 0.5, 0.5]
[[clip]]
point = [127.5, 0.0, 0.0]
normal = [1.0, 0.0, 0.0]
[multiresolution]
memory = "96 MiB"
stepping = "bounded"
interblock = false
view_weighting = false
occlusion = true
[pyramid]
levels = 3
oracle = "minimum"
epsilon = 1e-2
"""


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir()
    holed = CUBE.copy()
    holed[1, 1, 1] = np.nan
    np.save(tmp_path / "data" / "cube.npy", holed)
    path = tmp_path / "scene.toml"
    path.write_text(FULL, encoding="utf-8")
    return path


def test_every_key_of_a_scene_file_arrives(scene_file, monkeypatch, tmp_path_factory):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))  # paths are relative to the scene
    resolved = load_scene(scene_file).resolve()
    assert resolved.volume.grid.spacing == (1, 2, 3)
    assert resolved.camera == Camera(
        projection="orthographic", position=(600, 300, 500), target=(127.5, 127.5, 63.5),
        up=(0, 1, 0), height=33,
    ).complete(resolved.volume.grid, resolved.image)
    assert (resolved.image.width, resolved.image.height) == (64, 48)
    assert resolved.transfer_function.opacity_unit == 3.0
    np.testing.assert_array_equal(
        resolved.transfer_function.colors, srgb_to_linear([[0, 0, 0], [0.9, 0.6, 0.3]])
    )
    np.testing.assert_array_equal(resolved.background, srgb_to_linear([0.5, 0.25, 1.0]))
    integration = resolved.integration
    assert integration.method == "reference" and integration.step == 0.5
    assert integration.classification == "post" and integration.filter == "nearest"
    assert integration.early_termination == 0 and integration.table_size == 512
    assert integration.tolerance == 1e-7
    assert resolved.material.ambient == 0.2 and resolved.material.diffuse == 0.7
    assert [light.type for light in resolved.lights] == ["directional", "point"]
    assert resolved.lights[1].intensity == 4
    np.testing.assert_array_equal(resolved.isosurfaces[0].color, srgb_to_linear([0.5] * 3))
    assert resolved.clips[0].normal == (1, 0, 0)
    multiresolution = resolved.multiresolution
    assert multiresolution.memory_bytes == 96 * 2**20
    assert not multiresolution.view_weighting and multiresolution.occlusion
    assert resolved.pyramid.oracle == "minimum"
    assert resolved.origin == str(scene_file)


def test_nan_voxels_take_the_number_that_the_scene_names(scene_file):
    assert load_scene(scene_file).resolve().volume.data[1, 1, 1] == 0.5
    kept = load_scene(scene_file, ['volume.nan="transparent"']).resolve()
    assert math.isnan(kept.volume.data[1, 1, 1]) and kept.volume.nan_count == 1


def test_the_text_of_a_scene_reads_back_as_the_scene(scene_file):
    first = load_scene(scene_file)
    again = scene_file.with_name("again.toml")
    again.write_text(first.to_toml(), encoding="utf-8")
    second = load_scene(again)
    assert dict(second) == dict(first)
    assert second.to_toml() == first.to_toml() == first.resolve().source


def test_strange_names_survive_the_text(tmp_path):
    name = 'a "b" \\ é \x7f 𝄞\t.npy'
    scene = clvol.Scene(volume=name)
    path = tmp_path / "scene.toml"
    path.write_text(scene.to_toml(), encoding="utf-8")
    assert load_scene(path).volume.file == name


def test_the_text_of_a_python_scene_holds_all_but_the_voxels(tmp_path):
    scene = clvol.Scene(volume=clvol.Volume(CUBE), transfer_function=RAMP,
                        image=ImageSettings(width=5))
    text = scene.resolve().source
    assert "# volume: 3 x 3 x 3 voxels of float32" in text
    path = tmp_path / "scene.toml"
    path.write_text(text + '[volume]\nfile = "cube.npy"\n', encoding="utf-8")
    np.save(tmp_path / "cube.npy", CUBE)
    assert load_scene(path).resolve().transfer_function == RAMP


def test_a_grey_ramp_is_a_preset_with_the_whole_volume_in_view(tmp_path):
    np.save(tmp_path / "cube.npy", CUBE)
    ramp = {"preset": "grayscale"}
    for scene in (clvol.Scene(volume=clvol.Volume(CUBE), transfer_function=ramp),
                  load_scene(tmp_path / "cube.npy", ['transfer_function.preset="grayscale"']),
                  clvol.Scene(volume=tmp_path / "cube.npy", transfer_function=ramp),
                  clvol.Scene(volume=str(tmp_path / "cube.npy"), transfer_function=ramp)):
        resolved = scene.resolve()
        assert resolved.volume.shape == (3, 3, 3)
        assert resolved.camera == Camera.default(resolved.volume.grid, resolved.image)
        assert resolved.transfer_function == preset("grayscale", (0, 26), 2 / 32)
        assert (resolved.image.width, resolved.image.height) == (512, 512)
        assert (resolved.background == 0).all()
        assert resolved.lights == resolved.isosurfaces == resolved.clips == ()
        assert resolved.chosen is None


@pytest.mark.parametrize("spacing", [1e-6, 1.0, 1e6])
def test_the_grey_ramp_does_not_depend_on_the_unit_of_length(spacing):
    volume = clvol.Volume(CUBE, spacing=(spacing,) * 3)
    function = clvol.Scene(volume=volume, transfer_function={"preset": "grayscale"}).resolve().transfer_function
    assert function.extinction(13.0) * spacing == pytest.approx(-math.log1p(-0.25) * 16, rel=1e-12)


def test_a_preset_takes_the_range_of_the_volume():
    scene = clvol.Scene(volume=clvol.Volume(CUBE), transfer_function={"preset": "hot"})
    assert scene.resolve().transfer_function == preset("hot", (0, 26), 2 / 32)
    stated = {"preset": "hot", "opacity_unit": 3.0}
    scene = scene.model_copy(update={"transfer_function": stated})
    assert scene.resolve().transfer_function == preset("hot", (0, 26), 3.0)


def test_points_without_an_opacity_unit_are_per_world_unit():
    points = [{"value": 0, "opacity": 0.5, "color": [1, 1, 1]}]
    scene = clvol.Scene(volume=clvol.Volume(CUBE), transfer_function={"points": points})
    assert scene.resolve().transfer_function.opacity_unit == 1.0


def test_linear_colours_are_taken_as_they_are():
    points = [{"value": 0, "opacity": 0.5, "color": [0.5, 0.5, 0.5]}]
    scene = clvol.Scene(
        volume=clvol.Volume(CUBE),
        image={"background": [0.5, 0, 0]},
        isosurface=[{"value": 1, "color": [0.5, 0, 0]}],
        transfer_function={"points": points, "color_space": "linear"},
    )
    resolved = scene.resolve()
    assert (resolved.transfer_function.colors == 0.5).all()
    assert resolved.background[0] == resolved.isosurfaces[0].color[0] == 0.5


def test_numpy_numbers_are_numbers():
    camera = Camera(position=np.array([1, 2, 3], dtype=np.float32), fov_degrees=np.float32(40))
    assert camera.position == (1.0, 2.0, 3.0) and camera.fov_degrees == 40
    assert ImageSettings(width=np.int64(7)).width == 7


def test_a_copy_is_checked_and_shares_the_volume(tmp_path):
    np.save(tmp_path / "cube.npy", CUBE)
    scene = load_scene(tmp_path / "cube.npy")
    loaded = scene.load_volume()
    other = scene.model_copy(update={"camera": Camera(position=(9, 9, 9))})
    assert other.load_volume() is loaded
    assert other.resolve().camera.position == (9, 9, 9) and scene.camera is None
    assert other.origin == scene.origin
    with pytest.raises(SceneError, match="image.width: got 0"):
        scene.model_copy(update={"image": {"width": 0}})
    moved = scene.model_copy(update={"volume": clvol.Volume(CUBE[:2])})
    assert moved.load_volume().shape == (2, 3, 3)


def test_scenes_cannot_be_changed_unchecked():
    scene = clvol.Scene(volume=clvol.Volume(CUBE))
    with pytest.raises(ValueError):
        scene.image = None


@pytest.mark.parametrize(
    ("keys", "where"),
    [
        ({}, "volume"),
        ({"volume": 3}, "volume"),
        ({"volume": CUBE}, "volume"),
        ({"volume": None}, "volume"),
        ({"transfer_function": [1]}, "transfer_function"),
        ({"camera": 3}, "camera"),
        ({"light": [Light(type="headlight"), 3]}, "light.1"),
        ({"imgae": {}}, "imgae"),
    ],
)
def test_mistakes_from_python_name_the_key(keys, where):
    asked = keys if not keys or "volume" in keys else {"volume": clvol.Volume(CUBE), **keys}
    with pytest.raises(SceneError) as caught:
        clvol.Scene(**asked)
    assert caught.value.where == f"scene: {where}"


def test_a_volume_over_the_memory_cap_is_refused(tmp_path):
    np.save(tmp_path / "cube.npy", CUBE)
    with pytest.raises(VolumeError, match="memory cap"):
        load_scene(tmp_path / "cube.npy").resolve(memory_cap=10)


def test_an_all_nan_volume_still_has_a_look():
    volume = clvol.Volume(np.full((2, 2, 2), np.nan, dtype=np.float32))
    assert clvol.Scene(volume=volume).resolve().transfer_function.values.size >= 1
