"""Every format: type, values, axis order and world position come through unchanged."""

from __future__ import annotations

import bz2
import gzip
import zlib
from pathlib import Path

import nibabel
import numpy as np
import pytest
import SimpleITK
import tifffile

from clvol.readers import load_volume
from clvol.volume import ACCEPTED_TYPES

SHAPE = (3, 4, 5)
MARK = (2, 1, 3)  # z, y, x
MARK_INDEX = np.array([3.0, 1.0, 2.0])
SPACING = np.array([0.5, 2.0, 3.0])
ORIGIN = np.array([10.0, -20.0, 30.0])
# A rotation about z and x, then a flip: no axis stays where it was.
TURN = np.array([[0.0, 0.6, -0.8], [1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])
CARRIERS = ["<", ">"]


def marked(dtype: str) -> np.ndarray:
    """Distinct values with the types' limits among them, and 99 at MARK only."""
    array = np.arange(60).reshape(SHAPE).astype(dtype)
    kind = np.dtype(dtype)
    limits = np.iinfo(kind) if kind.kind in "iu" else np.finfo(kind)
    array[0, 0, 0], array[0, 0, 1] = limits.min, limits.max
    array[MARK] = 99
    return array


def expect(volume, dtype: str, world: np.ndarray) -> None:
    """Type and every value as written, and the marked voxel at its place in the world."""
    assert volume.dtype == np.dtype(dtype) and volume.dtype.isnative
    assert volume.data.flags.c_contiguous
    assert np.array_equal(volume.data, marked(dtype))
    assert volume.data[MARK] == 99
    found = (volume.grid.index_to_world() @ [*MARK_INDEX, 1.0])[:3]
    np.testing.assert_allclose(found, world, rtol=0, atol=1e-5)


def turned(direction: np.ndarray = TURN) -> np.ndarray:
    return ORIGIN + direction @ (SPACING * MARK_INDEX)


def nrrd_header(
    dtype: str, order: str, encoding: str, extra: str = "", geometry: bool = True
) -> str:
    names = {"float32": "float", "float64": "double"}
    vectors = " ".join(
        "(" + ",".join(str(v) for v in TURN[:, k] * SPACING[k]) + ")" for k in range(3)
    )
    where = f"space directions: {vectors}\nspace origin: (10,-20,30)\n"
    return (
        f"NRRD0005\n# comment\ntype: {names.get(dtype, dtype)}\ndimension: 3\nsizes: 5 4 3\n"
        f"{'space: right-anterior-superior' + chr(10) + where if geometry else ''}"
        f"endian: {'big' if order == '>' else 'little'}\nencoding: {encoding}\n{extra}"
    )


def stored(dtype: str, order: str) -> bytes:
    return marked(dtype).astype(np.dtype(dtype).newbyteorder(order)).tobytes()


PACK = {
    "raw": lambda data: data,
    "gzip": gzip.compress,
    "gz": lambda data: gzip.compress(data[:50]) + gzip.compress(data[50:]) + b"\0" * 7,
    "bzip2": bz2.compress,
}


@pytest.mark.parametrize("encoding", PACK)
@pytest.mark.parametrize("order", CARRIERS)
@pytest.mark.parametrize("dtype", ACCEPTED_TYPES)
def test_nrrd_attached(tmp_path: Path, dtype, order, encoding) -> None:
    path = tmp_path / "v.nrrd"
    header = nrrd_header(dtype, order, encoding) + "\n"
    path.write_bytes(header.encode() + PACK[encoding](stored(dtype, order)))
    volume = load_volume(path)
    expect(volume, dtype, turned())
    assert (volume.frame, volume.format, volume.name) == ("RAS", "NRRD", "v")
    assert volume.path == str(path)


@pytest.mark.parametrize("encoding", PACK)
def test_nrrd_detached_with_skips(tmp_path: Path, encoding) -> None:
    """Lines are skipped in the file as stored, bytes in the data as decoded."""
    data = b"one line\nanother\n" + PACK[encoding](b"junk" + stored("int16", ">"))
    (tmp_path / "v.bin").write_bytes(data)
    extra = "line skip: 2\nbyte skip: 4\ndata file: v.bin\n"
    (tmp_path / "v.nhdr").write_text(nrrd_header("int16", ">", encoding, extra))
    expect(load_volume(tmp_path / "v.nhdr"), "int16", turned())


def test_nrrd_data_at_the_end_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "v.bin").write_bytes(b"some header of unknown size" + stored("uint16", "<"))
    extra = "byte skip: -1\ndata file: v.bin\n"
    (tmp_path / "v.nhdr").write_text(nrrd_header("uint16", "<", "raw", extra))
    expect(load_volume(tmp_path / "v.nhdr"), "uint16", turned())


