"""Zarr of other tools: axes by their names, channels and times by choice, geometry beside arrays."""

from __future__ import annotations

import itertools
import os
from pathlib import Path

import numpy as np
import pytest
import zarr
from slice_files import SHAPE, loaded, refusal, voxels

from clvol.readers import load_volume

LETTERS = "tczyx"
STEPS = {"t": 7.0, "c": 1.0, "z": 3.0, "y": 2.0, "x": 0.5}
MOVED = {"t": 0.0, "c": 0.0, "z": 30.0, "y": 20.0, "x": 10.0}
TYPES = {"t": "time", "c": "channel"}


def whole() -> np.ndarray:
    """[t, c, z, y, x], 3 times and 2 channels."""
    return np.stack([np.stack([voxels() + 500 * t + 200 * c for c in range(2)]) for t in range(3)])


def ordered(axes: str) -> np.ndarray:
    """``whole`` with these axes, of the first time and channel where there are none."""
    array = whole()
    for letter in reversed(LETTERS):
        if letter not in axes:
            array = np.take(array, 0, LETTERS.index(letter))
    left = [letter for letter in LETTERS if letter in axes]
    return np.ascontiguousarray(array.transpose([left.index(letter) for letter in axes]))


def ome(path: Path, axes: str, version: str, array: np.ndarray | None = None, **more) -> Path:
    array = ordered(axes) if array is None else array
    multiscale = {
        "name": "picture",
        "datasets": [
            {
                "path": "0",
                "coordinateTransformations": [
                    {"type": "scale", "scale": [STEPS[a] for a in axes]},
                    {"type": "translation", "translation": [MOVED[a] for a in axes]},
                ],
            }
        ],
    }
    if version == "0.3":
        multiscale["axes"] = list(axes)
    elif version != "0.2":
        multiscale["axes"] = [{"name": a, "type": TYPES.get(a, "space")} for a in axes]
    v3 = version == "0.5"
    group = zarr.open_group(str(path), mode="w", zarr_format=3 if v3 else 2)
    group.create_array("0", data=array, chunks=tuple(min(4, n) for n in array.shape))
    multiscale |= {} if v3 else {"version": version}
    ome = {"multiscales": [multiscale], **more}
    group.attrs.update({"ome": {"version": version, **ome}} if v3 else ome)
    return path


@pytest.mark.parametrize("version", ["0.3", "0.4", "0.5"])
@pytest.mark.parametrize("axes", ["zyx", "xyz", "yzx", "czyx", "tzyx", "tczyx", "zyxc", "xyczt"])
def test_ome_axes_in_any_order(tmp_path, version, axes) -> None:
    path = ome(tmp_path / "v.zarr", axes, version)
    keys = {}
    if "c" in axes:
        assert "2 channels: 0, 1, expected volume.channel" in refusal(path, time=0)
        keys["channel"] = 1
    if "t" in axes:
        assert "3 times: 0, 1, 2, expected volume.time" in refusal(path, channel=0)
        keys["time"] = 2
    volume, warned = loaded(path, **keys)
    expected = voxels() + 200 * keys.get("channel", 0) + 500 * keys.get("time", 0)
    assert np.array_equal(volume.data, expected) and warned == ""
    assert volume.grid.spacing == (0.5, 2, 3) and volume.grid.origin == (10, 20, 30)
    assert np.array_equal(volume.box(1, 4, 2, 7, 3, 5), expected[1:4, 2:7, 3:5])
    for key in keys:
        assert f"volume.{key} = 9" in refusal(path, **{**keys, key: 9})


def test_five_axes_without_names_are_the_oldest_version(tmp_path) -> None:
    path = ome(tmp_path / "v.zarr", "tczyx", "0.2")
    assert np.array_equal(load_volume(path, channel=1, time=1).data, voxels() + 700)


@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_channels_by_their_labels(tmp_path, version) -> None:
    omero = {"channels": [{"label": "nuclei"}, {"label": "Membrane"}]}
    path = ome(tmp_path / "v.zarr", "czyx", version, omero=omero)
    assert '2 channels: 0 "nuclei", 1 "Membrane", expected volume.channel' in refusal(path)
    for name in ("Membrane", "membrane", 1, "1"):
        assert np.array_equal(load_volume(path, channel=name).data, voxels() + 200)
    assert 'volume.channel = "x"' in refusal(path, channel="x")


def test_images_of_a_group_are_series(tmp_path) -> None:
    group = zarr.open_group(str(tmp_path / "v.zarr"), mode="w", zarr_format=2)
    group.attrs["bioformats2raw.layout"] = 3
    for k in (0, 1):
        ome(tmp_path / "v.zarr" / str(k), "zyx", "0.4", voxels() + k)
    zarr.open_group(str(tmp_path / "v.zarr" / "OME"), mode="w", zarr_format=2)
    assert '2 series: 0 "picture", 1 "picture", expected volume.series' in refusal(
        tmp_path / "v.zarr"
    )
    assert np.array_equal(load_volume(tmp_path / "v.zarr", series=1).data, voxels() + 1)


