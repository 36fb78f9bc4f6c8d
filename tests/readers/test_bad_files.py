"""Every wrong file is one VolumeError that names the path, at once and without other output."""

from __future__ import annotations

import gzip
import os
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import mrcfile
import netCDF4
import nibabel
import numpy as np
import pytest
import SimpleITK
import tifffile

from clvol.errors import VolumeError
from clvol.readers import ENDINGS, load_volume
from clvol.volume.memory import available_memory, show_bytes

VOXELS = np.arange(24, dtype="<i2").reshape(2, 3, 4)


def nrrd(path: Path, data: bytes, **fields: str) -> Path:
    lines = {
        "type": "int16",
        "dimension": "3",
        "sizes": "4 3 2",
        "endian": "little",
        "encoding": "raw",
        **{name.replace("_", " "): value for name, value in fields.items()},
    }
    text = "".join(f"{name}: {value}\n" for name, value in lines.items() if value)
    path.write_bytes(b"NRRD0004\n" + text.encode() + b"\n" + data)
    return path


def metaimage(path: Path, data: bytes, **fields: str) -> Path:
    lines = {"NDims": "3", "DimSize": "4 3 2", "ElementType": "MET_SHORT", **fields}
    lines["ElementDataFile"] = lines.pop("ElementDataFile", "LOCAL")
    text = "".join(f"{name} = {value}\n" for name, value in lines.items())
    path.write_bytes(b"ObjectType = Image\n" + text.encode() + data)
    return path


def nifti(path: Path, shape=(4, 3, 2), dtype="int16", **fields) -> Path:
    """A NIfTI file with header fields set to whatever a liar would write."""
    header = nibabel.Nifti1Header()
    header.set_data_dtype(dtype)
    header.set_data_shape(shape)
    header["vox_offset"], header["magic"] = 352, b"n+1"
    for name, value in fields.items():
        header[name] = value
    whole = header.binaryblock + b"\0" * 4 + VOXELS.tobytes()
    path.write_bytes(gzip.compress(whole) if path.suffix == ".gz" else whole)
    return path


def nifti_pair(path: Path) -> Path:
    """``path`` is the file of the pair to damage, the header or the voxels."""
    packed = path.suffix == ".gz"
    stem = path.name.split(".")[0]
    whole = nifti(path.with_name("pair.nii"), vox_offset=0, magic=b"ni1").read_bytes()
    for ending, data in ((".hdr", whole[:348]), (".img", VOXELS.tobytes())):
        name = stem + ending + (".gz" if packed else "")
        path.with_name(name).write_bytes(gzip.compress(data) if packed else data)
    return path


def refused(path: Path | str, **options) -> str:
    """The message of the VolumeError, which names the path, is one line, and came quickly."""
    start = time.monotonic()
    with pytest.raises(VolumeError) as caught:
        _ = load_volume(path, **options).data  # which some formats read when it is used
    assert time.monotonic() - start < 5.0
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    assert caught.value.exit_status == 2
    assert "Exception thrown" not in message
    return message


OPTIONAL = (".vti", ".czi", ".nd2")


