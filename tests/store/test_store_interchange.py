"""Other tools open what clvol store writes, and clvol opens what they write."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from clvol.errors import VolumeError
from clvol.readers import load_volume
from clvol.store.build import build_store
from clvol.store.codecs import CODECS
from clvol.volume import Grid, Volume

zarr = pytest.importorskip("zarr")

DATA = np.random.default_rng(3).integers(0, 900, (20, 33, 41)).astype(np.int16)


@pytest.mark.parametrize("codec", CODECS)
def test_zarr_python_reads_every_level_and_statistic(tmp_path, codec):
    store = build_store(Volume(DATA), tmp_path / "s.zarr", shard=32, codec=codec)
    group = zarr.open_group(str(tmp_path / "s.zarr"), mode="r")
    for level in range(5):
        found = group[str(level)]
        assert found.metadata.dimension_names == ("z", "y", "x")
        np.testing.assert_array_equal(found[:], store.volume_level(level))
    part = next(store.statistics())
    np.testing.assert_array_equal(group["blocks/minimum"][:].reshape(5, -1), part.minimum)
    np.testing.assert_array_equal(group["blocks/quantiles"][:].reshape(5, -1, 8), part.quantiles)


def test_the_metadata_are_ome_zarr(tmp_path):
    models = pytest.importorskip("ome_zarr_models.v05")
    build_store(Volume(DATA, (0.5, 1, 2), (7, 8, 9)), tmp_path / "s.zarr", shard=32)
    image = models.Image.from_zarr(zarr.open_group(str(tmp_path / "s.zarr"), mode="r"))
    (multiscale,) = image.attributes.ome.multiscales
    assert [dataset.path for dataset in multiscale.datasets] == ["0", "1", "2", "3", "4"]


def test_samples_of_all_levels_are_where_they_belong(tmp_path):
    """OME-Zarr's position of a level's sample is the mean of its voxels' positions."""
    grid = Grid((32, 32, 32), (0.5, 1, 2), (7, 8, 9))
    build_store(Volume(np.zeros(grid.shape, np.uint8), grid.spacing, grid.origin), tmp_path / "s")
    root = json.loads((tmp_path / "s/zarr.json").read_text())
    (multiscale,) = root["attributes"]["ome"]["multiscales"]
    for level, dataset in enumerate(multiscale["datasets"]):
        scale, shift = (
            np.array(step[step["type"]]) for step in dataset["coordinateTransformations"]
        )
        voxels = np.arange(2**level)
        for axis, name in enumerate("zyx"):
            k = "xyz".index(name)
            centre = grid.origin[k] + grid.spacing[k] * voxels.mean()
            assert shift[axis] == pytest.approx(centre)
            assert scale[axis] == pytest.approx(grid.spacing[k] * 2**level)


# ---- stores as volumes ---------------------------------------------------------------------------


@pytest.fixture
def store(tmp_path) -> Path:
    direction = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    build_store(
        Volume(DATA, (0.5, 1, 2), (7, 8, 9), direction, frame="RAS"), tmp_path / "v", shard=32
    )
    return tmp_path / "v"


def test_a_store_is_a_volume_that_loads_when_asked_for(store):
    loaded = load_volume(store)
    assert (loaded.format, loaded.path, loaded.name, loaded.frame) == (
        "OME-Zarr",
        str(store),
        "v",
        "RAS",
    )
    assert (loaded.shape, loaded.dtype, loaded.nbytes) == (DATA.shape, DATA.dtype, DATA.nbytes)
    assert (
        loaded.value_range == (DATA.min(), DATA.max()) and loaded.nan_count == loaded.inf_count == 0
    )
    assert repr(loaded) == "<Volume 'v' 41 x 33 x 20 int16>"
    assert "data" not in vars(loaded)  # nothing of this has read voxels
    np.testing.assert_array_equal(loaded.data, DATA)
    assert not loaded.data.flags.writeable and loaded.data.flags.c_contiguous


def test_another_spacing_is_also_that_of_the_blocks(store):
    loaded = load_volume(store, spacing=(1, 1, 3))
    assert loaded.grid.spacing == loaded.blocks_source.grid.spacing == (1, 1, 3)
    assert loaded.grid.origin == (7, 8, 9)


def test_the_memory_cap_holds_when_voxels_are_read(store):
    loaded = load_volume(store, memory_cap=1000)
    with pytest.raises(VolumeError, match="memory cap"):
        loaded.data  # noqa: B018
    assert loaded.blocks_source.read(4, np.array([0])).shape == (1, 1, 1, 1)


def test_a_store_of_a_store_is_the_same(store, tmp_path):
    loaded = load_volume(store)
    again = build_store(loaded, tmp_path / "w", shard=48)
    assert "data" not in vars(loaded)
    assert again.grid == loaded.grid
    np.testing.assert_array_equal(again.volume_level(0), DATA)


# ---- other people's ------------------------------------------------------------------------------


def image(
    path: Path, data: np.ndarray, axes, version: str = "0.5", steps=(), more=(), chunks=None
) -> Path:
    """An OME-Zarr image of one level."""
    group = zarr.open_group(str(path), mode="w", zarr_format=3 if version == "0.5" else 2)
    group.create_array("full", data=data, chunks=chunks or data.shape)
    multiscale = {
        "axes": axes,
        "datasets": [{"path": "full", "coordinateTransformations": list(steps)}],
    }
    if more:
        multiscale["coordinateTransformations"] = list(more)
    ome = {"version": "0.5", "multiscales": [multiscale]}
    older = {"multiscales": [{"version": version, **multiscale}]}
    group.attrs.update({"ome": ome} if version == "0.5" else older)
    return path


