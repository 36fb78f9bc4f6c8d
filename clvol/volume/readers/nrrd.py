"""NRRD: .nrrd with its data attached, .nhdr (or .nrrd) with one data file beside it.

pynrrd parses the header. It would hold three copies of a compressed volume while reading, so the
voxels are read by ``read_samples``. Format: teem.sourceforge.net/nrrd/format.html.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.grid import Grid
from clvol.volume.memory import check_memory
from clvol.volume.readers.options import ReadOptions
from clvol.volume.readers.samples import read_samples
from clvol.volume.volume import ACCEPTED, Volume

_HEADER_LIMIT = 1 << 20
_TYPES = {
    "int8": ("signed char", "int8", "int8_t"),
    "uint8": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "int16": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "uint16": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "float32": ("float",),
    "float64": ("double",),
}
_TYPE_BY_NAME = {alias: name for name, aliases in _TYPES.items() for alias in aliases}
_ENCODINGS = {
    "raw": "raw",
    "gz": "deflate",
    "gzip": "deflate",
    "bz2": "bzip2",
    "bzip2": "bzip2",
    "txt": "text",
    "text": "text",
    "ascii": "text",
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


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a NRRD file; the world frame is the header's ``space``.

    Accepts the encodings raw, gzip, bzip2 and text. Geometry comes from ``space directions`` and
    ``space origin`` (the centre of the first voxel) or, without them, from ``spacings`` and
    ``axis mins`` (with cell centering, the default, the outer face of the first voxel).
    """
    import nrrd

    with path.open("rb") as file:
        lines = _header_lines(path, file)
        attached = file.tell()
        header = nrrd.read_header(lines)
        for field in ("dimension", "type", "encoding", "sizes"):
            if field not in header:
                raise VolumeError(str(path), f"NRRD header without {field!r}", f"a {field!r} field")
        dtype = _dtype(path, header)
        shape = _shape(path, header)
        encoding = _ENCODINGS.get(str(header["encoding"]).lower())
        if encoding is None:
            raise VolumeError(
                str(path), f"encoding {header['encoding']!r}", "raw, gzip, bzip2 or text"
            )
        grid = _grid(path, shape, header)
        source, start = _data_file(path, header, attached)
        data = _read_data(source, start, header, shape, dtype, encoding, options)
    space = str(header.get("space", "")).strip()
    frame = _FRAMES.get(space.lower(), space) or "index"
    return Volume(data, grid.spacing, grid.origin, grid.direction, frame=frame)


def _header_lines(path: Path, file: BinaryIO) -> list[str]:
    """The header up to its blank line, leaving ``file`` at the first byte after it."""
    lines: list[str] = []
    room = _HEADER_LIMIT
    while line := file.readline(room):
        if not lines and not line.startswith(b"NRRD000"):
            raise VolumeError(str(path), "no NRRD header", "a file that starts with NRRD000")
        room -= len(line)
        if room <= 0:
            raise VolumeError(str(path), "endless NRRD header", f"at most {_HEADER_LIMIT} bytes")
        text = line.decode("ascii", "replace").rstrip()
        if not text:
            break
        if ":" not in text and not text.startswith("#") and lines:
            raise VolumeError(str(path), f"NRRD header line {text[:60]!r}", "FIELD: VALUE")
        lines.append(text)
    return lines


def _field(header: dict[str, Any], *names: str) -> Any:
    """The first of several spellings of a field that the header has, else None."""
    return next((header[name] for name in names if name in header), None)


def _dtype(path: Path, header: dict[str, Any]) -> np.dtype:
    name = _TYPE_BY_NAME.get(str(header["type"]).lower())
    if name is None:
        raise VolumeError(str(path), f"voxels of type {header['type']!r}", ACCEPTED)
    dtype = np.dtype(name)
    if dtype.itemsize == 1 or _ENCODINGS.get(str(header["encoding"]).lower()) == "text":
        return dtype
    orders = {"little": "<", "big": ">"}
    endian = header.get("endian")
    if endian not in orders:
        raise VolumeError(str(path), f"endian {endian!r}", "endian: little or endian: big")
    return dtype.newbyteorder(orders[endian])