@pytest.mark.parametrize("dtype", ["int8", "uint16", "float32"])
def test_nrrd_text(tmp_path: Path, dtype) -> None:
    text = " ".join(repr(value) for value in marked(dtype).ravel().tolist())
    (tmp_path / "v.nrrd").write_text(nrrd_header(dtype, "<", "ascii") + "\n" + text)
    expect(load_volume(tmp_path / "v.nrrd"), dtype, turned())


@pytest.mark.parametrize(
    "extra, origin",
    [
        ("spacings: 0.5 2 3\n", (0, 0, 0)),
        ("spacings: 0.5 2 3\naxis mins: 1 2 3\ncenterings: node node node\n", (1, 2, 3)),
        ("spacings: 0.5 2 3\naxis mins: 1 2 3\ncenterings: cell cell cell\n", (1.25, 3, 4.5)),
        ("axis mins: 1 2 3\naxis maxs: 3.5 10 12\ncenterings: cell cell cell\n", (1.25, 3, 4.5)),
        ("axis mins: 1 2 3\naxis maxs: 3 8 9\ncenterings: node node node\n", (1, 2, 3)),
    ],
)
def test_nrrd_without_space_directions(tmp_path: Path, extra, origin) -> None:
    header = nrrd_header("int16", "<", "raw", extra, geometry=False) + "\n"
    (tmp_path / "v.nrrd").write_bytes(header.encode() + stored("int16", "<"))
    volume = load_volume(tmp_path / "v.nrrd")
    expect(volume, "int16", np.array(origin) + SPACING * MARK_INDEX)
    assert volume.frame == "index"


def test_nrrd_negative_spacing_is_a_flip(tmp_path: Path) -> None:
    header = nrrd_header("int16", "<", "raw", "spacings: 0.5 -2 3\n", geometry=False) + "\n"
    (tmp_path / "v.nrrd").write_bytes(header.encode() + stored("int16", "<"))
    volume = load_volume(tmp_path / "v.nrrd")
    assert volume.grid.spacing == (0.5, 2.0, 3.0)
    expect(volume, "int16", np.array([0.5, -2.0, 3.0]) * MARK_INDEX)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("ending", [".mha", ".mhd"])
@pytest.mark.parametrize("dtype", ACCEPTED_TYPES)
def test_metaimage_written_by_itk(tmp_path: Path, dtype, ending, compressed) -> None:
    image = SimpleITK.GetImageFromArray(marked(dtype))
    image.SetSpacing(SPACING.tolist())
    image.SetOrigin(ORIGIN.tolist())
    image.SetDirection(TURN.ravel().tolist())
    path = tmp_path / f"v{ending}"
    SimpleITK.WriteImage(image, str(path), compressed)
    volume = load_volume(path)
    expect(volume, dtype, turned())
    assert (volume.frame, volume.format) == ("LPS", "MetaImage")
    # ITK's own idea of where the marked voxel is.
    there = image.TransformIndexToPhysicalPoint([int(n) for n in MARK_INDEX])
    np.testing.assert_allclose(there, turned(), atol=1e-9)


def metaimage(path: Path, data: bytes, **fields: str) -> Path:
    lines = {
        "ObjectType": "Image",
        "NDims": "3",
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "DimSize": "5 4 3",
        "ElementType": "MET_SHORT",
        "ElementDataFile": "LOCAL",
        **fields,
    }
    lines["ElementDataFile"] = lines.pop("ElementDataFile")
    text = "".join(f"{name} = {value}\n" for name, value in lines.items())
    path.write_bytes(text.encode() + data)
    return path


def test_metaimage_big_endian_and_negative_spacing(tmp_path: Path) -> None:
    fields = dict(BinaryDataByteOrderMSB="True", ElementSpacing="0.5 -2 3", Offset="10 -20 30")
    path = metaimage(tmp_path / "v.mha", stored("int16", ">"), **fields)
    expect(load_volume(path), "int16", ORIGIN + np.array([0.5, -2.0, 3.0]) * MARK_INDEX)


