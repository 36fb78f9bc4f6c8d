"""NRRD: .nrrd with attached data, .nhdr (or .nrrd) with data in separate files.

pynrrd would hold three copies of a compressed volume while reading, so the voxels are read by ``read_parts``. Format:
teem.sourceforge.net/nrrd/format.html.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.beside import data_files, listed_files
from clvol.readers.nrrd_grid import axes_of, grid_of
from clvol.readers.nrrd_header import NrrdHeader, read_header
from clvol.readers.options import ReadOptions
from clvol.readers.samples import Part, names_beside, read_chosen
from clvol.volume.volume import ACCEPTED, Volume

_TYPES = {
    "int8": "signed char|int8|int8_t",
    "uint8": "uchar|unsigned char|uint8|uint8_t",
    "int16": "short|short int|signed short|signed short int|int16|int16_t",
    "uint16": "ushort|unsigned short|unsigned short int|uint16|uint16_t",
    "int32": "int|signed int|int32|int32_t",
    "uint32": "uint|unsigned int|uint32|uint32_t",
    "int64": "longlong|long long|long long int|signed long long|signed long long int|int64|int64_t",
    "uint64": "ulonglong|unsigned long long|unsigned long long int|uint64|uint64_t",
    "float32": "float",
    "float64": "double",
}
_TYPE_BY_NAME = {alias: name for name, aliases in _TYPES.items() for alias in aliases.split("|")}
_ENCODINGS = {
    "raw": "raw",
    "gz": "deflate",
    "gzip": "deflate",
    "bz2": "bzip2",
    "bzip2": "bzip2",
    "txt": "text",
    "text": "text",
    "ascii": "text",
    "hex": "hex",
}
_FRAMES = {
    "left-posterior-superior": "LPS",
    "right-anterior-superior": "RAS",
    "left-anterior-superior": "LAS",
    "lps": "LPS",
    "ras": "RAS",
    "las": "LAS",
}
_BLOCK = 1 << 17


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a NRRD file; the world frame is the header's ``space``.

    Accepts the encodings raw, gzip, bzip2, text and hex, and voxels spread over several files (a list or a numbered
    pattern). Geometry comes from ``space directions`` and ``space origin`` (the centre of the first voxel) or,
    without them, from ``spacings`` and ``axis mins`` (with cell centering, the default, the outer face of the first
    voxel). If units of length differ between axes, all are converted to the first one. ``options`` select one element
    of axes of channels and times, which may come before, between or after the axes in space.
    """
    with path.open("rb") as file:
        header = read_header(path, file)
        attached = file.tell()
    for field in ("dimension", "type", "encoding", "sizes"):
        if field not in header.fields:
            raise VolumeError(str(path), f"NRRD header without {field!r}", f"a {field!r} field")
    encoding = _ENCODINGS.get(header.get("encoding"))
    if encoding is None:
        what = f"encoding {header.get('encoding')!r}"
        raise VolumeError(str(path), what, "raw, gzip, bzip2, text or hex")
    dtype = _dtype(path, header, encoding)
    axes = axes_of(path, header)
    grid, unit = grid_of(path, axes, header, options)
    which = axes.choose(path, options)
    parts = _parts(path, header, attached, axes.sizes, encoding)
    data = read_chosen(
        parts, axes.sizes[::-1], dtype, which, encoding=encoding, memory_cap=options.memory_cap
    )
    space = str(header.get("space", "")).strip()
    frame = _FRAMES.get(space.lower().replace(" ", "-"), space) or "index"
    volume = Volume(data, grid.spacing, grid.origin, grid.direction, frame=frame, unit=unit)
    volume.files = names_beside(path, parts)
    volume.labels = header.segments
    return volume


def _dtype(path: Path, header: NrrdHeader, encoding: str) -> np.dtype:
    name = _TYPE_BY_NAME.get(header.get("type"))
    if name is None:
        raise VolumeError(str(path), f"voxels of type {header.get('type')!r}", ACCEPTED)
    dtype = np.dtype(name)
    if dtype.itemsize == 1 or encoding == "text":
        return dtype
    orders: dict[Any, Literal["<", ">"]] = {"little": "<", "big": ">"}
    endian = header.get("endian")
    if endian not in orders:
        raise VolumeError(str(path), f"endian {endian!r}", "endian: little or endian: big")
    return dtype.newbyteorder(orders[endian])


def _parts(
    path: Path, header: NrrdHeader, attached: int, sizes: tuple[int, ...], encoding: str
) -> list[Part]:
    """The position of the voxels. Lines are skipped in the stored file, bytes in the decoded data, per file."""
    skip_lines, skip_bytes = header.get("line skip", 0), header.get("byte skip", 0)
    # A negative byte skip counts from the end: -1 for data that end there, -2 for one byte after them.
    least = {"raw": -(2**40), "deflate": -1, "bzip2": -1}.get(encoding, 0)
    if skip_lines < 0 or skip_bytes < least:
        raise VolumeError(
            str(path), f"line skip {skip_lines}, byte skip {skip_bytes}", "skips of 0 or more"
        )
    files, start = [path], attached
    if header.data_file is not None:
        files, start = _files(path, header, header.data_file, sizes), 0
    starts = dict.fromkeys(files, start)
    if skip_lines:
        starts = {file: _after_lines(file, start, skip_lines) for file in starts}
    behind = -1 - skip_bytes if skip_bytes < 0 else None
    return [Part(file, starts[file], max(skip_bytes, 0), None, behind) for file in files]


def _files(path: Path, header: NrrdHeader, named: bytes, sizes: tuple[int, ...]) -> list[Path]:
    words = named.split()
    if words[:1] == [b"LIST"] and (header.listed or len(words) <= 2):
        axes = int(words[1]) if len(words) == 2 and words[1].isdigit() else None
        return listed_files(path, header.listed, axes, sizes)
    return data_files(path, named, sizes)


def _after_lines(path: Path, start: int, count: int) -> int:
    """The offset after ``count`` lines; the end of the file if there are fewer."""
    with path.open("rb") as file:
        file.seek(start)
        while block := file.read(_BLOCK):
            lines = block.count(b"\n")
            if lines >= count:
                ends = np.flatnonzero(np.frombuffer(block, np.uint8) == ord("\n"))
                return start + int(ends[count - 1]) + 1
            count -= lines
            start += len(block)
    return start
