"""Channel, time and series of [volume] and [[field]]: what they take, and where they lead."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from helpers.slice_files import voxels

from clvol.cli import main
from clvol.cli.info import command as info
from clvol.errors import SceneError, VolumeError
from clvol.scene import Scene, load_scene


@pytest.fixture
def channels(tmp_path) -> Path:
    """Two channels and three times; the values say which."""
    path = tmp_path / "v.ome.tif"
    array = np.stack(
        [np.stack([voxels("uint8") + 40 * t + c for c in range(2)]) for t in range(3)]
    )
    metadata = dict(axes="TCZYX", Channel={"Name": ["a", "b"]})
    tifffile.imwrite(path, array, metadata=metadata, photometric="minisblack")
    return path


def test_a_scene_file_chooses(tmp_path, channels) -> None:
    scene = tmp_path / "s.toml"
    scene.write_text(f'version = 1\n[volume]\nfile = "{channels.name}"\nchannel = "b"\ntime = 2\n')
    assert np.array_equal(load_scene(scene).load_volume().data, voxels("uint8") + 81)
    again = load_scene(scene, ["volume.time=0", "volume.channel=0"])
    assert np.array_equal(again.load_volume().data, voxels("uint8"))


def test_info_chooses_and_an_error_lists(channels, capsys) -> None:
    assert main(["info", str(channels), "--set", "volume.time=1"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and said.startswith("clvol: error: ")
    assert '2 channels: 0 "a", 1 "b", expected volume.channel = one of them' in said
    options = ["--set", "volume.time=1", "--set", 'volume.channel="b"', "--json"]
    told = json.loads(CliRunner().invoke(info, [str(channels), *options]).output)
    assert told["value_range"] == [43, 168]


def test_info_tells_warnings_on_stderr(tmp_path, capsys) -> None:
    from helpers.slice_files import dicom_series

    dicom_series(tmp_path / "ct", places=[0, 0.3, 0.7, 1.0, 1.3, 1.7])
    assert main(["info", str(tmp_path / "ct"), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["spacing"][2] == pytest.approx(0.34)
    assert err.startswith("clvol: warning: ") and err.count("\n") == 1 and "rounded" in err


@pytest.mark.parametrize("value", [-1, 1.5, True, "", [0], 2**31])
@pytest.mark.parametrize("key", ["channel", "time", "series"])
def test_what_is_no_choice(key, value) -> None:
    with pytest.raises(SceneError, match=f"volume.{key}"):
        Scene(volume={"file": "v.tif", key: value})


def test_a_computed_field_has_no_channels() -> None:
    with pytest.raises(SceneError, match="no channel beside field"):
        Scene(volume={"field": "radial", "size": (4, 4, 4), "channel": 0})


def test_fields_choose_each_for_itself(channels) -> None:
    mask = {"file": str(channels), "role": "mask", "time": 1}
    scene = Scene(
        volume={"file": str(channels), "channel": 0, "time": 0},
        field=[{**mask, "channel": 0}, {**mask, "channel": "b"}],
    )
    first, second = scene.load_fields()
    assert np.array_equal(first.data + 1, second.data) and first.data[0, 0, 0] == 42
    with pytest.raises(VolumeError, match=r"2 channels.*expected field\.0\.channel"):
        Scene(volume=scene.volume, field=[mask]).load_fields()