@pytest.mark.parametrize("header_size", ["17", "-1"])
def test_metaimage_header_size(tmp_path: Path, header_size) -> None:
    (tmp_path / "v.bin").write_bytes(b"x" * 17 + stored("int16", "<"))
    fields = dict(HeaderSize=header_size, ElementDataFile="v.bin")
    path = metaimage(tmp_path / "v.mhd", b"", **fields)
    expect(load_volume(path), "int16", MARK_INDEX)


def test_metaimage_zlib_and_gzip_streams(tmp_path: Path) -> None:
    for pack in (zlib.compress, gzip.compress):
        path = metaimage(tmp_path / "v.mha", pack(stored("int16", "<")), CompressedData="True")
        expect(load_volume(path), "int16", MARK_INDEX)


@pytest.mark.parametrize("ending", [".nii", ".nii.gz"])
@pytest.mark.parametrize("order", CARRIERS)
@pytest.mark.parametrize("dtype", ACCEPTED_TYPES)
def test_nifti_sform(tmp_path: Path, dtype, order, ending) -> None:
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = TURN * SPACING, ORIGIN
    header = nibabel.Nifti1Header(endianness=order)
    header.set_data_dtype(dtype)
    image = nibabel.Nifti1Image(marked(dtype).transpose(), affine, header)
    image.header.set_slope_inter(1, 0)
    path = tmp_path / f"v{ending}"
    nibabel.save(image, path)
    volume = load_volume(path)
    expect(volume, dtype, turned())
    assert volume.frame == "RAS (aligned)" and volume.name == "v"


@pytest.mark.parametrize("kind", [nibabel.Nifti1Image, nibabel.Nifti2Image])
def test_nifti_qform_with_a_flip(tmp_path: Path, kind) -> None:
    flipped = TURN @ np.diag([1.0, 1.0, -1.0])
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = flipped * SPACING, ORIGIN
    image = kind(marked("int16").transpose(), None)
    image.set_qform(affine, code=1)
    image.set_sform(None, code=0)
    nibabel.save(image, tmp_path / "v.nii")
    volume = load_volume(tmp_path / "v.nii")
    expect(volume, "int16", turned(flipped))
    assert volume.frame == "RAS (scanner)"


def test_nifti_shear_is_kept(tmp_path: Path) -> None:
    affine = np.eye(4)
    affine[:3, :3] = [[1.0, 0.0, 0.5], [0.0, 2.0, 0.25], [0.0, 0.0, 3.0]]
    nibabel.save(nibabel.Nifti1Image(marked("int16").transpose(), affine), tmp_path / "v.nii")
    expect(load_volume(tmp_path / "v.nii"), "int16", affine[:3, :3] @ MARK_INDEX)


@pytest.mark.parametrize(
    "dtype, slope, inter, result",
    [
        ("int16", 0.5, -3.0, "float32"),
        ("uint8", 2.0, 0.0, "float32"),
        ("float32", 1.0, 7.0, "float32"),
        ("float64", 3.0, 0.1, "float64"),
        ("int32", 0.25, 0.0, "float64"),
    ],
)
def test_nifti_scaling_gives_the_scaled_values(tmp_path, dtype, slope, inter, result) -> None:
    array = np.arange(60).reshape(SHAPE).astype(dtype)
    image = nibabel.Nifti1Image(array.transpose(), np.eye(4))
    path = tmp_path / "v.nii"
    nibabel.save(image, path)
    data = bytearray(path.read_bytes())
    data[112:120] = np.array([slope, inter], dtype="<f4").tobytes()  # scl_slope, scl_inter
    path.write_bytes(data)
    volume = load_volume(path)
    assert volume.dtype == np.dtype(result)
    expected = array.astype(float) * float(np.float32(slope)) + float(np.float32(inter))
    assert np.array_equal(volume.data, expected.astype(result))


def test_nifti_trailing_single_axes_are_dropped(tmp_path: Path) -> None:
    image = nibabel.Nifti1Image(marked("int16").transpose()[..., None], np.eye(4))
    nibabel.save(image, tmp_path / "v.nii")
    expect(load_volume(tmp_path / "v.nii"), "int16", MARK_INDEX)


