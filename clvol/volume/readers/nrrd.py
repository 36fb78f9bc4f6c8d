"""NRRD: .nrrd with its data attached, .nhdr (or .nrrd) with its data in files beside it.

pynrrd would hold three copies of a compressed volume while reading, so the voxels are read by
``read_parts``. Format: teem.sourceforge.net/nrrd/format.html.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.grid import Grid
from clvol.volume.readers.beside import data_files, listed_files
from clvol.volume.readers.nrrd_header import NrrdHeader, read_header
from clvol.volume.readers.options import ReadOptions
from clvol.volume.readers.samples import Part, read_parts
from clvol.volume.readers.units import one_unit
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
# Kinds of an axis along which samples are spread in space.
_SPATIAL_KINDS = ("domain", "space", "none", "???")
_LINE = 1 << 20


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a NRRD file; the world frame is the header's ``space``.

    Accepts the encodings raw, gzip, bzip2, text and hex, and voxels over several files (a list or a
    numbered pattern). Geometry comes from ``space directions`` and ``space origin`` (the centre of
    the first voxel) or, without them, from ``spacings`` and ``axis mins`` (with cell centering, the
    default, the outer face of the first voxel). Where units of length differ from axis to axis, all
    are brought to the first one's.
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
    shape = _shape(path, header)
    grid, unit = _grid(path, shape, header)
    parts = _parts(path, header, attached, shape, encoding)
    data = read_parts(parts, shape, dtype, encoding=encoding, memory_cap=options.memory_cap)
    space = str(header.get("space", "")).strip()
    frame = _FRAMES.get(space.lower().replace(" ", "-"), space) or "index"
    volume = Volume(data, grid.spacing, grid.origin, grid.direction, frame=frame)
    volume.unit = unit
    return volume


def _dtype(path: Path, header: NrrdHeader, encoding: str) -> np.dtype:
    name = _TYPE_BY_NAME.get(header.get("type"))
    if name is None:
        raise VolumeError(str(path), f"voxels of type {header.get('type')!r}", ACCEPTED)
    dtype = np.dtype(name)
    if dtype.itemsize == 1 or encoding == "text":
        return dtype
    orders = {"little": "<", "big": ">"}
    endian = header.get("endian")
    if endian not in orders:
        raise VolumeError(str(path), f"endian {endian!r}", "endian: little or endian: big")
    return dtype.newbyteorder(orders[endian])


def _shape(path: Path, header: NrrdHeader) -> tuple[int, int, int]:
    sizes = [int(n) for n in header.get("sizes")]
    dimension, kinds = header.get("dimension"), header.get("kinds", ())
    if dimension != len(sizes):
        raise VolumeError(
            str(path), f"dimension {dimension} with {len(sizes)} sizes", "as many sizes"
        )
    strange = [kind for kind in kinds if kind.lower() not in _SPATIAL_KINDS]
    if len(sizes) != 3 or strange:
        note = f" with an axis of kind {', '.join(strange)}" if strange else ""
        raise VolumeError(
            str(path),
            f"{len(sizes)}-D data{note}, sizes {' '.join(map(str, sizes))}",
            "three axes in space and one scalar per voxel",
        )
    if min(sizes) < 1:
        raise VolumeError(str(path), f"sizes {' '.join(map(str, sizes))}", "sizes of at least 1")
    return tuple(sizes[::-1])


def _grid(path: Path, shape: tuple[int, int, int], header: NrrdHeader) -> tuple[Grid, str | None]:
    """The grid, and the unit of its lengths where the header knows one."""
    origin = header.get("space origin")
    directions = header.get("space directions")
    if directions is not None:
        rows = np.asarray(directions, dtype=np.float64)
        if rows.shape != (3, 3) or np.isnan(rows).all(axis=1).any():
            raise VolumeError(str(path), "an axis without a space direction", "three directions")
        factors, unit = _unit(header, "space units", (2, 2, 2))  # of the world's axes
        origin = np.zeros(3) if origin is None else np.asarray(origin, np.float64)
        return Grid.from_steps(shape, (rows * factors).T, origin * factors), unit
    sizes = np.asarray(shape[::-1], dtype=np.float64)
    cell = np.array([word != "node" for word in header.get("centerings", ["cell"] * 3)])
    lower, upper = header.numbers("axis mins"), header.numbers("axis maxs")
    steps = header.numbers("spacings")
    if steps is None and lower is not None and upper is not None and cell.size == 3:
        steps = (upper - lower) / np.maximum(np.where(cell, sizes, sizes - 1.0), 1.0)
    # NaN is the format's way to say that a spacing is not known.
    steps = np.ones(3) if steps is None else np.where(np.isnan(steps), 1.0, steps)
    if origin is None and lower is not None and cell.size == 3:
        known = np.where(np.isnan(lower), 0.0, lower)
        origin = known + np.where(np.isnan(lower) | ~cell, 0.0, 0.5 * steps)
    if steps.shape != (3,):
        raise VolumeError(str(path), f"{steps.size} spacings", "three, one for each axis")
    factors, unit = _unit(header, "units", shape[::-1])
    origin = np.zeros(3) if origin is None else np.asarray(origin, np.float64)
    return Grid.from_steps(shape, np.diag(steps * factors), origin * factors), unit


def _unit(
    header: NrrdHeader, field: str, sizes: tuple[int, int, int]
) -> tuple[np.ndarray, str | None]:
    """What lengths along the three axes are to be multiplied by, and the unit that they are then
    in."""
    names = header.get(field, ())
    if len(names) != 3:
        return np.ones(3), None
    factors, unit, _ = one_unit(names, [n > 1 for n in sizes])
    return np.asarray(factors, np.float64), unit


def _parts(
    path: Path, header: NrrdHeader, attached: int, shape: tuple[int, int, int], encoding: str
) -> list[Part]:
    """Where the voxels are. Lines are skipped in a file as stored, bytes in the data as decoded, in
    each file anew."""
    skip_lines, skip_bytes = header.get("line skip", 0), header.get("byte skip", 0)
    if skip_lines < 0 or skip_bytes < (-1 if encoding == "raw" else 0):
        raise VolumeError(
            str(path), f"line skip {skip_lines}, byte skip {skip_bytes}", "skips of 0 or more"
        )
    files, start = [path], attached
    if header.data_file is not None:
        files, start = _files(path, header, shape[::-1]), 0
    parts = []
    for file in files:
        offset = None
        if skip_bytes != -1:
            offset = _after_lines(file, start, skip_lines) if skip_lines else start
        parts.append(Part(file, offset, max(skip_bytes, 0)))
    return parts


def _files(path: Path, header: NrrdHeader, sizes: tuple[int, int, int]) -> list[Path]:
    words = header.data_file.split()
    if words[:1] == [b"LIST"] and (header.listed or len(words) <= 2):
        axes = int(words[1]) if len(words) == 2 and words[1].isdigit() else None
        return listed_files(path, header.listed, axes, sizes)
    return data_files(path, header.data_file, sizes)


def _after_lines(path: Path, start: int, count: int) -> int:
    """Where the data begin after so many lines."""
    with path.open("rb") as file:
        file.seek(start)
        while count and (piece := file.readline(_LINE)):
            count -= piece.endswith(b"\n")
        return file.tell()
