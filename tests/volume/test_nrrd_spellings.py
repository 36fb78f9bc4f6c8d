"""NRRD headers as other tools write them: whatever the format allows means the same."""

from __future__ import annotations

import bz2
import gzip
import os
from pathlib import Path

import nrrd
import numpy as np
import pytest

from clvol.errors import VolumeError
from clvol.readers import load_volume
from clvol.store.voxel_source import VolumeSource

VOXELS = np.arange(2 * 3 * 4, dtype="<i2").reshape(2, 3, 4)
FIELDS = {
    "type": "short",
    "dimension": "3",
    "sizes": "4 3 2",
    "space": "left-posterior-superior",
    "space directions": "(0.5,0,0) (0,2,0) (0,0,3)",
    "space origin": "(10,-20,30)",
    "endian": "little",
    "encoding": "raw",
}


def write(path: Path, data: bytes = VOXELS.tobytes(), end: str = "\n", **changed: str | None) -> Path:
    """A header with ``changed`` fields (names with _ for blanks; None: left out), and data."""
    fields = FIELDS | {name.replace("_", " "): value for name, value in changed.items()}
    lines = ["NRRD0004", *(f"{name}: {value}" for name, value in fields.items() if value is not None)]
    path.write_bytes(end.join([*lines, "", ""]).encode() + data)
    return path


def rewritten(path: Path, change) -> Path:
    """``write``'s file with ``change`` made to each line of its header."""
    head, data = write(path).read_bytes().split(b"\n\n", 1)
    lines = [line if k == 0 else change(line.decode()) for k, line in enumerate(head.split(b"\n"))]
    text = "\n".join(line if isinstance(line, str) else line.decode() for line in lines)
    path.write_bytes(text.encode() + b"\n\n" + data)
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


def named(spell):
    def change(line: str) -> str:
        name, colon, value = line.partition(": ")
        return spell(name) + colon + value

    return change


@pytest.mark.parametrize(
    "spell",
    [str.upper, str.title, str.capitalize, lambda name: name.replace(" ", ""),
     lambda name: name.title().replace(" ", ""), lambda name: name.upper().replace(" ", "")],
)  # fmt: skip
def test_names_in_any_capitals_with_or_without_blanks(tmp_path: Path, spell) -> None:
    expect(rewritten(tmp_path / "v.nrrd", named(spell)))


@pytest.mark.parametrize("value", [str.upper, str.title])
def test_values_of_words_in_any_capitals(tmp_path: Path, value) -> None:
    words = ("type", "endian", "encoding", "space")

    def change(line: str) -> str:
        name, colon, text = line.partition(": ")
        return name + colon + (value(text) if name in words else text)

    expect(rewritten(tmp_path / "v.nrrd", change))


@pytest.mark.parametrize("end", ["\n", "\r\n", " \n", "\t\r\n"])
def test_line_ends_of_other_systems(tmp_path: Path, end) -> None:
    expect(write(tmp_path / "v.nrrd", end=end))


@pytest.mark.parametrize(
    "directions, origin",
    [
        ("( 0.5, 0, 0 ) ( 0, 2, 0 ) ( 0, 0, 3 )", "( 10, -20, 30 )"),
        ("(0.5 ,0 ,0)  (0 ,2 ,0)\t(0 ,0 ,3)", "(10 , -20 , 30)"),
        ("(0.5,0,0)(0,2,0)(0,0,3)", "  (10,-20,30)  "),
        ("(+5.0e-1,0.,-0) (0,2.0,0) (0,0,3)", "(1e1,-2E1,30.)"),
    ],
)
def test_blanks_in_vectors(tmp_path: Path, directions, origin) -> None:
    expect(write(tmp_path / "v.nrrd", space_directions=directions, space_origin=origin))


@pytest.mark.parametrize("spacings", ["0.5 2 3", "  0.5\t2   3 ", "5e-1 2.0 3."])
def test_blanks_in_lists(tmp_path: Path, spacings) -> None:
    path = write(
        tmp_path / "v.nrrd", space_directions=None, spacings=spacings, sizes=" 4  3\t2 "
    )
    expect(path)


FIELD_NAMES = (
    "type", "dimension", "sizes", "encoding", "endian", "space", "spacings", "thicknesses",
    "space directions", "space origin", "byte skip", "lineskip", "data file", "datafile", "kinds",
    "axis mins", "content", "units", "Byte Skip", "measurement frame",
)  # fmt: skip