ZYX = [{"name": n, "type": "space"} for n in "zyx"]
TCZYX = [{"name": "t", "type": "time"}, {"name": "c", "type": "channel"}, *ZYX]


@pytest.mark.parametrize("version", ("0.4", "0.5"))
def test_an_ome_zarr_image(tmp_path, version):
    steps = [
        {"type": "scale", "scale": [3, 2, 1]},
        {"type": "translation", "translation": [30, 20, 10]},
    ]
    path = image(
        tmp_path / "v.zarr",
        DATA,
        ZYX,
        version,
        steps,
        [{"type": "scale", "scale": [2, 2, 2]}],
        (8, 8, 8),
    )
    loaded = load_volume(path)
    assert (loaded.grid.spacing, loaded.grid.origin) == ((2, 4, 6), (20, 40, 60))
    assert (loaded.name, loaded.frame, loaded.dtype) == ("v", "image", DATA.dtype)
    np.testing.assert_array_equal(loaded.data, DATA)
    np.testing.assert_array_equal(loaded.box(3, 5, 0, 9, 7, 30), DATA[3:5, :9, 7:30])
    assert loaded.value_range == (DATA.min(), DATA.max())


def test_axes_of_length_one_are_left_out_and_others_are_chosen_from(tmp_path):
    loaded = load_volume(image(tmp_path / "a.zarr", DATA[None, None], TCZYX, "0.4"))
    np.testing.assert_array_equal(loaded.data, DATA)
    with pytest.raises(VolumeError, match="2 channels: 0, 1, expected volume.channel"):
        load_volume(image(tmp_path / "b.zarr", np.stack([DATA, DATA])[None], TCZYX))


def test_axes_are_found_by_their_names(tmp_path):
    axes = [{"name": n, "type": "space"} for n in "xyz"]
    steps = [{"type": "scale", "scale": [1, 2, 3]}]
    loaded = load_volume(
        image(tmp_path / "v.zarr", DATA.transpose(2, 1, 0).copy(), axes, steps=steps)
    )
    assert loaded.grid.spacing == (1, 2, 3)
    np.testing.assert_array_equal(loaded.data, DATA)
    flat = load_volume(image(tmp_path / "w.zarr", DATA[0], axes[1::-1]))
    np.testing.assert_array_equal(flat.data, DATA[:1])


@pytest.mark.parametrize("zarr_format", (2, 3))
@pytest.mark.parametrize("dtype", ("bool", "uint8", "int16", "float64"))
def test_a_plain_array(tmp_path, zarr_format, dtype):
    data = (DATA > 450) if dtype == "bool" else DATA.astype(dtype)
    zarr.create_array(str(tmp_path / "v"), data=data, chunks=(8, 16, 16), zarr_format=zarr_format)
    loaded = load_volume(tmp_path / "v")
    assert loaded.dtype == (np.uint8 if dtype == "bool" else data.dtype)
    np.testing.assert_array_equal(loaded.data, data)
    store = build_store(loaded, tmp_path / "s", shard=32)
    np.testing.assert_array_equal(store.volume_level(0), data)


@pytest.mark.parametrize("dtype", ("uint32", "int64", "float16"))
def test_wide_types_are_stored_narrowed(tmp_path, dtype):
    zarr.create_array(str(tmp_path / "v"), data=DATA.astype(dtype), chunks=(8, 16, 16))
    kept = "float32" if dtype == "float16" else "uint16"
    store = build_store(load_volume(tmp_path / "v"), tmp_path / "s", shard=32)
    assert store.dtype == kept
    np.testing.assert_array_equal(store.volume_level(0), DATA)


@pytest.mark.parametrize("dtype", ("complex64", "complex128"))
def test_types_that_are_no_voxels_are_refused(tmp_path, dtype):
    zarr.create_array(str(tmp_path / "v"), data=DATA.astype(dtype))
    with pytest.raises(VolumeError, match="expected"):
        load_volume(tmp_path / "v")


def test_what_is_no_image_is_one_line(tmp_path):
    group = zarr.open_group(str(tmp_path / "g.zarr"), mode="w")
    group.create_array("curve", data=DATA[0, 0])
    zarr.create_array(str(tmp_path / "flat"), data=DATA[0])
    zarr.create_array(str(tmp_path / "many"), data=np.zeros((2, 2, 3, 4), np.uint8))
    (tmp_path / "file.zarr").write_text("x")
    image(tmp_path / "lost.zarr", DATA, ZYX)
    shutil.rmtree(tmp_path / "lost.zarr" / "full")
    image(tmp_path / "turned.zarr", DATA, ZYX, steps=[{"type": "affine", "affine": []}])
    image(tmp_path / "axes.zarr", DATA, ZYX[1:])
    image(tmp_path / "flatter.zarr", DATA, ZYX, steps=[{"type": "scale", "scale": [0, 1, 1]}])
    (tmp_path / "bad.zarr").mkdir()
    (tmp_path / "bad.zarr" / "zarr.json").write_text("{")
    for path in tmp_path.iterdir():
        with pytest.raises(VolumeError) as error:
            load_volume(path)
        assert "\n" not in str(error.value) and error.value.where == str(path)


def test_a_damaged_chunk_is_one_line(tmp_path):
    path = image(tmp_path / "v.zarr", DATA, ZYX)
    chunk = path / "full/c/0/0/0"
    chunk.write_bytes(chunk.read_bytes()[:50])
    with pytest.raises(VolumeError) as error:
        load_volume(path).data  # noqa: B018
    assert "\n" not in str(error.value)