def imaris(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["DataSet/ResolutionLevel 0/TimePoint 0/Channel 0/Data"] = VOXELS
        info = file.create_group("DataSetInfo/Image")
        for k, (key, n) in enumerate(zip("XYZ", VOXELS.shape[::-1])):
            info.attrs[key], info.attrs[f"ExtMin{k}"], info.attrs[f"ExtMax{k}"] = str(n), "0", str(n)


def netcdf(path: Path, form: str) -> None:
    with netCDF4.Dataset(path, "w", format=form) as file:
        for name, n in zip("zyx", VOXELS.shape):
            file.createDimension(name, n)
        file.createVariable("v", "i2", ("z", "y", "x"))[:] = VOXELS


def good(folder: Path, ending: str, needs_reading: bool = True) -> Path:
    """A file with VOXELS; bytes of them alone for an optional format that is not to be read."""
    path = folder / f"v{ending}"
    if ending in (".nrrd", ".nhdr"):
        return nrrd(path, VOXELS.tobytes())
    if ending in (".mha", ".mhd"):
        return metaimage(path, VOXELS.tobytes())
    if ending.startswith(".nii"):
        return nifti(path)
    if ending.startswith((".hdr", ".img")):
        return nifti_pair(path)
    if ending in (".tif", ".tiff"):
        tifffile.imwrite(path, VOXELS, photometric="minisblack")
    elif ending == ".npy":
        np.save(path, VOXELS)
    elif ending in (".h5", ".hdf5", ".he5"):
        with h5py.File(path, "w") as file:
            file["data"] = VOXELS
    elif ending == ".ims":
        imaris(path)
    elif ending in (".nc", ".nc4", ".cdf"):
        netcdf(path, "NETCDF3_CLASSIC" if ending == ".cdf" else "NETCDF4")
    elif ending.startswith((".mrc", ".map", ".rec", ".ccp4")):
        with mrcfile.new(path, VOXELS, compression="gzip" if ending.endswith(".gz") else None) as map_file:
            map_file.voxel_size = 1.0
    elif ending in OPTIONAL and needs_reading:
        pytest.skip(f"{ending} comes with a large extra; its own test writes one where that is installed")
    else:
        path.write_bytes(VOXELS.tobytes())
    return path


def options_for(ending: str) -> dict:
    return dict(dims=(4, 3, 2), dtype="<i2") if ending == ".raw" else {}


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_files_below_are_good_before_they_are_damaged(tmp_path: Path, ending) -> None:
    volume = load_volume(good(tmp_path, ending), **options_for(ending))
    assert np.array_equal(volume.data, VOXELS)


@pytest.mark.parametrize("ending", ENDINGS)
def test_missing_empty_folder_and_unreadable(tmp_path: Path, capfd, ending) -> None:
    options = options_for(ending)
    path = tmp_path / f"v{ending}"
    assert "no such file" in refused(path, **options)
    path.write_bytes(b"")
    assert "empty file" in refused(path, **options)
    path.unlink()
    path.mkdir()
    assert "a folder" in refused(path, **options)
    path.rmdir()
    os.mkfifo(path)
    assert "not a regular file" in refused(path, **options)
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
@pytest.mark.parametrize("ending", ENDINGS)
def test_no_permission(tmp_path: Path, ending) -> None:
    path = good(tmp_path, ending, needs_reading=False)
    path.chmod(0)
    assert "denied" in refused(path, **options_for(ending))


@pytest.mark.parametrize("ending", ENDINGS)
def test_garbage_and_every_truncation(tmp_path: Path, capfd, ending) -> None:
    path, options = good(tmp_path, ending, needs_reading=False), options_for(ending)
    whole = path.read_bytes()
    path.with_name("whole.tif").write_bytes(whole)
    random = np.random.default_rng(1)
    for junk in (b"garbage", b"\0" * 4096, random.bytes(4096), b"\n" * 100, b"NRRD0004\nx"):
        path.write_bytes(junk)
        refused(path, **options)
    # A TIFF may end with tags that say nothing about the voxels: any cut that touches them, then.
    end = len(whole)
    if ending in (".tif", ".tiff"):
        with tifffile.TiffFile(path.with_name("whole.tif")) as file:
            end = max(page.dataoffsets[0] + page.databytecounts[0] for page in file.pages)
    for cut in {1, 3, end // 3, end // 2, end - 9, end - 1}:
        path.write_bytes(whole[:cut])
        refused(path, **options)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("ending", [".nrrd", ".mha", ".nii", ".npy", ".raw", ".nii.gz"])
def test_more_data_than_promised_is_refused(tmp_path: Path, ending) -> None:
    path = good(tmp_path, ending)
    whole = path.read_bytes()
    if ending == ".nii.gz":
        path.write_bytes(gzip.compress(gzip.decompress(whole) + b"xx"))
    else:
        path.write_bytes(whole + b"xx")
    assert "48 bytes" in refused(path, **options_for(ending))


def test_unknown_endings_are_refused_naming_the_known_ones(tmp_path: Path) -> None:
    for name in ("v.xyz", "v", "v.gz"):
        (tmp_path / name).write_bytes(b"data")
        assert ".nrrd" in refused(tmp_path / name)
    (tmp_path / "slice.dcm").write_bytes(b"data")
    assert "not a DICOM file" in refused(tmp_path / "slice.dcm")


def test_what_is_no_path_is_refused() -> None:
    with pytest.raises(VolumeError):
        load_volume(7)
    with pytest.raises(VolumeError):
        load_volume("with\0zero.nrrd")


HUGE = 10**5


@pytest.mark.parametrize(
    "write",
    [
        lambda p: nrrd(p / "v.nrrd", VOXELS.tobytes(), sizes=f"{HUGE} {HUGE} {HUGE}"),
        lambda p: nrrd(
            p / "v.nrrd", gzip.compress(b"x" * 9), sizes=f"{HUGE} {HUGE} {HUGE}", encoding="gzip"
        ),
        lambda p: nrrd(p / "v.nrrd", b"1 2 3", sizes=f"{HUGE} {HUGE} {HUGE}", encoding="text"),
        lambda p: nrrd(p / "v.nrrd", b"BZh9", sizes=f"{HUGE} {HUGE} {HUGE}", encoding="bzip2"),
        lambda p: metaimage(p / "v.mha", VOXELS.tobytes(), DimSize=f"{HUGE} {HUGE} {HUGE}"),
        lambda p: metaimage(
            p / "v.mha", zlib.compress(b"x"), DimSize=f"{HUGE} {HUGE} {HUGE}", CompressedData="True"
        ),
        lambda p: nifti(p / "v.nii", shape=(32767, 32767, 32767)),
        lambda p: nifti(p / "v.nii.gz", shape=(32767, 32767, 32767)),
    ],
)
def test_a_lying_huge_header_is_refused_at_once(tmp_path: Path, write: Callable) -> None:
    refused(write(tmp_path))


def test_a_lying_npy_header_is_refused_at_once(tmp_path: Path) -> None:
    with (tmp_path / "v.npy").open("wb") as file:
        header = {"descr": "<i2", "fortran_order": False, "shape": (HUGE, HUGE, HUGE)}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(VOXELS.tobytes())
    refused(tmp_path / "v.npy")


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_memory_cap_is_compared_with_the_voxels_bytes(tmp_path: Path, ending) -> None:
    path, options = good(tmp_path, ending), options_for(ending)
    assert load_volume(path, memory_cap=48, **options).nbytes == 48
    assert "needs 48 bytes" in refused(path, memory_cap=47, **options)


def test_the_default_cap_is_a_share_of_the_available_memory() -> None:
    assert 1 << 20 < available_memory() < 1 << 50
    assert show_bytes(10_000) == "10000 bytes"
    assert show_bytes(144 << 20) == "144 MiB" and show_bytes(3 << 40) == "3 TiB"


@pytest.mark.parametrize("encoding", ["gzip", "bzip2"])
def test_a_compressed_bomb_stops_at_the_promised_size(tmp_path: Path, encoding) -> None:
    """300 MB of zeros behind a header that promises 48 bytes: not decoded to the end."""
    import bz2

    pack = {"gzip": gzip.compress, "bzip2": bz2.compress}[encoding]
    bomb = pack(bytes(1 << 20)) * (300 if encoding == "gzip" else 20)
    message = refused(nrrd(tmp_path / "v.nrrd", bomb, encoding=encoding))
    assert "more" in message


def test_compressed_data_damaged_inside_are_refused(tmp_path: Path) -> None:
    for encoding, pack in (("gzip", gzip.compress), ("deflate", zlib.compress)):
        data = bytearray(pack(VOXELS.tobytes()))
        data[-6] ^= 0xFF  # in the checksum: every voxel still decodes
        if encoding == "gzip":
            path = nrrd(tmp_path / "v.nrrd", bytes(data), encoding="gzip")
        else:
            data[-2] ^= 0xFF
            path = metaimage(tmp_path / "v.mha", bytes(data), CompressedData="True")
        assert "damaged" in refused(path)


def test_compressed_data_that_are_too_short_are_refused(tmp_path: Path) -> None:
    """ITK itself would leave the rest of the volume uninitialised here."""
    short = VOXELS.tobytes()[:40]
    for path in (
        nrrd(tmp_path / "v.nrrd", gzip.compress(short), encoding="gzip"),
        metaimage(tmp_path / "v.mha", zlib.compress(short), CompressedData="True"),
    ):
        assert "40 bytes" in refused(path)


@pytest.mark.parametrize(
    "fields, word",
    [
        (dict(type="int"), "96 bytes"),
        (dict(type="block"), "uint8, int8"),
        (dict(type=""), "type"),
        (dict(sizes=""), "sizes"),
        (dict(endian=""), "endian"),
        (dict(endian="middle"), "endian"),
        (dict(encoding="hex"), "encoding"),
        (dict(dimension="4", sizes="3 4 1 2"), "4-D"),
        (dict(dimension="2", sizes="12 2"), "2-D"),
        (dict(dimension="4"), "dimension 4"),
        (dict(kinds="RGB-color domain domain"), "RGB"),
        (dict(kinds="vector domain domain"), "vector"),
        (dict(sizes="0 3 2"), "sizes"),
        (dict(sizes="-4 -3 2"), "sizes"),
        (dict(sizes="four 3 2"), ""),
        (dict(spacings="1 0 1"), "spacing"),
        (dict(space_directions="none (1,0,0) (0,1,0)", space="LPS"), "direction"),
        (dict(space_directions="(1,0,0) (1,0,0) (0,0,1)", space="LPS"), "singular"),
        (dict(space_directions="(1,0,0) (0,inf,0) (0,0,1)", space="LPS"), "finite"),
        (dict(space_directions="(1,0) (0,1)", space="LPS"), "direction"),
        (dict(spacings="1 1 1", space_origin="(nan,0,0)"), "origin"),
        (dict(byte_skip="-2"), "byte skip"),
        (dict(data_file="LIST"), "one data file"),
        (dict(data_file="v%03d.raw 1 9 1"), "one data file"),
        (dict(data_file="absent.raw"), "absent.raw"),
    ],
)
def test_wrong_nrrd_headers(tmp_path: Path, capfd, fields, word) -> None:
    assert word in refused(nrrd(tmp_path / "v.nrrd", VOXELS.tobytes(), **fields))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "fields, word",
    [
        (dict(ElementType="MET_INT"), "96 bytes"),
        (dict(ElementType="MET_STRING"), "uint8, int8"),
        (dict(ElementNumberOfChannels="3"), "3 channels: 0, 1, 2"),
        (dict(NDims="5", DimSize="4 3 2 1 1"), "5-D"),
        (dict(NDims="4", DimSize="4 3 2"), "4 sizes"),
        (dict(NDims="4", DimSize="4 3 1 2"), "2 times"),
        (dict(NDims="2", DimSize="12 2"), "2-D"),
        (dict(DimSize="4 -3 2"), "DimSize"),
        (dict(ElementSpacing="1 0 1"), "spacing"),
        (dict(ElementSpacing="1 nan 1"), "spacing"),
        (dict(TransformMatrix="1 0 0 1 0 0 0 0 1"), "singular"),
        (dict(BinaryData="False"), "binary"),
        (dict(ElementDataFile="LIST"), "one data file"),
        (dict(ElementDataFile="absent.raw"), "absent.raw"),
        (dict(HeaderSize="soon"), ""),
    ],
)
def test_wrong_metaimage_headers(tmp_path: Path, capfd, fields, word) -> None:
    assert word in refused(metaimage(tmp_path / "v.mha", VOXELS.tobytes(), **fields))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "fields, word",
    [
        (dict(shape=(4, 3, 2, 2), dtype="uint8"), "2 times: 0, 1, expected volume.time"),
        (dict(shape=(4, 3, 2, 1, 1, 2), dtype="uint8"), "6-D"),
        (dict(dtype=np.dtype([("R", "u1"), ("G", "u1"), ("B", "u1")])), "RGB"),
        (dict(dtype="int32"), "96 bytes"),
        (dict(dtype="complex64"), "complex"),
        (dict(datatype=7777), ""),
        (dict(vox_offset=16), "vox_offset"),
        (dict(magic=b"ni1"), "single-file"),
        (dict(sform_code=1, srow_x=[1, 1, 0, 0], srow_z=[0, 0, 1, 0]), "singular"),
        (dict(sform_code=1, srow_x=[np.nan, 1, 0, 0]), "finite"),
        (dict(pixdim=[1, 0, 1, 1, 1, 1, 1, 1]), "spacing"),
        (dict(scl_slope=2.0, scl_inter=np.inf), ""),
    ],
)
def test_wrong_nifti_headers(tmp_path: Path, capfd, fields, word) -> None:
    fields = dict(fields)
    if "srow_x" in fields and "nan" not in str(fields["srow_x"]):
        fields["srow_y"] = [0, 0, 0, 0]
    assert word in refused(nifti(tmp_path / "v.nii", **fields))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "array, options, word",
    [
        (np.zeros((4, 5, 3), "u1"), dict(photometric="rgb"), 'channels: 0 "red"'),
        (np.zeros((2, 4, 5, 3), "u1"), dict(photometric="rgb"), "volume.channel"),
        (np.zeros((2, 3, 4, 5), "u1"), dict(imagej=True, metadata=dict(axes="TZYX")), "2 times"),
        (np.zeros((2, 4, 5), "u2"), dict(imagej=True, metadata=dict(axes="CYX")), "2 channels"),
        (np.zeros((2, 3, 4, 5), "u1"), dict(photometric="minisblack"), "axes QQYX"),
        (np.full((2, 4, 5), 2**63 - 1, "i8"), dict(photometric="minisblack"), "int64 voxels"),
        (np.zeros((2, 4, 5), "c8"), dict(photometric="minisblack"), "complex"),
    ],
)
def test_wrong_tiffs(tmp_path: Path, capfd, array, options, word) -> None:
    tifffile.imwrite(tmp_path / "v.tif", array, **options)
    assert word in refused(tmp_path / "v.tif")
    assert capfd.readouterr() == ("", "")


