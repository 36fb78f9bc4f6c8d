"""Small files that promise or hold much: refused before memory or time is spent; mutated headers."""

from __future__ import annotations

import bz2
import gzip
import random
import time
import tracemalloc
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from clvol.errors import VolumeError
from clvol.readers import load_volume

VOXELS = np.arange(24, dtype="<i2").reshape(2, 3, 4)
MIB = 1 << 20


@contextmanager
def little_memory_and_time(most: int = 8 * MIB, seconds: float = 5.0) -> Iterator[None]:
    tracemalloc.start()
    start = time.monotonic()
    try:
        yield
        assert time.monotonic() - start < seconds
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def nrrd(path: Path, data: bytes, **fields: str) -> Path:
    said = {"type": "uint8", "dimension": "3", "sizes": "4 3 2", "encoding": "raw"}
    said |= {name.replace("_", " "): value for name, value in fields.items()}
    text = "".join(f"{name}: {value}\n" for name, value in said.items())
    path.write_bytes(b"NRRD0004\n" + text.encode() + b"\n" + data)
    return path


def metaimage(path: Path, data: bytes, **fields: str) -> Path:
    said = {"NDims": "3", "DimSize": "4 3 2", "ElementType": "MET_UCHAR", **fields}
    text = "".join(f"{name} = {value}\n" for name, value in said.items())
    path.write_bytes(text.encode() + b"ElementDataFile = LOCAL\n" + data)
    return path


def refused(path: Path, cap: int | None = MIB, **options) -> str:
    with little_memory_and_time(), pytest.raises(VolumeError) as caught:
        load_volume(path, memory_cap=cap, **options)
    return str(caught.value)


ZEROS = bytes(4 * MIB)


@pytest.mark.parametrize("skip", ["4294967296", "999999999999", "100000000", "9" * 30])
def test_a_byte_skip_into_a_bomb_is_refused_at_once(tmp_path: Path, skip) -> None:
    """A few kilobytes of bzip2 hold gigabytes: decoding them to skip them took minutes."""
    bombs = {"bzip2": bz2.compress(ZEROS) * 100, "gzip": gzip.compress(ZEROS) * 2}
    for encoding, data in bombs.items():
        path = nrrd(tmp_path / "v.nrrd", data, encoding=encoding, byte_skip=skip)
        message = refused(path)
        assert "skip" in message or "bytes" in message
        refused(path, cap=None)


def test_looking_for_the_end_of_a_bomb_is_given_up(tmp_path: Path) -> None:
    path = nrrd(tmp_path / "v.nrrd", bz2.compress(ZEROS) * 100, encoding="bzip2", byte_skip="-1")
    assert "to skip" in refused(path)


@pytest.mark.parametrize(
    "skips", [{"byte_skip": str(40 * MIB), "encoding": "bzip2"}, {"line_skip": str(6 * MIB)}]
)
def test_one_file_named_a_thousand_times_is_no_bomb(tmp_path: Path, skips) -> None:
    (tmp_path / "bomb").write_bytes(bz2.compress(ZEROS) * 11 if "byte_skip" in skips else b"\n" * (8 * MIB))
    named = "data file: LIST\n" + "bomb\n" * 1000
    path = nrrd(tmp_path / "v.nhdr", b"", sizes="1 1 1000", **skips)
    path.write_bytes(path.read_bytes().rstrip() + b"\n" + named.encode())
    refused(path)


def test_a_reasonable_byte_skip_is_taken(tmp_path: Path) -> None:
    data = bytes(3 * MIB) + bytes(range(24))
    for encoding, pack in (("gzip", gzip.compress), ("bzip2", bz2.compress)):
        path = nrrd(tmp_path / "v.nrrd", pack(data), encoding=encoding, byte_skip=str(3 * MIB))
        assert load_volume(path).data.ravel().tolist() == list(range(24))


def test_streams_end_where_the_promised_bytes_end(tmp_path: Path) -> None:
    bomb = {"gzip": gzip.compress(ZEROS) * 100, "bzip2": bz2.compress(ZEROS) * 100}
    for encoding, data in bomb.items():
        assert "more" in refused(nrrd(tmp_path / "v.nrrd", data, encoding=encoding))
    deflated = zlib.compress(ZEROS)
    for more in ({}, {"CompressedDataSize": str(len(deflated))}):
        path = metaimage(tmp_path / "v.mha", deflated, CompressedData="True", **more)
        assert "more" in refused(path)