@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize("order", CARRIERS)
@pytest.mark.parametrize("dtype", ACCEPTED_TYPES)
def test_tiff_stack(tmp_path: Path, dtype, order, compression) -> None:
    path = tmp_path / "v.tif"
    options = dict(byteorder=order, compression=compression, photometric="minisblack")
    tifffile.imwrite(path, marked(dtype), **options)
    volume = load_volume(path)
    expect(volume, dtype, MARK_INDEX)
    assert volume.frame == "image"


def test_tiff_pages_one_by_one_without_metadata(tmp_path: Path) -> None:
    path = tmp_path / "V.TIFF"
    with tifffile.TiffWriter(path) as writer:
        for page in marked("uint16"):
            writer.write(page, metadata=None, contiguous=False, photometric="minisblack")
    expect(load_volume(path), "uint16", MARK_INDEX)


def test_tiff_single_page_is_one_slice(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "v.tif", marked("uint8")[1])
    volume = load_volume(tmp_path / "v.tif")
    assert volume.shape == (1, 4, 5)
    assert np.array_equal(volume.data[0], marked("uint8")[1])


def test_tiff_imagej_spacing(tmp_path: Path) -> None:
    path = tmp_path / "v.tif"
    metadata = dict(spacing=3.0, unit="um", axes="ZYX")
    tifffile.imwrite(
        path, marked("uint16"), imagej=True, resolution=(2.0, 0.5), metadata=metadata
    )
    expect(load_volume(path), "uint16", SPACING * MARK_INDEX)


def test_tiff_ome_spacing(tmp_path: Path) -> None:
    path = tmp_path / "v.ome.tif"
    metadata = dict(axes="ZYX", PhysicalSizeX=0.5, PhysicalSizeY=2.0, PhysicalSizeZ=3.0)
    tifffile.imwrite(path, marked("uint16"), ome=True, metadata=metadata)
    expect(load_volume(path), "uint16", SPACING * MARK_INDEX)


def test_tiff_resolution_in_centimetres(tmp_path: Path) -> None:
    path = tmp_path / "v.tif"
    resolution = dict(resolution=(20.0, 5.0), resolutionunit="CENTIMETER")
    tifffile.imwrite(path, marked("uint8"), photometric="minisblack", **resolution)
    assert load_volume(path).grid.spacing == (0.5, 2.0, 0.5)


@pytest.mark.parametrize("order", CARRIERS)
@pytest.mark.parametrize("dtype", ACCEPTED_TYPES)
def test_npy_in_every_layout(tmp_path: Path, dtype, order) -> None:
    array = marked(dtype).astype(np.dtype(dtype).newbyteorder(order))
    for layout in (array, np.asfortranarray(array)):
        np.save(tmp_path / "v.npy", layout)
        expect(load_volume(tmp_path / "v.npy"), dtype, MARK_INDEX)


def test_npy_bool_counts_as_uint8(tmp_path: Path) -> None:
    np.save(tmp_path / "v.npy", marked("uint8") > 40)
    volume = load_volume(tmp_path / "v.npy")
    assert volume.dtype == np.uint8 and volume.value_range == (0.0, 1.0)


def test_npy_is_mapped_not_read(tmp_path: Path) -> None:
    np.save(tmp_path / "v.npy", marked("float32"))
    base = load_volume(tmp_path / "v.npy").data
    while base is not None and not isinstance(base, np.memmap):
        base = base.base
    assert base is not None


@pytest.mark.parametrize("order", CARRIERS)
@pytest.mark.parametrize("dtype", ACCEPTED_TYPES)
def test_raw_with_dims_and_spacing(tmp_path: Path, dtype, order) -> None:
    (tmp_path / "v.raw").write_bytes(stored(dtype, order))
    name = np.dtype(dtype).newbyteorder(order).str
    volume = load_volume(tmp_path / "v.raw", dims=(5, 4, 3), dtype=name, spacing=SPACING)
    expect(volume, dtype, SPACING * MARK_INDEX)


def test_spacing_overrides_and_the_rest_of_the_geometry_stays(tmp_path: Path) -> None:
    header = nrrd_header("int16", "<", "raw") + "\n"
    (tmp_path / "v.nrrd").write_bytes(header.encode() + stored("int16", "<"))
    volume = load_volume(str(tmp_path / "v.nrrd"), spacing=(7, 8, 9))
    expect(volume, "int16", ORIGIN + TURN @ (np.array([7.0, 8.0, 9.0]) * MARK_INDEX))
