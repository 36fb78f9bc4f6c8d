"""Integers of 32 and 64 bits, bool and float16: narrowed where no value changes, by every reader."""

from __future__ import annotations

from pathlib import Path

import nibabel
import nrrd
import numpy as np
import pytest
import SimpleITK
import tensorstore
import tifffile

import clvol
from clvol.errors import VolumeError
from clvol.readers import load_volume
from clvol.volume import Volume

WIDE = ["int32", "uint32", "int64", "uint64"]
# Values, and the smallest type that holds them all exactly.
FITS = [
    ([0, 255], "uint8"),
    ([-1, 127], "int8"),
    ([-128, 0], "int8"),
    ([0, 256], "uint16"),
    ([65535, 7], "uint16"),
    ([-129, 5], "int16"),
    ([-1, 128], "int16"),
    ([-32768, 32767], "int16"),
    ([-1, 32768], "float32"),
    ([0, 65536], "float32"),
    ([-(2**24), 2**24], "float32"),
    ([0, 2**24 + 1], "float64"),
    ([1, 2**31 - 1], "float64"),
    ([0, 2**30], "float32"),
    ([-(2**31), 1], "float32"),
    ([-(2**31), 2**31 - 1], "float64"),
    ([0, 2**32 - 1], "float64"),
    ([2**53, 1], "float32"),
    ([2**53 - 1, -(2**53)], "float64"),
    ([2**60, 0], "float32"),
    ([2**60 + 2**10, 0], "float64"),
]
EXACT_IN_NONE = [[2**53 + 1, 0], [2**63 - 1, 0], [-(2**63) + 1, 0], [2**64 - 1, 0]]


def cube(values: list[int], dtype: str) -> np.ndarray:
    array = np.zeros((2, 3, 4), dtype)
    array[0, 0, 1], array[1, 2, 3] = values
    return array


def fits(values: list[int], dtype: str) -> bool:
    limits = np.iinfo(dtype)
    return limits.min <= min(values) and max(values) <= limits.max


CASES = [(v, t, w) for v, t in FITS for w in WIDE if fits(v, w)]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("values, kept, wide", CASES)
def test_an_array_gets_the_smallest_exact_type(values, kept, wide, order) -> None:
    array = cube(values, wide).astype(np.dtype(wide).newbyteorder(order))
    for layout in (array, np.asfortranarray(array), array[::-1]):
        volume = Volume(layout)
        assert volume.dtype.name == kept
        assert [int(v) for v in volume.data.ravel()] == [int(v) for v in layout.ravel()]


@pytest.mark.parametrize(
    "values, wide", [(v, w) for v in EXACT_IN_NONE for w in WIDE if fits(v, w)]
)
def test_what_no_type_holds_is_refused_with_a_way_out(values, wide) -> None:
    with pytest.raises(VolumeError, match=r"float64.*numpy.unique"):
        Volume(cube(values, wide))
    held = Volume(cube(values, wide), labels=True).data
    assert held.dtype == np.float64 and np.abs(held).max() == 2.0**53 and held[0, 0, 0] == 0


@pytest.mark.parametrize("order", ["<", ">"])
def test_float16_becomes_float32(order) -> None:
    array = np.array([0.1, np.nan, np.inf, -65504, 6e-8, 2, 3, 4]).astype(f"{order}f2")
    volume = Volume(array.reshape(2, 2, 2))
    assert volume.dtype == np.float32
    np.testing.assert_array_equal(volume.data.ravel(), array.astype(np.float32))


def test_values_are_looked_for_in_every_block() -> None:
    array = np.zeros((3, 1024, 512), np.int64)
    array[2, 1023, 511] = -70000
    assert Volume(array).dtype == np.float32
    array[0, 0, 0] = 2**40 + 1
    assert Volume(array).dtype == np.float64


