"""MetaImage as ITK writes and reads it, and headers that end ITK's own reader."""

from __future__ import annotations

import itertools
import os
import zlib
from pathlib import Path

import numpy as np
import pytest
import SimpleITK

from clvol.errors import VolumeError
from clvol.readers import load_volume

VOXELS = np.arange(2 * 3 * 4, dtype="<i2").reshape(2, 3, 4)
FIELDS = {
    "ObjectType": "Image",
    "NDims": "3",
    "DimSize": "4 3 2",
    "ElementSpacing": "0.5 2 3",
    "Offset": "10 -20 30",
    "ElementType": "MET_SHORT",
}


def write(path: Path, data: bytes = VOXELS.tobytes(), **changed: str | None) -> Path:
    fields = FIELDS | {"ElementDataFile": "LOCAL"} | changed
    last = fields.pop("ElementDataFile")
    lines = [f"{name} = {value}\n" for name, value in fields.items() if value is not None]
    path.write_bytes("".join([*lines, f"ElementDataFile = {last}\n"]).encode() + data)
    return path


def expect(path: Path, voxels: np.ndarray = VOXELS) -> None:
    volume = load_volume(path)
    assert np.array_equal(volume.data, voxels)
    assert volume.grid.spacing == (0.5, 2.0, 3.0) and volume.grid.origin == (10.0, -20.0, 30.0)
    assert volume.frame == "LPS"


def refused(path: Path) -> str:
    with pytest.raises(VolumeError) as caught:
        load_volume(path)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