@pytest.mark.parametrize("name", FIELD_NAMES)
@pytest.mark.parametrize("value", ["12", "[nan, nan, 0.5]", "a: b", "", "x:=y"])
def test_pairs_named_like_a_field_are_no_fields(tmp_path: Path, name, value) -> None:
    pairs = {f"{name}:={value}\n#": "rest", f"my {name}:={value}\n#2": "rest"}
    path = write(tmp_path / "v.nrrd")
    text = "".join(f"{key}: {rest}\n" for key, rest in pairs.items())
    path.write_bytes(path.read_bytes().replace(b"endian:", text.encode() + b"endian:"))
    expect(path)


def test_comments_and_fields_of_others_are_left_alone(tmp_path: Path) -> None:
    path = write(tmp_path / "v.nrrd")
    more = b"# type: float\nmy own field: 7\nmeasurement frame: (1, 0,0) none\nlabels: \"a\n"
    path.write_bytes(path.read_bytes().replace(b"endian:", more + b"endian:"))
    expect(path)


def test_a_field_said_twice_must_say_the_same(tmp_path: Path) -> None:
    path = write(tmp_path / "v.nrrd")
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"endian:", b"Sizes:  4 3 2\nendian:"))
    expect(path)
    path.write_bytes(whole.replace(b"endian:", b"Sizes: 3 4 2\nendian:"))
    assert "two fields 'sizes'" in refused(path)


@pytest.mark.parametrize(
    "fields, wrong",
    [
        ({"sizes": "4.5 3 2"}, "sizes 4.5 3 2"),
        ({"space origin": "(1,2)"}, "space origin of 2 numbers"),
        ({"space origin": "1 2 3"}, "space origin"),
        ({"space directions": None, "spacings": "1 2"}, "spacings of 2 numbers"),
        ({"dimension": "three"}, "dimension"),
        ({"byte skip": "x"}, "byte skip"),
    ],
)
def test_values_that_are_none_are_named(tmp_path: Path, fields, wrong) -> None:
    changed = {name.replace(" ", "_"): value for name, value in fields.items()}
    assert wrong in refused(write(tmp_path / "v.nrrd", **changed))