def test_a_hundred_thousand_empty_streams_take_no_time(tmp_path: Path) -> None:
    """What a decoder leaves over is copied each time: with large blocks that grows as their square."""
    for encoding, pack in (("gzip", gzip.compress), ("bzip2", bz2.compress)):
        data = pack(b"") * 100_000 + pack(bytes(24))
        path = nrrd(tmp_path / "v.nrrd", data, encoding=encoding)
        start = time.monotonic()
        assert load_volume(path).data.max() == 0
        assert time.monotonic() - start < 5.0


def test_text_without_blanks_and_with_too_many_numbers(tmp_path: Path) -> None:
    path = nrrd(tmp_path / "v.nrrd", b"1" * (4 * MIB), encoding="text")
    assert "without a blank" in refused(path)
    assert "numbers or more" in refused(nrrd(path, b"1 " * (2 * MIB), encoding="text"))
    assert "hold more" in refused(nrrd(path, b"00" * (2 * MIB), encoding="hex"))


def test_lines_are_skipped_by_the_million(tmp_path: Path) -> None:
    data = b"\n" * (8 * MIB) + bytes(range(24))
    path = nrrd(tmp_path / "v.nrrd", data, line_skip=str(8 * MIB))
    start = time.monotonic()
    assert load_volume(path).data.ravel().tolist() == list(range(24))
    refused(nrrd(path, data, line_skip="9" * 18))
    assert time.monotonic() - start < 5.0


@pytest.mark.parametrize("sizes", ["4000 4000 4000", "99999999999 99999999999 9", "1 1 2000000"])
@pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2", "text", "hex"])
def test_sizes_over_the_cap_are_refused_before_anything(tmp_path: Path, encoding, sizes) -> None:
    data = {"gzip": gzip.compress(ZEROS), "bzip2": bz2.compress(ZEROS)}.get(encoding, b"1 " * 100)
    refused(nrrd(tmp_path / "v.nrrd", data, encoding=encoding, sizes=sizes))
    if encoding in ("raw", "gzip") and len(sizes) < 20:
        compressed = {"CompressedData": str(encoding == "gzip")}
        refused(metaimage(tmp_path / "v.mha", data, DimSize=sizes, **compressed))


def test_sparse_files_are_held_to_the_cap(tmp_path: Path) -> None:
    """Their size is right; mapped ones take no memory, but a given cap holds for them too."""
    path = tmp_path / "v.raw"
    with path.open("wb") as file:
        file.truncate(64 * MIB)
    for dtype, side in (("uint8", 64), ("int32", 16), ("float16", 32), (">u2", 32)):
        refused(path, dims=(1024, 1024, side), dtype=dtype)
    with (tmp_path / "v.npy").open("wb") as file:
        header = {"descr": "<i4", "fortran_order": True, "shape": (16, 1024, 1024)}
        np.lib.format.write_array_header_1_0(file, header)
        file.truncate(file.tell() + 64 * MIB)
    refused(tmp_path / "v.npy")


@pytest.mark.parametrize(
    "shape", ["(99999999, 99999999, 99999999)", "(2, 3, -4)", "(2, 3, 4, 0)", "(2**70, 1, 1)", "()"]
)
def test_shapes_of_npy_headers_that_lie(tmp_path: Path, shape) -> None:
    text = f"{{'descr': '<i2', 'fortran_order': False, 'shape': {shape}, }}"
    text = text.ljust(118) + "\n"
    head = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()
    (tmp_path / "v.npy").write_bytes(head + VOXELS.tobytes())
    refused(tmp_path / "v.npy")


def header(end: str, *lines: str) -> bytes:
    return ("\n".join(lines) + end).encode()