def test_tiff_pages_of_different_sizes_are_refused(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "v.tif") as writer:
        writer.write(np.zeros((4, 5), "u1"))
        writer.write(np.zeros((3, 5), "u1"))
    assert "2 series: 0 (4 x 5, YX), 1 (3 x 5, YX)" in refused(tmp_path / "v.tif")


def test_tiff_with_a_broken_chain_of_pages_is_refused_not_cropped(tmp_path: Path, capfd) -> None:
    path = tmp_path / "v.tif"
    with tifffile.TiffWriter(path) as writer:
        for page in VOXELS:
            writer.write(page, metadata=None, contiguous=False, photometric="minisblack")
    with tifffile.TiffFile(path) as file:
        second = file.pages[1].offset
    whole = path.read_bytes()
    for cut in (second, second + 1, second + 40):
        path.write_bytes(whole[:cut])
        refused(path)
    assert capfd.readouterr() == ("", "")


def test_tiff_compressed_pages_cut_or_damaged_are_refused(tmp_path: Path, capfd) -> None:
    path = tmp_path / "v.tif"
    noise = np.random.default_rng(2).integers(0, 255, (3, 40, 50), dtype="u1")
    tifffile.imwrite(path, noise, compression="zlib", photometric="minisblack", metadata=None)
    whole = path.read_bytes()
    with tifffile.TiffFile(path) as file:
        at, count = file.pages[1].dataoffsets[0], file.pages[1].databytecounts[0]
    path.write_bytes(whole[:at] + b"\xff" * count + whole[at + count :])
    refused(path)
    # A valid stream that decodes to half a page.
    half = zlib.compress(noise[1, :20].tobytes())
    path.write_bytes(whole[:at] + half.ljust(count, b"\0") + whole[at + count :])
    refused(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "array, word",
    [
        (np.zeros((2, 3, 4, 3), "u1"), "4-D"),
        (np.zeros((3, 4), "u1"), "2-D"),
        (np.full((2, 3, 4), 2**64 - 1, "u8"), "uint64 voxels"),
        (np.zeros((2, 3, 4), "c16"), "complex"),
        (np.zeros((2, 3, 4), [("r", "u1"), ("g", "u1")]), "vector"),
        (np.zeros((2, 0, 4), "u1"), ""),
        (np.array([[[None]]]), ""),
    ],
)
def test_wrong_npy_arrays(tmp_path: Path, array, word) -> None:
    np.save(tmp_path / "v.npy", array)
    assert word in refused(tmp_path / "v.npy")