METADATA = {
    "0008|0060": "CT",
    "0010|0010": "Müller^Jörg",
    "0010|4000": "two\nlines = of text",
    "0018|0050": "",
    "ITK_InputFilterName": "NrrdImageIO",
    "NRRD_kinds[0]": "domain",
    "Modality": "MET_MOD_CT",
    "a key with blanks": "x : y = z",
    "offset": "seven",
    "dimsize": "none",
    "Comment": "DimSize = 1 1 1",
    "long" * 200: "value" * 2000,
}
TYPES = ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"]


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("ending", [".mha", ".mhd"])
@pytest.mark.parametrize("compressed", [False, True])
def test_what_simpleitk_writes_with_metadata(tmp_path: Path, dtype, ending, compressed) -> None:
    voxels = (np.arange(24).reshape(2, 3, 4) * 5 - (0 if "u" in dtype else 60)).astype(dtype)
    image = SimpleITK.GetImageFromArray(voxels)
    turn = np.array([[0.0, 0.6, -0.8], [1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])
    image.SetSpacing((0.5, 2.0, 3.0))
    image.SetOrigin((10.0, -20.0, 30.0))
    image.SetDirection(turn.ravel().tolist())
    for key, value in METADATA.items():
        image.SetMetaData(key, value)
    path = tmp_path / f"v{ending}"
    SimpleITK.WriteImage(image, str(path), compressed)
    volume = load_volume(path)
    assert np.array_equal(volume.data, voxels)
    np.testing.assert_allclose(volume.grid.spacing, (0.5, 2.0, 3.0))
    there = image.TransformIndexToPhysicalPoint([3, 1, 1])
    np.testing.assert_allclose((volume.grid.index_to_world() @ [3, 1, 1, 1])[:3], there, atol=1e-9)


def test_fields_in_any_order(tmp_path: Path) -> None:
    for order in list(itertools.permutations(FIELDS))[::97]:
        path = tmp_path / "v.mha"
        text = "".join(f"{name} = {FIELDS[name]}\n" for name in order)
        path.write_bytes(text.encode() + b"ElementDataFile = LOCAL\n" + VOXELS.tobytes())
        expect(path)


@pytest.mark.parametrize("end", ["\r\n", " \n"])
@pytest.mark.parametrize("between", ["=", " =", "= ", "\t=\t"])
def test_blanks_and_line_ends(tmp_path: Path, between, end) -> None:
    fields = FIELDS | {"ElementDataFile": "LOCAL"}
    text = "".join(f"{name}{between}{value}{end}" for name, value in fields.items())
    (tmp_path / "v.mha").write_bytes(text.encode() + VOXELS.tobytes())
    expect(tmp_path / "v.mha")


@pytest.mark.parametrize(
    "fields",
    [
        {"Offset": None, "Position": "10 -20 30"},
        {"Offset": None, "Origin": "10 -20 30"},
        {"ElementSpacing": None, "ElementSize": "0.5 2 3"},
        {"ElementSize": "9 9 9"},
        {"AnatomicalOrientation": "LPI", "CenterOfRotation": "1 2 3", "DistanceUnits": "mm"},
        {"ObjectType": None},
        {"ID": "7", "ParentID": "-1", "Color": "1 1 1 1", "Name": "größe", "ElementNBits": "16"},
        {"TransformMatrix": "1 0 0 0 1 0 0 0 1", "HeaderSize": "0"},
    ],
)
def test_other_names_and_fields(tmp_path: Path, fields) -> None:
    expect(write(tmp_path / "v.mha", **fields))


@pytest.mark.parametrize("matrix", ["TransformMatrix", "Rotation", "Orientation"])
def test_the_matrix_has_an_axis_a_row_as_itk_has_it(tmp_path: Path, matrix) -> None:
    path = write(tmp_path / "v.mha", **{matrix: "0 1 0 -0.6 0 0.8 0.8 0 0.6"})
    image = SimpleITK.ReadImage(str(path))
    there = image.TransformIndexToPhysicalPoint([3, 1, 1])
    grid = load_volume(path).grid
    np.testing.assert_allclose((grid.index_to_world() @ [3, 1, 1, 1])[:3], there, atol=1e-9)


@pytest.mark.parametrize("name", ["BinaryDataByteOrderMSB", "ElementByteOrderMSB"])
@pytest.mark.parametrize("word", ["True", "true", "T", "1", "yes"])
def test_big_endian_voxels(tmp_path: Path, name, word) -> None:
    expect(write(tmp_path / "v.mha", VOXELS.astype(">i2").tobytes(), **{name: word}))


def test_numbers_as_text(tmp_path: Path) -> None:
    text = "\n".join(map(str, VOXELS.ravel())).encode()
    expect(write(tmp_path / "v.mha", text, BinaryData="False"))


NAMES = ["größe.raw", "scan 100%.raw", "50% x 3.raw", "スキャン.raw", "%d.raw", "a b.raw", "LISTED.raw"]


@pytest.mark.parametrize("name", NAMES)
def test_data_files_of_any_name(tmp_path: Path, name) -> None:
    (tmp_path / name).write_bytes(VOXELS.tobytes())
    expect(write(tmp_path / "v.mhd", b"", ElementDataFile=name))


@pytest.mark.parametrize("where", ["header", "disk", "both"])
def test_names_that_are_not_utf8(tmp_path: Path, where) -> None:
    latin, utf = ("größe.raw".encode(code) for code in ("latin-1", "utf-8"))
    with open(os.fsencode(tmp_path) + b"/" + (utf if where == "header" else latin), "wb") as file:
        file.write(VOXELS.tobytes())
    path = write(tmp_path / "v.mhd", b"", ElementDataFile="NAME")
    path.write_bytes(path.read_bytes().replace(b"NAME", utf if where == "disk" else latin))
    expect(path)


def test_a_header_whose_own_name_is_not_utf8(tmp_path: Path) -> None:
    place = os.fsdecode(os.fsencode(tmp_path) + b"/v\xff.mha")
    expect(write(Path(place)))


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize(
    "data_file, names",
    [
        ("LIST\nb.raw\na b.raw\n", ["b.raw", "a b.raw"]),
        ("LIST 2\nb.raw\na.raw", ["b.raw", "a.raw"]),
        ("LIST 3\nall.raw", ["all.raw"]),
        ("LIST 1\n" + "\n".join("fedcba"), list("fedcba")),
        ("s%d.raw", ["s1.raw", "s2.raw"]),
        ("s%d.raw 5", ["s5.raw", "s6.raw"]),
        ("s%03d.raw 7 8", ["s007.raw", "s008.raw"]),
        ("s%03d.raw 7 9 2", ["s007.raw", "s009.raw"]),
        ("größe %d.raw 1 2 1", ["größe 1.raw", "größe 2.raw"]),
    ],
)
def test_volumes_over_several_files(tmp_path: Path, data_file, names, compressed) -> None:
    for name, part in zip(names, np.split(VOXELS.reshape(-1), len(names))):
        data = part.tobytes()
        (tmp_path / name).write_bytes(zlib.compress(data) if compressed else data)
    said = {"CompressedData": str(compressed), "ElementDataFile": data_file}
    expect(write(tmp_path / "v.mhd", b"", **said))


def test_header_size_of_every_file(tmp_path: Path) -> None:
    for name, part in zip(("1", "2"), VOXELS):
        (tmp_path / name).write_bytes(b"junk" + part.tobytes())
    (tmp_path / "all").write_bytes(b"junk" + VOXELS.tobytes())
    for size in ("4", "-1"):
        for data_file in ("all", "%d 1 2 1", "LIST\n1\n2"):
            expect(write(tmp_path / "v.mhd", b"", HeaderSize=size, ElementDataFile=data_file))


@pytest.mark.parametrize(
    "fields, wrong",
    [
        ({"NDims": None}, "no NDims"),
        ({"NDims": "-1"}, "-1-D"),
        ({"NDims": "100"}, "100-D"),
        ({"NDims": "9" * 400}, "NDims = 999"),
        ({"NDims": "x" * 5000}, "NDims = xxx"),
        ({"DimSize": None}, "no DimSize"),
        ({"DimSize": "4 3"}, "DimSize = 4 3"),
        ({"DimSize": "4 3 ²"}, "DimSize"),
        ({"DimSize": "9999999999 1 1"}, "DimSize"),
        ({"ElementType": None}, "no ElementType"),
        ({"ElementType": "MET_SHORT_ARRAY", "ElementNumberOfChannels": "2"}, "2 channels: 0, 1"),
        ({"ElementNumberOfChannels": "0"}, "0 channel"),
        ({"ObjectType": "Tube"}, "ObjectType = Tube"),
        ({"Offset": "1 2"}, "Offset = 1 2"),
        ({"TransformMatrix": "1 0 0"}, "TransformMatrix = 1 0 0"),
        ({"HeaderSize": "-2"}, "HeaderSize = -2"),
        ({"HeaderSize": "-1", "DimSize": "4 3 3"}, "48 bytes of voxel data, expected 72"),
        ({"ElementDataFile": "LIST"}, "2 in all"),
        ({"ElementDataFile": "s%d.raw 1 9"}, "9 data files"),
        ({"ElementDataFile": "n" * 5000}, "missing"),
        ({"ElementDataFile": "%d" * 9}, "missing"),
        ({"ElementDataFile": ""}, "missing"),
        ({"CompressedData": "True", "CompressedDataSize": "999"}, "999 bytes"),
        ({"ElementToIntensityFunctionSlope": "0"}, "Slope = 0"),
    ],
)
def test_headers_that_are_wrong_are_told_and_end_nothing(tmp_path: Path, fields, wrong) -> None:
    data = b"" if "LIST" in str(fields) else VOXELS.tobytes()
    assert wrong in refused(write(tmp_path / "v.mha", data, **fields))


def test_a_slope_and_an_offset_of_the_header_label_the_values(tmp_path: Path) -> None:
    said = {"ElementToIntensityFunctionSlope": "2", "ElementToIntensityFunctionOffset": "-5"}
    path = write(tmp_path / "v.mha", **said)
    volume = load_volume(path)
    expect(path)
    assert volume.dtype == np.int16 and volume.value_range == (-5.0, 41.0)
    assert load_volume(path, slope=-1.0, offset=1.0).value_range == (-40.0, 6.0)


def test_the_unit_of_distance_is_named(tmp_path: Path) -> None:
    assert load_volume(write(tmp_path / "v.mha", DistanceUnits="um")).unit == "µm"
    assert load_volume(write(tmp_path / "v.mha", DistanceUnits="?")).unit is None
