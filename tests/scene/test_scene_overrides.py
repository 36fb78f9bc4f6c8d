"""Overrides: TABLE.KEY=VALUE, in TOML syntax."""

from __future__ import annotations

from pathlib import Path

import pytest

from clvol.errors import SceneError
from clvol.scene import load_scene

TEXT = """\
[volume]
file = "cube.npy"
[camera]
up = [0.0, 1.0, 0.0]
[[light]]
type = "headlight"
[[light]]
type = "point"
position = [1, 2, 3]
"""


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_values_of_every_type(scene_file):
    scene = load_scene(
        scene_file,
        [
            "image.width=17",
            "integration.step=0.25",
            'integration.classification="post"',
            "multiresolution.interblock=false",
            "image.background=[0.1, 0.2, 0.3]",
            "transfer_function.points=[{value=1,opacity=0.5,color=[1,1,1]}]",
            " camera . fov_degrees = 40 ",
        ],
    )
    assert scene.image.width == 17
    assert scene.integration.step == 0.25 and scene.integration.classification == "post"
    assert scene.multiresolution.interblock is False
    assert scene.image.background == (0.1, 0.2, 0.3)
    assert scene.transfer_function.points[0].value == 1.0
    assert scene.camera.fov_degrees == 40.0


def test_list_elements_by_index(scene_file):
    scene = load_scene(scene_file, ["light.1.intensity=2", "camera.up.0=0.5"])
    assert scene.light[0].intensity == 1.0 and scene.light[1].intensity == 2.0
    assert scene.camera.up == (0.5, 1.0, 0.0)


def test_the_next_index_appends(scene_file):
    scene = load_scene(scene_file, ["clip.0.point=[0,0,0]", "clip.0.normal=[1,0,0]",
                                    'light.2.type="headlight"'])
    assert scene.clip[0].normal == (1.0, 0.0, 0.0)
    assert len(scene.light) == 3


def test_later_overrides_win(scene_file):
    assert load_scene(scene_file, ["image.width=1", "image.width=2"]).image.width == 2


def test_an_equals_sign_may_be_part_of_the_value(scene_file):
    assert load_scene(scene_file, ['volume.file="a=b.npy"']).volume.file == "a=b.npy"


def test_a_volume_file_takes_overrides(tmp_path):
    scene = load_scene(tmp_path / "cube.raw", ["volume.dims=[2,3,4]", 'volume.dtype="uint8"'])
    assert scene.volume.dims == (2, 3, 4)
    assert scene.volume.file == str(tmp_path / "cube.raw")


@pytest.mark.parametrize(
    ("override", "where", "expected"),
    [
        ("image.width", "--set 'image.width'", "TABLE.KEY=VALUE"),
        ("", "--set ''", "TABLE.KEY=VALUE"),
        ("=3", "--set '=3'", "TABLE.KEY=VALUE"),
        ("image..width=3", "--set 'image..width=3'", "TABLE.KEY=VALUE"),
        ("image.wi dth=3", "--set 'image.wi dth=3'", "TABLE.KEY=VALUE"),
        ("image.width=", "--set 'image.width='", "a value in TOML syntax"),
        ("image.width=[1,", "--set 'image.width=[1,'", "a value in TOML syntax"),
        ("image.width=3 4", "--set 'image.width=3 4'", "a value in TOML syntax"),
        ("image.width=3\nheight=4", "--set 'image.width=3\\nheight=4'", "a value in TOML syntax"),
        ("integration.method=post", "--set 'integration.method=post'", 'method="post"'),
        ("light.3.intensity=2", "FILE: light", "an index from 0 to 2"),
        ("light.x.intensity=2", "FILE: light", "an index from 0 to 2"),
        ("light.-1.intensity=2", "FILE: light", "an index from 0 to 2"),
        ("volume.file.x=2", "FILE: volume.file", "a table with the key x"),
    ],
)
def test_what_is_no_override_is_refused(scene_file, override, where, expected):
    with pytest.raises(SceneError) as caught:
        load_scene(scene_file, [override])
    assert caught.value.where == where.replace("FILE", str(scene_file))
    assert expected in caught.value.expected
