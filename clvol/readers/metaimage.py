"""MetaImage: .mha with attached data, .mhd with data in separate files.

Header and voxels are read here, since MetaIO, which SimpleITK uses, accepts truncated compressed streams silently,
and some headers crash the process.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.beside import (
    data_files,
    exists_beside,
    find_beside,
    listed_files,
    numbered_names,
)
from clvol.readers.metaimage_header import LIST_LIMIT, MetaHeader, read_header
from clvol.readers.options import ReadOptions
from clvol.readers.samples import Part, names_beside, read_chosen
from clvol.volume.axis import ValueAxis
from clvol.volume.grid import Grid
from clvol.volume.units import find_unit
from clvol.volume.volume import ACCEPTED, Volume

_TYPES = {
    "MET_CHAR": "int8",
    "MET_UCHAR": "uint8",
    "MET_SHORT": "int16",
    "MET_USHORT": "uint16",
    "MET_INT": "int32",
    "MET_UINT": "uint32",
    "MET_LONG": "int32",  # on every machine, as in MetaIO
    "MET_ULONG": "uint32",
    "MET_LONG_LONG": "int64",
    "MET_ULONG_LONG": "uint64",
    "MET_FLOAT": "float32",
    "MET_DOUBLE": "float64",
}

_MOST_CHANNELS = 10**6


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a MetaImage file; world coordinates are ITK's (LPS).

    The voxels may be compressed, text, and in several files (a list or a numbered pattern). A slope
    and an offset of the header (ElementToIntensityFunction) become the volume's. Of several channels
    and times (the fourth dimension) ``options`` choose one.
    """
    header = read_header(path)
    sizes, channels = _sizes(header)
    dtype = _dtype(header)
    grid = _grid(header, sizes)
    shape = sizes[::-1]
    which: tuple[int | slice, ...] = (slice(None),) * 3
    if len(sizes) == 4:
        which = (options.choose("time", str(path), [None] * sizes[3]), *which)
    if channels > 1:
        which = (*which, options.choose("channel", str(path), [None] * channels))
        shape = (*shape, channels)
    axis = _axis(header)
    compressed = header.is_true("CompressedData")
    encoding = "deflate" if compressed else "raw"
    if not header.is_true("BinaryData", True):
        encoding = "text"
        if compressed:
            raise header.wrong("BinaryData", "binary data where they are compressed")
    parts = _parts(header, sizes, encoding)
    cap = options.memory_cap
    try:
        data = read_chosen(parts, shape, dtype, which, encoding=encoding, memory_cap=cap)
    except VolumeError as error:
        if encoding == "text":
            what, expected = f"BinaryData = False: {error.what}", f"{error.expected}; or binary data"
            raise VolumeError(error.where, what, expected) from error
        raise
    unit = find_unit(header.text("DistanceUnits"))
    volume = Volume(
        data, grid.spacing, grid.origin, grid.direction, frame="LPS",
        unit=None if unit is None else unit[0], slope=axis.slope, offset=axis.offset,
    )  # fmt: skip
    volume.files = names_beside(path, parts)
    return volume


def _sizes(header: MetaHeader) -> tuple[tuple[int, ...], int]:
    """Sizes (x, y, z) or (x, y, z, t), and how many channels each element has."""
    if header.text("ObjectType", "Image").lower() != "image":
        raise header.wrong("ObjectType", "Image")
    if not header.text("NDims"):
        raise header.wrong("NDims", "NDims = 3")
    dimension = header.whole("NDims", 3)
    channels = header.whole("ElementNumberOfChannels", 1)
    if dimension not in (3, 4) or not 1 <= channels <= _MOST_CHANNELS:
        raise VolumeError(
            str(header.path),
            f"{dimension}-D data with {channels} channel(s)",
            "3-D data, or 4-D data with times",
        )
    words = header.text("DimSize").split()
    plain = all(word.isascii() and word.isdecimal() and len(word) < 10 for word in words)
    if len(words) != dimension or not plain or min(map(int, words)) < 1:
        raise header.wrong("DimSize", f"{dimension} sizes above zero")
    return tuple(map(int, words)), channels