def test_a_plate_says_what_to_open(tmp_path) -> None:
    group = zarr.open_group(str(tmp_path / "v.zarr"), mode="w", zarr_format=2)
    group.attrs["plate"] = {"wells": []}
    assert "plate" in refusal(tmp_path / "v.zarr")


# ---- plain arrays --------------------------------------------------------------------------------


def plain(path: Path, array: np.ndarray, names: list | None, version: int) -> Path:
    if version == 3:
        zarr.create_array(str(path), data=array, dimension_names=names)
    else:
        made = zarr.create_array(str(path), data=array, zarr_format=2)
        if names is not None:
            made.attrs["_ARRAY_DIMENSIONS"] = names
    return path


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("axes", ["".join(p) for p in itertools.permutations("zyx")])
def test_names_of_dimensions_in_any_order(tmp_path, version, axes) -> None:
    volume, _ = loaded(plain(tmp_path / "v.zarr", ordered(axes), list(axes), version))
    assert np.array_equal(volume.data, voxels())


@pytest.mark.parametrize("version", [2, 3])
def test_names_of_other_dimensions(tmp_path, version) -> None:
    names = ["X", "row", "Channel", "time", "plane"]
    path = plain(tmp_path / "v.zarr", ordered("xyctz"), names, version)
    assert np.array_equal(load_volume(path, channel=1, time=2).data, voxels() + 1200)
    assert "volume.channel" in refusal(path, time=0)
    for names in (None, [None] * 3, [None, "y", "x"], ["dim_0", "dim_1", "dim_2"], ["a", "b", "c_"]):
        kept = plain(tmp_path / f"{names}.zarr", voxels(), names, version)
        assert np.array_equal(load_volume(kept).data, voxels())


@pytest.mark.parametrize("names", [["z", "y", "row"], ["x", "q", "r"], ["z", "y", "c"]])
def test_names_that_leave_an_axis_open(tmp_path, names) -> None:
    message = refusal(plain(tmp_path / "v.zarr", voxels(), names, 3))
    assert "axes of length" in message and names[1] in message


@pytest.mark.parametrize("version", [2, 3])
def test_coordinates_beside_an_array(tmp_path, version) -> None:
    """As xarray writes a data set: a group of arrays, those of the coordinates named as dimensions."""
    group = zarr.open_group(str(tmp_path / "v.zarr"), mode="w", zarr_format=version)

    def add(name, data, dims, **attributes):
        if version == 3:
            made = group.create_array(name, data=data, dimension_names=dims)
        else:
            made = group.create_array(name, data=data)
            made.attrs["_ARRAY_DIMENSIONS"] = dims
        made.attrs.update(attributes)

    add("density", ordered("xzy"), ["x", "z", "y"])
    add("x", 10 + 0.5 * np.arange(8), ["x"], units="micrometer")
    add("y", 20 - 2.0 * np.arange(7), ["y"], units="micrometer")
    add("z", 3000 + 4000 * np.arange(6), ["z"], units="nm")
    volume, warned = loaded(tmp_path / "v.zarr")
    assert np.array_equal(volume.data, voxels()) and warned == ""
    assert volume.grid.spacing == (0.5, 2, 4) and volume.grid.origin == (10, 20, 3)
    assert volume.grid.direction.tolist() == [[1, 0, 0], [0, -1, 0], [0, 0, 1]]
    assert volume.unit == "µm"
    add("mask", ordered("xzy"), ["x", "z", "y"])
    assert '2 series: 0 "density", 1 "mask"' in refusal(tmp_path / "v.zarr")
    assert load_volume(tmp_path / "v.zarr", series="mask").shape == SHAPE


def test_uneven_coordinates_are_told(tmp_path) -> None:
    group = zarr.open_group(str(tmp_path / "v.zarr"), mode="w")
    group.create_array("d", data=voxels(), dimension_names=["z", "y", "x"])
    group.create_array("z", data=np.arange(6.0) ** 2, dimension_names=["z"])
    volume, warned = loaded(tmp_path / "v.zarr")
    assert volume.grid.spacing == (1, 1, 1) and "along z are not evenly spaced" in warned


def test_a_path_that_goes_up(tmp_path, monkeypatch) -> None:
    plain(tmp_path / "v.zarr", voxels(), None, 3)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert np.array_equal(load_volume(os.path.join("..", "v.zarr")).data, voxels())