def test_an_npz_named_npy_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "v.npz", a=VOXELS)
    (tmp_path / "v.npz").rename(tmp_path / "v.npy")
    assert "npz" in refused(tmp_path / "v.npy")


@pytest.mark.parametrize(
    "options",
    [
        dict(),
        dict(dims=(4, 3, 2)),
        dict(dtype="<i2"),
        dict(dims=(4, 3), dtype="<i2"),
        dict(dims=(4, 3, 3), dtype="<i2"),
        dict(dims=(4, 3, 1), dtype="<i2"),
        dict(dims=(4, 3, 0), dtype="<i2"),
        dict(dims=(-4, -3, 2), dtype="<i2"),
        dict(dims=(4.5, 3, 2), dtype="<i2"),
        dict(dims=(1, 3, 2), dtype="<c8"),
        dict(dims=(4, 3, 2), dtype="<i2", header_bytes=1),
        dict(dims=(4, 3, 2), dtype="<i2", header_bytes=-2),
        dict(dims=(4, 3, 2), dtype="<i2", header_bytes=2**70),
        dict(dims=(4, 3, 2), dtype="<i2", byte_order="big"),
        dict(dims=(4, 3, 2), dtype="<i2", byte_order="middle"),
        dict(dims=(4, 3, 2), dtype="no type"),
        dict(dims=(4, 3, 2), dtype="O"),
        dict(dims=(4, 3, 2), dtype="<i2", spacing=(1, 0, 1)),
        dict(dims=(4, 3, 2), dtype="<i2", spacing=(1, 1)),
    ],
)
def test_wrong_raw_descriptions(tmp_path: Path, options) -> None:
    refused(good(tmp_path, ".raw"), **options)


def test_dims_and_dtype_belong_to_raw_files_alone(tmp_path: Path) -> None:
    assert ".raw" in refused(good(tmp_path, ".nrrd"), dims=(4, 3, 2))


def test_itk_itself_finds_the_good_metaimage_good(tmp_path: Path) -> None:
    """So that the damaged ones above are wrong for the reason stated."""
    image = SimpleITK.ReadImage(str(good(tmp_path, ".mha")))
    assert np.array_equal(SimpleITK.GetArrayFromImage(image), VOXELS)