def _shape(path: Path, header: dict[str, Any]) -> tuple[int, int, int]:
    sizes = [int(n) for n in header["sizes"]]
    kinds = [str(kind) for kind in header.get("kinds", ())]
    if header["dimension"] != len(sizes):
        raise VolumeError(
            str(path), f"dimension {header['dimension']} with {len(sizes)} sizes", "as many sizes"
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


def _grid(path: Path, shape: tuple[int, int, int], header: dict[str, Any]) -> Grid:
    origin = _field(header, "space origin")
    directions = _field(header, "space directions")
    if directions is not None:
        rows = np.asarray(directions, dtype=np.float64)
        if rows.shape != (3, 3) or np.isnan(rows).all(axis=1).any():
            raise VolumeError(str(path), "an axis without a space direction", "three directions")
        return Grid.from_steps(shape, rows.T, (0.0, 0.0, 0.0) if origin is None else origin)
    sizes = np.asarray(shape[::-1], dtype=np.float64)
    cell = np.array([word.lower() != "node" for word in header.get("centerings", ["cell"] * 3)])
    lower = _numbers(header, "axis mins", "axismins")
    upper = _numbers(header, "axis maxs", "axismaxs")
    steps = _numbers(header, "spacings")
    if steps is None and lower is not None and upper is not None and cell.size == 3:
        steps = (upper - lower) / np.maximum(np.where(cell, sizes, sizes - 1.0), 1.0)
    # NaN is the format's way to say that a spacing is not known.
    steps = np.ones(3) if steps is None else np.where(np.isnan(steps), 1.0, steps)
    if origin is None and lower is not None and cell.size == 3:
        known = np.where(np.isnan(lower), 0.0, lower)
        origin = known + np.where(np.isnan(lower) | ~cell, 0.0, 0.5 * steps)
    return Grid.from_steps(shape, np.diag(steps), (0.0, 0.0, 0.0) if origin is None else origin)


def _numbers(header: dict[str, Any], *names: str) -> np.ndarray | None:
    value = _field(header, *names)
    return None if value is None else np.asarray(value, dtype=np.float64)


def _data_file(path: Path, header: dict[str, Any], attached: int) -> tuple[Path, int]:
    """The file with the voxels, and where they start in it before any skip."""
    name = _field(header, "data file", "datafile")
    if name is None:
        return path, attached
    # LIST and number patterns (with %) spread the data over several files.
    if name.split()[0] == "LIST" or "%" in name:
        raise VolumeError(str(path), f"data file {name!r}", "one data file")
    source = path.parent / name
    if not source.is_file():
        raise VolumeError(str(path), f"data file {name!r} is missing", "the file beside the header")
    return source, 0


def _read_data(
    source: Path,
    start: int,
    header: dict[str, Any],
    shape: tuple[int, int, int],
    dtype: np.dtype,
    encoding: str,
    options: ReadOptions,
) -> np.ndarray:
    """Skips lines in the file as stored, then bytes in the data as decoded, as the format says."""
    skip_lines = _field(header, "line skip", "lineskip") or 0
    skip_bytes = _field(header, "byte skip", "byteskip") or 0
    if skip_lines < 0 or skip_bytes < (-1 if encoding == "raw" else 0):
        raise VolumeError(
            str(source), f"line skip {skip_lines}, byte skip {skip_bytes}", "skips of 0 or more"
        )
    if skip_lines:
        with source.open("rb") as file:
            file.seek(start)
            for _ in range(skip_lines):
                if not file.readline(_HEADER_LIMIT):
                    break
            start = file.tell()
    if encoding == "text":
        return _read_text(source, start + skip_bytes, shape, dtype, options)
    return read_samples(
        source,
        shape,
        dtype,
        offset=None if skip_bytes == -1 else start,
        encoding=encoding,
        skip=max(skip_bytes, 0),
        memory_cap=options.memory_cap,
    )


def _read_text(
    source: Path, start: int, shape: tuple[int, int, int], dtype: np.dtype, options: ReadOptions
) -> np.ndarray:
    count = shape[0] * shape[1] * shape[2]
    if 2 * count - 1 > source.stat().st_size:  # a digit and a blank a voxel
        raise VolumeError(str(source), "too few numbers", f"{count} numbers")
    check_memory(str(source), count * 8, options.memory_cap)
    with source.open("rb") as file:
        file.seek(start)
        words = file.read().split()
    if len(words) != count:
        raise VolumeError(str(source), f"{len(words)} numbers", f"{count} numbers")
    numbers = np.array(words).astype(np.float64)
    with np.errstate(all="ignore"):
        data = numbers.astype(dtype)
    if dtype.kind in "iu" and not np.array_equal(data, numbers):
        raise VolumeError(str(source), "numbers outside the type", f"whole numbers of {dtype}")
    return data.reshape(shape)