def write(path: Path, array: np.ndarray) -> dict:
    """Writes the file with another's library; what ``load_volume`` has to be told."""
    kind = path.name.partition(".")[2]
    if kind in ("nrrd", "nhdr"):
        nrrd.write(str(path), array, index_order="C", detached_header=kind == "nhdr")
    elif kind in ("mha", "mhd"):
        SimpleITK.WriteImage(SimpleITK.GetImageFromArray(array), str(path))
    elif kind in ("nii", "nii.gz"):
        nibabel.save(nibabel.Nifti1Image(array.transpose(), np.eye(4), dtype=array.dtype), path)
    elif kind == "tif":
        tifffile.imwrite(path, array, photometric="minisblack")
    elif kind == "npy":
        np.save(path, array)
    elif kind == "raw":
        path.write_bytes(array.tobytes())
        return {"dims": array.shape[::-1], "dtype": array.dtype.str}
    else:
        name = str(array.dtype)
        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": str(path)}}
        store = tensorstore.open(spec, create=True, dtype=name, shape=array.shape).result()
        store.write(array).result()
    return {}


ENDINGS = ["nrrd", "nhdr", "mha", "mhd", "nii", "nii.gz", "tif", "npy", "raw", "zarr"]


@pytest.mark.parametrize("wide", WIDE)
@pytest.mark.parametrize("ending", ENDINGS)
def test_every_reader_narrows(tmp_path: Path, ending, wide) -> None:
    for values, kept in (([0, 200], "uint8"), ([3, 70000], "float32"), ([1, 2**31 - 1], "float64")):
        path = tmp_path / f"v{kept}.{ending}"
        volume = load_volume(path, **write(path, cube(values, wide)))
        assert volume.dtype.name == kept and volume.data.dtype.name == kept
        assert volume.value_range == (0.0, float(max(values)))
        assert np.array_equal(volume.data, cube(values, wide))


@pytest.mark.parametrize("ending", ["npy", "raw", "zarr"])
def test_float16_files(tmp_path: Path, ending) -> None:
    array = np.linspace(-1, 1, 24, dtype=np.float16).reshape(2, 3, 4)
    path = tmp_path / f"v.{ending}"
    volume = load_volume(path, **write(path, array))
    assert volume.dtype == np.float32
    assert np.array_equal(volume.data, array.astype(np.float32))


@pytest.mark.parametrize("ending", ["nrrd", "mha", "nii", "npy", "raw", "zarr"])
def test_label_maps_of_any_integers_are_read(tmp_path: Path, ending) -> None:
    array = cube([7, 2**62 + 1], "int64")
    path = tmp_path / f"v.{ending}"
    options = write(path, array)
    with pytest.raises(VolumeError, match="int64 voxels from 0 to 4611686018427387905"):
        load_volume(path, **options).data
    assert load_volume(path, labels=True, **options).data[0, 0, 1] == 7
    if ending == "raw":
        return
    np.save(tmp_path / "volume.npy", np.full((2, 3, 4), 9, np.uint8))
    scene = clvol.Scene(
        volume=str(tmp_path / "volume.npy"),
        field=[{"file": str(path), "role": "label", "labels": [{"label": 7, "color": [1, 0, 0]}]}],
    ).resolve()
    field = scene.fields[0]
    assert (field.volume.data == 7).sum() == 1 and field.labels.tolist() == [7]


def test_wide_and_narrowed_voxels_together_hold_the_cap(tmp_path: Path) -> None:
    array = cube([1, 2], "int64")  # 192 bytes, narrowed 24 more
    for ending in ("nrrd", "mha", "npy", "zarr"):
        path = tmp_path / f"v.{ending}"
        write(path, array)
        assert load_volume(path, memory_cap=216).data.nbytes == 24
        with pytest.raises(VolumeError, match="216 bytes|192 bytes"):
            load_volume(path, memory_cap=215).data


def test_lazy_voxels_are_narrowed_and_turned_box_by_box(tmp_path: Path) -> None:
    array = cube([3, 200], "int32")
    path = tmp_path / "v.zarr"
    write(path, array)
    volume = load_volume(path, slope=-2.0, offset=1.0)
    assert "data" not in vars(volume) and volume.dtype == np.uint8
    plain, axis = volume.plain
    assert "data" not in vars(plain) and plain.dtype == np.uint8
    assert np.array_equal(axis.values(plain.box(0, 2, 1, 3, 2, 4)), 1.0 - 2.0 * array[:, 1:, 2:])
    assert np.array_equal(axis.values(plain.data), 1.0 - 2.0 * array)
    assert volume.value_range == (-399.0, 1.0)
