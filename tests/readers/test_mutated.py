"""Mutated files, of formats with libraries of their own: read or refused; none crashes, hangs or eats memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import h5py
import imagecodecs
import mrcfile
import netCDF4
import nibabel
import numpy as np
import pytest
import tifffile
import zarr
from helpers import mutated_files
from helpers.slice_files import dicom_series, enhanced, voxels
from pydicom.encaps import encapsulate
from pydicom.uid import JPEG2000Lossless, JPEGLosslessSV1, JPEGLSLossless, RLELossless

COUNT = 100


def good_tiffs(folder: Path) -> None:
    for name, options in {
        "plain": {},
        "deflate": dict(compression="zlib", metadata=None),
        "lzw": dict(compression="lzw", predictor=True),
        "tiles": dict(compression="zstd", tile=(16, 16)),
        "jpeg": dict(compression="jpeg"),
        "imagej": dict(imagej=True, resolution=(2, 2), metadata=dict(spacing=3, unit="um")),
        "ome.ome": dict(metadata=dict(axes="ZYX", PhysicalSizeX=0.5, PhysicalSizeZ=2)),
        "big": dict(bigtiff=True),
    }.items():
        options.setdefault("photometric", "minisblack")
        tifffile.imwrite(folder / f"{name}.tif", voxels("uint8"), **options)
    (folder / "slices").mkdir()
    for k, plane in enumerate(voxels("uint8")):
        tifffile.imwrite(folder / "slices" / f"s{k}.tif", plane)


def good_zarrs(folder: Path) -> None:
    data, v3 = voxels(), zarr.codecs
    for name, codec in {"zstd": v3.ZstdCodec(), "blosc": v3.BloscCodec(), "gzip": v3.GzipCodec()}.items():
        zarr.create_array(
            str(folder / f"{name}.zarr"), data=data, chunks=(3, 4, 4), compressors=codec,
            dimension_names=["z", "y", "x"],
        )  # fmt: skip
    zarr.create_array(str(folder / "shard.zarr"), data=data, chunks=(3, 4, 4), shards=(6, 8, 8))
    zarr.create_array(str(folder / "two.zarr"), data=data, zarr_format=2)
    group = zarr.open_group(str(folder / "ome.zarr"), mode="w", zarr_format=2)
    group.create_array("0", data=data)
    axes = [{"name": n, "type": "space", "unit": "nanometer"} for n in "zyx"]
    scale = {"type": "scale", "scale": [3, 2, 1]}
    group.attrs["multiscales"] = [
        {"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": [scale]}]}
    ]


def good_niftis(folder: Path) -> None:
    for name in ("v.nii", "v.nii.gz", "two.nii"):
        kind = nibabel.Nifti2Image if name == "two.nii" else nibabel.Nifti1Image
        nibabel.save(kind(voxels().transpose(), np.diag([1, 2, 3, 1])), folder / name)


def good_dicoms(folder: Path) -> None:
    dicom_series(folder / "plain")
    array = voxels("uint16")
    places = [(0.0, 0.0, 2.0 * k) for k in range(6)]
    enhanced(folder / "enhanced" / "e.dcm", array, places)
    for syntax, encode in {
        JPEGLosslessSV1: lambda plane: imagecodecs.ljpeg_encode(plane, bitspersample=16),
        JPEGLSLossless: imagecodecs.jpegls_encode,
        JPEG2000Lossless: lambda plane: imagecodecs.jpeg2k_encode(plane, level=0),
    }.items():

        def edit(data, k, encode=encode):
            data.PixelData = encapsulate([encode(np.ascontiguousarray(array[k]))])

        dicom_series(folder / str(syntax), array[:3], edit=edit, syntax=syntax)
    dicom_series(
        folder / "rle", array[:3], edit=lambda data, k: data.compress(RLELossless)
    )


def good_extras(folder: Path) -> None:
    data = voxels()
    with h5py.File(folder / "plain.h5", "w") as file:
        file["data"] = data
    with h5py.File(folder / "packed.h5", "w") as file:
        file.create_dataset("g/data", data=data, chunks=(3, 4, 4), compression="gzip", shuffle=True)
        file["g/data"].attrs["element_size_um"] = [3.0, 2.0, 1.0]
    for name, form in (("classic.nc", "NETCDF3_CLASSIC"), ("four.nc", "NETCDF4")):
        with netCDF4.Dataset(folder / name, "w", format=form) as file:
            for axis, n in zip("zyx", data.shape):
                file.createDimension(axis, n)
                file.createVariable(axis, "f8", (axis,))[:] = np.arange(n)
            file.createVariable("v", "i2", ("z", "y", "x"))[:] = data
    for name, packed in (("m.mrc", None), ("p.map.gz", "gzip")):
        with mrcfile.new(folder / name, data.astype(np.int16), compression=packed) as file:
            file.voxel_size = 2.0


@pytest.mark.parametrize("make", [good_tiffs, good_zarrs, good_niftis, good_dicoms, good_extras])
def test_mutated_files(tmp_path, make) -> None:
    make(tmp_path)
    program = Path(mutated_files.__file__)
    done = subprocess.run(
        [sys.executable, str(program), str(tmp_path), "13", str(COUNT)],
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout)
    assert told["wrong"] == []
    assert told["read"] + told["refused"] == COUNT and min(told["read"], told["refused"]) > 0
    assert told["MiB"] < 500