NAMES = [
    "größe.raw", "scan 100%.raw", "50% done.raw", "a b  c.raw", "スキャン.raw", "%d.raw",
    "with%20blank.raw", "é.raw", "s_%03d.raw", "x;y&z'.raw", "(1).raw", "LISTED.raw", "v:=w.raw",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_data_files_of_any_name(tmp_path: Path, name) -> None:
    (tmp_path / name).write_bytes(VOXELS.tobytes())
    expect(write(tmp_path / "v.nhdr", b"", data_file=name))


@pytest.mark.parametrize("in_header", ["utf-8", "latin-1"])
@pytest.mark.parametrize("on_disk", ["utf-8", "latin-1"])
def test_names_in_utf8_and_latin_1(tmp_path: Path, in_header, on_disk) -> None:
    place = os.fsencode(tmp_path) + b"/" + "größe.raw".encode(on_disk)
    with open(place, "wb") as file:
        file.write(VOXELS.tobytes())
    path = write(tmp_path / "v.nhdr", b"", data_file="NAME")
    path.write_bytes(path.read_bytes().replace(b"NAME", "größe.raw".encode(in_header)))
    expect(path)


def test_a_composed_letter_finds_a_decomposed_one(tmp_path: Path) -> None:
    (tmp_path / "a\u0308.raw").write_bytes(VOXELS.tobytes())
    expect(write(tmp_path / "v.nhdr", b"", data_file="\u00e4.raw"))


def test_data_files_in_folders(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "d.raw").write_bytes(VOXELS.tobytes())
    for name in ("in/d.raw", "./in/d.raw", "in\\d.raw", str(tmp_path / "in" / "d.raw")):
        expect(write(tmp_path / "v.nhdr", b"", data_file=name))


def slices(folder: Path, names, pack=lambda data: data, of=VOXELS) -> None:
    parts = np.split(of.reshape(-1), len(names))
    for name, part in zip(names, parts):
        (folder / name).write_bytes(pack(part.tobytes()))


PACK = {
    "raw": lambda data: data,
    "gzip": gzip.compress,
    "bzip2": bz2.compress,
    "hex": lambda data: data.hex(" ").encode(),
    "text": lambda data: " ".join(map(str, np.frombuffer(data, "<i2"))).encode(),
}


@pytest.mark.parametrize("encoding", PACK)
@pytest.mark.parametrize(
    "data_file, names",
    [
        ("s%d.raw 1 2 1", ["s1.raw", "s2.raw"]),
        ("s%03d.raw 7 9 2", ["s007.raw", "s009.raw"]),
        ("s%02i.raw 2 1 -1", ["s02.raw", "s01.raw"]),
        ("s 1 %d.raw 10 11 1", ["s 1 10.raw", "s 1 11.raw"]),
        ("100%%_%.2d 0 1 1", ["100%_00", "100%_01"]),
        ("s%d.raw 1 2 1 2", ["s1.raw", "s2.raw"]),
        ("s%d.raw 0 5 1 1", [f"s{k}.raw" for k in range(6)]),
        ("s%d.raw 0 1 1 3", ["s0.raw", "s1.raw"]),
        ("s%d.raw 0 0 1 3", ["s0.raw"]),
        ("LIST\nb.raw\na.raw", ["b.raw", "a.raw"]),
        ("LIST 2\nb c.raw\na.raw", ["b c.raw", "a.raw"]),
        ("LIST 1\n" + "\n".join("fedcba"), list("fedcba")),
        ("LIST 3\nall.raw", ["all.raw"]),
    ],
)
def test_volumes_over_several_files(tmp_path: Path, data_file, names, encoding) -> None:
    slices(tmp_path, names, PACK[encoding])
    expect(write(tmp_path / "v.nhdr", b"", encoding=encoding, data_file=data_file))


def test_every_file_has_its_own_skips(tmp_path: Path) -> None:
    slices(tmp_path, ["1", "2"], lambda data: b"a line\n" + b"junk" + data)
    skips = {"line_skip": "1", "byte_skip": "4"}
    expect(write(tmp_path / "v.nhdr", b"", **skips, data_file="%d 1 2 1"))
    expect(write(tmp_path / "v.nhdr", b"", byte_skip="-1", data_file="%d 1 2 1"))


@pytest.mark.parametrize(
    "data_file, wrong",
    [
        ("s%d.raw 1 3 1", "3 data files named, expected one data file per slice, 2 in all"),
        ("s%d.raw 1 2 0", "numbered 1 2 0"),
        ("s%d.raw 2 1 1", "numbered 2 1 1"),
        ("s%d.raw 0 99999999 1", "numbered"),
        ("s%d.raw 1 2 1 4", "4 axes"),
        ("s%d.raw 1 9 1", "9 data files"),
        ("s%d.raw 2 3 1", "'s3.raw' is missing"),
        ("LIST\ns1.raw", "1 data files"),
        ("LIST\ns1.raw\ngone.raw", "'gone.raw' is missing"),
        ("LIST\ns1.raw\nshort.raw", "short.raw: 6 bytes"),
        ("LIST 9\ns1.raw\ns2.raw", "9 axes"),
    ],
)
def test_what_is_wrong_with_several_files_is_named(tmp_path: Path, data_file, wrong) -> None:
    slices(tmp_path, ["s1.raw", "s2.raw"])
    (tmp_path / "short.raw").write_bytes(b"6 byte")
    assert wrong in refused(write(tmp_path / "v.nhdr", b"", data_file=data_file))


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("encoding", PACK)
def test_skips_of_attached_and_detached_data(tmp_path: Path, encoding, end) -> None:
    """Lines of the file as stored; bytes of the data as decoded where it is compressed."""
    before = b"seven b" if encoding in ("raw", "gzip", "bzip2") else b""
    after_lines = {"raw": before, "gzip": b"", "bzip2": b""}.get(encoding, b"1234567")
    packed = PACK[encoding]((before if encoding in ("gzip", "bzip2") else b"") + VOXELS.tobytes())
    data = b"one\ntwo\r\n" + after_lines + packed
    skips = {"line_skip": "2", "byte_skip": "7", "encoding": encoding}
    expect(write(tmp_path / "v.nrrd", data, end, **skips))
    (tmp_path / "d").write_bytes(data)
    expect(write(tmp_path / "v.nhdr", b"", end, **skips, data_file="d"))


@pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2"])
def test_data_at_the_end_of_what_is_there(tmp_path: Path, encoding) -> None:
    for before in (b"", b"seven b", bytes(3 << 20)):
        packed = PACK[encoding](before + VOXELS.tobytes())
        expect(write(tmp_path / "v.nrrd", packed, encoding=encoding, byte_skip="-1"))
    if encoding == "raw":
        data = b"before" + VOXELS.tobytes() + b"after"
        expect(write(tmp_path / "v.nrrd", data, byte_skip="-6"))
    # Never bytes of the header for voxels.
    short = PACK[encoding](VOXELS.tobytes()[:-1])
    said = refused(write(tmp_path / "v.nrrd", short, encoding=encoding, byte_skip="-1"))
    assert "47 bytes" in said


UNITS = [
    ('"mm" "mm" "um"', (0.5, 2.0, 0.003), "mm"),
    ('"um" "um" "nm"', (0.5, 2.0, 0.003), "µm"),
    ('"mm" "mm" "mm"', (0.5, 2.0, 3.0), "mm"),
    ('"millimeter" "mm" "Micron"', (0.5, 2.0, 0.003), "mm"),
    ('"" "" ""', (0.5, 2.0, 3.0), None),
]


@pytest.mark.parametrize("units, spacing, unit", UNITS)
def test_units_that_differ_come_to_one(tmp_path: Path, units, spacing, unit) -> None:
    plain = {"space": None, "space_directions": None, "space_origin": None}
    by_axis = write(tmp_path / "a.nrrd", **plain, spacings="0.5 2 3", units=units)
    by_space = write(tmp_path / "b.nrrd", space_units=units)
    for path in (by_axis, by_space):
        volume = load_volume(path)
        np.testing.assert_allclose(volume.grid.spacing, spacing, rtol=1e-12)
        assert volume.unit == unit
    scaled = np.array(spacing) / (0.5, 2.0, 3.0)
    np.testing.assert_allclose(load_volume(by_space).grid.origin, scaled * (10, -20, 30))


@pytest.mark.parametrize("dtype", ["i1", "u1", "<i2", ">u2", "<i4", ">u4", "<i8", ">u8", "<f4", ">f8"])
@pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2", "ascii"])
@pytest.mark.parametrize("detached", [False, True])
def test_what_pynrrd_writes(tmp_path: Path, dtype, encoding, detached) -> None:
    voxels = (np.arange(24).reshape(2, 3, 4) * 5 - (0 if "u" in dtype else 60)).astype(dtype)
    header = {
        "space": "right-anterior-superior",
        "space directions": np.array([[0.0, 0.5, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 3.0]]),
        "space origin": np.array([1.0, 2.0, 3.0]),
        "encoding": encoding,
        "kinds": ["domain", "domain", "domain"],
        "labels": ["x", "y z", "z"],
        "space units": ["mm", "mm", "mm"],
        "thicknesses": [np.nan, np.nan, 0.5],
        "a key": "with: a value",
    }
    path = tmp_path / ("v.nhdr" if detached else "v.nrrd")
    nrrd.write(str(path), voxels, header, detached_header=detached, index_order="C")
    volume = load_volume(path)
    assert np.array_equal(volume.data, voxels)
    assert volume.grid.spacing == (0.5, 2.0, 3.0) and volume.frame == "RAS"
    there = (volume.grid.index_to_world() @ [3, 1, 1, 1])[:3]
    np.testing.assert_allclose(there, [1 + 2 * 1, 2 + 0.5 * 3, 3 + 3 * 1])


def test_a_list_of_ten_thousand_slices(tmp_path: Path) -> None:
    """Longer than any header is without it."""
    name = f"{'long name ' * 11}.raw"
    (tmp_path / name).write_bytes(b"\7\0")
    changed = {"sizes": "1 1 12000", "data_file": "LIST\n" + "\n".join([name] * 12000)}
    volume = load_volume(write(tmp_path / "v.nhdr", b"", **changed))
    assert volume.shape == (12000, 1, 1) and volume.value_range == (7.0, 7.0)


def test_data_files_are_known_and_their_change_is_another_source(tmp_path: Path) -> None:
    """An interrupted store goes on only with the same voxels."""
    slices(tmp_path, ["s1.raw", "s2.raw"])
    path = write(tmp_path / "v.nhdr", b"", data_file="s%d.raw 1 2 1")
    volume = load_volume(path)
    assert volume.files == (str(tmp_path / "s1.raw"), str(tmp_path / "s2.raw"))
    before = VolumeSource(volume).identity
    assert VolumeSource(load_volume(path)).identity == before
    os.utime(tmp_path / "s2.raw", ns=(1, 1))
    assert VolumeSource(load_volume(path)).identity != before
    assert load_volume(write(tmp_path / "w.nrrd")).files == ()