def _dtype(header: MetaHeader) -> np.dtype:
    name = _TYPES.get(header.text("ElementType").upper().removesuffix("_ARRAY"))
    if name is None:
        raise header.wrong("ElementType", ACCEPTED)
    return np.dtype(name).newbyteorder(">" if header.is_true("BinaryDataByteOrderMSB") else "<")


def _grid(header: MetaHeader, sizes: tuple[int, ...]) -> Grid:
    """The grid. A negative spacing becomes a flip of the direction. The time axis is ignored."""
    count = len(sizes)
    spacing, origin = header.numbers("ElementSpacing", count), header.numbers("Offset", count)
    matrix = header.numbers("TransformMatrix", count * count)
    spacing = np.ones(3) if spacing is None else spacing[:3]
    if not np.isfinite(spacing).all():
        raise header.wrong("ElementSpacing", "a spacing of finite numbers")
    # Each row is the world direction of one axis of the image.
    direction = np.eye(3) if matrix is None else matrix.reshape(count, count)[:3, :3].T
    origin = np.zeros(3) if origin is None else origin[:3]
    return Grid.from_steps(sizes[2::-1], direction * spacing, origin)


def _axis(header: MetaHeader) -> ValueAxis:
    names = "ElementToIntensityFunctionSlope", "ElementToIntensityFunctionOffset"
    slope, offset = (header.numbers(name, 1) for name in names)
    if slope is not None and slope[0] == 0:
        raise header.wrong(names[0], "a number that is not 0")
    return ValueAxis(
        1.0 if slope is None else float(slope[0]), 0.0 if offset is None else float(offset[0])
    )


def _parts(header: MetaHeader, sizes: tuple[int, ...], encoding: str) -> list[Part]:
    """The position of the voxels. HeaderSize bytes precede them in each file; with -1 they are at its end."""
    skipped = header.whole("HeaderSize", 0)
    if skipped < -1:
        raise header.wrong("HeaderSize", "-1, or bytes before the data")
    files = _files(header, sizes)
    start = max(skipped, 0)
    if files == [header.path]:
        start = skipped if skipped > 0 else header.rest
    size = header.whole("CompressedDataSize", 0) if encoding == "deflate" else 0
    behind = 0 if skipped == -1 and encoding == "raw" else None
    only = size if size > 0 and len(files) == 1 else None
    return [Part(file, start, 0, only, behind) for file in files]


def _files(header: MetaHeader, sizes: tuple[int, ...]) -> list[Path]:
    name = header.data_file
    words = name.split()
    if name.upper() == b"LOCAL":
        return [header.path]
    if words[:1] == [b"LIST"] and all(word.isdigit() for word in words[1:2]):
        axes = int(words[1]) if len(words) > 1 else None
        return listed_files(header.path, _list(header), axes, sizes)
    if b"%" in name and len(words) <= 3 and not exists_beside(header.path, name):
        return _numbered(header, sizes)
    return data_files(header.path, name, sizes)


def _list(header: MetaHeader) -> list[bytes]:
    """The names after ElementDataFile = LIST, one per line."""
    with header.path.open("rb") as file:
        file.seek(header.rest)
        text = file.read(LIST_LIMIT + 1)
    if len(text) > LIST_LIMIT:
        raise VolumeError(str(header.path), "an endless list of data files", f"{LIST_LIMIT} bytes")
    return [line.strip() for line in text.splitlines() if line.strip()]


def _numbered(header: MetaHeader, sizes: tuple[int, ...]) -> list[Path]:
    """The names of a pattern with first number, last number and step; the defaults are 1, the number needed, and 1."""
    words = header.data_file.split()
    try:
        numbers = [int(word) for word in words[1:]]
    except ValueError:
        return data_files(header.path, header.data_file, sizes)
    first = numbers[0] if numbers else 1
    last = numbers[1] if len(numbers) == 2 else first + sizes[-1] - 1
    names = numbered_names(header.path, words[0], first, last, 1)
    if names is None:
        return [find_beside(header.path, header.data_file)]
    return listed_files(header.path, names, None, sizes)
