"""[volume] with a field in place of a file."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import Scene, load_scene
from clvol.errors import SceneError, VolumeError
from clvol.scene import VolumeSettings


@pytest.fixture
def scene_file(tmp_path):
    def make(keys: str):
        path = tmp_path / "scene.toml"
        path.write_text(f"version = 1\n[volume]\n{keys}\n", encoding="utf-8")
        return path

    return make


@pytest.mark.parametrize("field", ["radial", "ellipsoid", "constant"])
def test_a_field_is_a_volume(scene_file, field):
    scene = load_scene(scene_file(f'field = "{field}"\nsize = [5, 6, 7]\nspacing = [1, 2, 3]'))
    assert scene.volume_path is None
    volume = scene.resolve().volume
    assert volume.shape == (7, 6, 5) and volume.grid.spacing == (1.0, 2.0, 3.0)
    assert volume.dtype == np.uint8 and volume.name == field


def test_it_is_written_as_it_was_read(scene_file):
    scene = load_scene(scene_file('field = "radial"\nsize = [5, 6, 7]'))
    again = load_scene(scene_file(scene.to_toml().split("[volume]")[1]))
    assert again.volume == scene.volume


def test_it_can_be_built_in_python():
    scene = Scene(volume=VolumeSettings(field="radial", size=[4, 4, 4]))
    assert scene.load_volume().shape == (4, 4, 4)


MISTAKES = [
    ("", "file", "missing", "the name of a volume file, or a field and its size"),
    ('file = "a.nrrd"\nfield = "radial"\nsize = [4, 4, 4]', "field", "got 'radial'", "not both"),
    ('field = "radial"', "size", "missing", "[nx, ny, nz]"),
    ('file = "a.nrrd"\nsize = [4, 4, 4]', "size", "got [4, 4, 4]", "beside field alone"),
    ('field = "cube"\nsize = [4, 4, 4]', "field", "got 'cube'", "'radial', 'ellipsoid' or"),
    ('field = "radial"\nsize = [4, 4]', "size.2", "missing", "three whole numbers"),
    ('field = "radial"\nsize = [4, 0, 4]', "size.1", "got 0", "three whole numbers"),
    ('field = "radial"\nsize = [4, 4, 4]\ndims = [4, 4, 4]', "dims", "got [4, 4, 4]", "no dims"),
    ('field = "radial"\nsize = [4, 4, 4]\ndtype = "u1"', "dtype", "got 'u1'", "no dtype"),
]


@pytest.mark.parametrize(("keys", "key", "what", "expected"), MISTAKES)
def test_mistakes_are_one_line(scene_file, keys, key, what, expected):
    path = scene_file(keys)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert caught.value.where == f"{path}: volume.{key}"
    assert caught.value.what == what and expected in caught.value.expected
    assert "\n" not in str(caught.value)


def test_what_does_not_fit_is_refused_before_it_is_made(scene_file):
    scene = load_scene(scene_file('field = "constant"\nsize = [100000, 100000, 100000]'))
    with pytest.raises(VolumeError, match="volume.size: the volume needs 909 TiB"):
        scene.load_volume()
    small = load_scene(scene_file('field = "constant"\nsize = [10, 10, 10]'))
    with pytest.raises(VolumeError, match="needs 1000 bytes, expected at most 999 bytes"):
        small.load_volume(memory_cap=999)
