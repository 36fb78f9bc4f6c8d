"""NRRD and MetaImage files with several channels or times: one is chosen, or all are listed."""

from __future__ import annotations

from pathlib import Path

import nrrd
import numpy as np
import pytest
import SimpleITK

from clvol.errors import VolumeError
from clvol.readers import load_volume

# [t, z, y, x, c]
VOXELS = np.arange(3 * 2 * 4 * 5 * 2, dtype=np.int16).reshape(3, 2, 4, 5, 2)
STEPS = ((0.5, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0))


def listed(path: Path, words: str, **chosen) -> None:
    with pytest.raises(VolumeError, match=words):
        load_volume(path, **chosen)


def expect(volume, voxels: np.ndarray) -> None:
    assert np.array_equal(volume.data, voxels)
    np.testing.assert_allclose(volume.grid.spacing, (0.5, 2.0, 3.0))
    assert volume.grid.origin == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("encoding", ["raw", "gzip", "ascii"])
@pytest.mark.parametrize("place", [0, 1, 2, 3])
@pytest.mark.parametrize("kind, key", [("vector", "channel"), ("list", "channel"), ("time", "time")])
def test_nrrd_with_an_axis_that_is_not_in_space(tmp_path: Path, kind, key, place, encoding) -> None:
    """Of any place among the axes, fastest first."""
    voxels = np.moveaxis(VOXELS[0], -1, 3 - place)
    directions = [*STEPS[:place], (np.nan,) * 3, *STEPS[place:]]
    header = {
        "kinds": ["domain"] * place + [kind] + ["domain"] * (3 - place),
        "space": "LPS",
        "space directions": np.array(directions),
        "space origin": np.array([1.0, 2.0, 3.0]),
        "encoding": encoding,
    }
    path = tmp_path / "v.nrrd"
    nrrd.write(str(path), voxels, header, index_order="C")
    listed(path, rf"2 {key}s: 0, 1, expected volume.{key}")
    listed(path, "among 2", **{key: 2})
    for k in (0, 1):
        expect(load_volume(path, **{key: k}), VOXELS[0, ..., k])
    other = "time" if key == "channel" else "channel"
    listed(path, f"no volume.{other}", **{key: 0, other: 1})


def test_nrrd_colours_by_name_and_directions_alone(tmp_path: Path) -> None:
    rgb = np.stack([VOXELS[0, ..., 0] + k for k in (0, 50, 90)], axis=-1).astype(np.uint8)
    header = {
        "kinds": ["RGB-color", "domain", "domain", "domain"],
        "space": "LPS",
        "space directions": np.array([(np.nan,) * 3, *STEPS]),
        "space origin": np.array([1.0, 2.0, 3.0]),
    }
    path = tmp_path / "v.nrrd"
    nrrd.write(str(path), rgb, header, index_order="C")
    listed(path, '0 "red", 1 "green", 2 "blue"')
    expect(load_volume(path, channel="Green"), rgb[..., 1])
    del header["kinds"]  # which axis has no direction says it, too
    nrrd.write(str(path), rgb, header, index_order="C")
    expect(load_volume(path, channel=2), rgb[..., 2])


def test_nrrd_with_channels_and_times_and_spacings(tmp_path: Path) -> None:
    header = {
        "kinds": ["vector", "domain", "domain", "domain", "time"],
        "spacings": [np.nan, 0.5, 2.0, 3.0, 9.0],
        "axis mins": [np.nan, 0.75, 1.0, 1.5, np.nan],
        "units": ["", "mm", "mm", "mm", "s"],
    }
    path = tmp_path / "v.nrrd"
    nrrd.write(str(path), VOXELS, header, index_order="C")
    listed(path, "2 channels", time=0)
    listed(path, "3 times", channel=0)
    volume = load_volume(path, channel=1, time=2)
    expect(volume, VOXELS[2, ..., 1])
    assert volume.unit == "mm"


def test_nrrd_times_in_a_file_each(tmp_path: Path) -> None:
    for t, volume in enumerate(VOXELS[..., 0]):
        (tmp_path / f"t{t}.raw").write_bytes(volume.tobytes())
    lines = [
        "NRRD0004", "type: short", "dimension: 4", "sizes: 5 4 2 3", "endian: little",
        "encoding: raw", "kinds: domain domain domain time", "spacings: 0.5 2 3 1",
        "axis mins: 0.75 1 1.5 0", "data file: t%d.raw 0 2 1",
    ]  # fmt: skip
    (tmp_path / "v.nhdr").write_text("\n".join(lines) + "\n")
    expect(load_volume(tmp_path / "v.nhdr", time=1), VOXELS[1, ..., 0])


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("ending", [".mha", ".mhd"])
def test_metaimage_channels(tmp_path: Path, ending, compressed) -> None:
    image = SimpleITK.GetImageFromArray(VOXELS[0], isVector=True)
    image.SetSpacing((0.5, 2.0, 3.0))
    image.SetOrigin((1.0, 2.0, 3.0))
    path = tmp_path / f"v{ending}"
    SimpleITK.WriteImage(image, str(path), compressed)
    listed(path, "2 channels: 0, 1, expected volume.channel")
    for k in (0, 1):
        expect(load_volume(path, channel=k), VOXELS[0, ..., k])


@pytest.mark.parametrize("compressed", [False, True])
def test_metaimage_times(tmp_path: Path, compressed) -> None:
    volumes = [SimpleITK.GetImageFromArray(volume) for volume in VOXELS[..., 0].copy()]
    for volume in volumes:
        volume.SetSpacing((0.5, 2.0, 3.0))
        volume.SetOrigin((1.0, 2.0, 3.0))
    path = tmp_path / "v.mha"
    SimpleITK.WriteImage(SimpleITK.JoinSeries(volumes), str(path), compressed)
    listed(path, "3 times: 0, 1, 2, expected volume.time")
    expect(load_volume(path, time=2), VOXELS[2, ..., 0])
    SimpleITK.WriteImage(SimpleITK.JoinSeries(volumes[:1]), str(path), compressed)
    expect(load_volume(path), VOXELS[0, ..., 0])


def test_only_what_is_chosen_comes_into_memory(tmp_path: Path) -> None:
    path = tmp_path / "v.mha"
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(VOXELS[0], isVector=True), str(path))
    assert load_volume(path, channel=1, memory_cap=80).nbytes == 80
    listed(path, "80 bytes", channel=1, memory_cap=79)