NRRD = "NRRD0004", "type: short", "dimension: 3", "sizes: 4 3 2", "endian: little"
META = "NDims = 3", "DimSize = 4 3 2", "ElementType = MET_SHORT"
HEADERS = {
    ".nrrd": [
        header(
            "\n\n", *NRRD, "space: LPS", "space directions: (1,0,0) (0,1,0) (0,0,2)",
            "space origin: (1,2,3)", 'space units: "mm" "mm" "um"', "encoding: raw",
            "byte skip: 0", "k:=v",
        )
        + VOXELS.tobytes(),
        header(
            "\n\n", *NRRD, "spacings: 1 nan 2", "axis mins: 0 0 0", "centerings: node cell none",
            "encoding: gzip", "line skip: 0",
        )
        + gzip.compress(VOXELS.tobytes()),
        header("\n", *NRRD, "encoding: raw", "data file: s%d.raw 1 2 1"),
        header("\n", *NRRD, "encoding: raw", "data file: LIST 2", "s1.raw", "s2.raw"),
        header("\n\n", *NRRD, "encoding: ascii") + " ".join(map(str, VOXELS.ravel())).encode(),
        header("\n\n", *NRRD, "encoding: hex") + VOXELS.tobytes().hex().encode(),
    ],
    ".mha": [
        header(
            "\n", "ObjectType = Image", "BinaryData = True", "CompressedData = False",
            "TransformMatrix = 1 0 0 0 1 0 0 0 1", "Offset = 10 -20 30",
            "ElementSpacing = 0.5 0.75 1.25", "0008|0060 = CT", *META, "ElementDataFile = LOCAL",
        )
        + VOXELS.tobytes(),
        header(
            "\n", "CompressedData = True", "CompressedDataSize = 50", "HeaderSize = 0", *META,
            "ElementDataFile = LOCAL",
        )
        + zlib.compress(VOXELS.tobytes()),
        header("\n", *META, "ElementDataFile = LIST", "s1.raw", "s2.raw"),
        header(
            "\n", "ElementToIntensityFunctionSlope = 2", *META, "ElementDataFile = s%d.raw 1 2 1"
        ),
        header("\n", "ElementNumberOfChannels = 1", *META, "ElementDataFile = s%d.raw 1"),
    ],
}  # fmt: skip
WORDS = (
    b"-1|0|100|1e400|nan|inf|-9223372036854775809|%d|%s%s%s|%999d|LIST|LOCAL|\xff\xfe|\0|(|)|none|:="
    b"|=|:|\n|\r|3|1 2 3 4|4294967296|hex|gzip|bzip2|True|../|/dev/zero|/dev/stdin|."
).split(b"|") + [b"9" * 400, b"x" * 5000]


def mutated(draw: random.Random, whole: bytes) -> bytes:
    """``whole`` with a few bytes, words, lines changed, added or left out."""
    for _ in range(draw.randint(1, 4)):
        at, kind = draw.randrange(len(whole) + 1), draw.randrange(5)
        lines = whole.split(b"\n")
        k = draw.randrange(len(lines))
        if kind == 0:
            whole = whole[:at] + bytes([draw.randrange(256)]) + whole[at + 1 :]
        elif kind == 1:
            whole = whole[:at] + draw.choice(WORDS) + whole[at:]
        elif kind == 2:
            whole = whole[:at] + whole[at + draw.randint(1, 20) :]
        elif kind == 3:
            between = draw.choice([b": ", b" = "])
            name, found, _ = lines[k].partition(between)
            lines[k] = name + found + draw.choice(WORDS)
            whole = b"\n".join(lines)
        else:
            lines.insert(draw.randrange(len(lines) + 1), lines[k])
            whole = b"\n".join(lines)
    return whole


@pytest.mark.filterwarnings("ignore::clvol.errors.ClvolWarning")
@pytest.mark.parametrize("ending", HEADERS)
def test_mutated_headers_are_read_or_refused(tmp_path: Path, capfd, ending) -> None:
    """Neither a crash nor a hang nor any other exception, nor the words of a library."""
    draw = random.Random(f"clvol {ending}")
    for k in (1, 2):
        (tmp_path / f"s{k}.raw").write_bytes(VOXELS[k - 1].tobytes())
    path = tmp_path / f"v{ending}"
    read = 0
    for _ in range(1500):
        path.write_bytes(mutated(draw, draw.choice(HEADERS[ending])))
        start = time.monotonic()
        try:
            read += load_volume(path, memory_cap=MIB).nbytes <= MIB
        except VolumeError as error:
            assert "unreadable" not in str(error), path.read_bytes()
        assert time.monotonic() - start < 2.0
    assert 50 < read < 1200
    assert capfd.readouterr() == ("", "")
