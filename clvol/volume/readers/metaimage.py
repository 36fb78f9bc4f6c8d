"""MetaImage: .mha with its data inside, .mhd with one data file beside it.

SimpleITK reads the geometry. Its own way to the voxels (MetaIO) takes a compressed stream that is
too short without a word, so the voxels are read by ``read_samples``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.grid import Grid
from clvol.volume.readers.itk import itk_grid, itk_type, read_information
from clvol.volume.readers.options import ReadOptions
from clvol.volume.readers.samples import read_samples
from clvol.volume.volume import Volume

_HEADER_LIMIT = 1 << 20


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a MetaImage file; world coordinates are ITK's (LPS)."""
    fields, attached = _fields(path)
    reader = read_information(path, "MetaImageIO")
    channels, dimension = reader.GetNumberOfComponents(), reader.GetDimension()
    if channels != 1 or dimension != 3:
        raise VolumeError(
            str(path),
            f"{dimension}-D data with {channels} channel(s)",
            "3-D data with one scalar per voxel",
        )
    sizes = fields.get("dimsize", "").split()
    if len(sizes) != 3 or not all(word.isdecimal() and int(word) > 0 for word in sizes):
        raise VolumeError(str(path), f"DimSize = {fields.get('dimsize')}", "three sizes above zero")
    shape = tuple(int(word) for word in sizes[::-1])
    if not _true(fields.get("binarydata", "True")):
        raise VolumeError(str(path), "BinaryData = False", "binary data")
    big = fields.get("binarydatabyteordermsb", fields.get("elementbyteordermsb", "False"))
    dtype = itk_type(reader, str(path)).newbyteorder(">" if _true(big) else "<")
    grid = itk_grid(reader, shape)
    source, start = _data_file(path, fields["elementdatafile"], attached)
    header_size = int(fields.get("headersize", "0"))
    if header_size < -1 or (header_size > 0 and source == path):
        raise VolumeError(str(path), f"HeaderSize = {header_size}", "-1, 0 or a detached file's")
    compressed = _true(fields.get("compresseddata", "False"))
    data = read_samples(
        source,
        shape,
        dtype,
        offset=None if header_size == -1 and not compressed else start + max(header_size, 0),
        encoding="deflate" if compressed else "raw",
        memory_cap=options.memory_cap,
    )
    return Volume(data, grid.spacing, grid.origin, grid.direction, frame="LPS")


def _fields(path: Path) -> tuple[dict[str, str], int]:
    """The header's fields, names in lower case, and the first byte after its last line."""
    fields: dict[str, str] = {}
    room = _HEADER_LIMIT
    with path.open("rb") as file:
        while line := file.readline(room):
            room -= len(line)
            name, equals, value = line.partition(b"=")
            if not equals or room <= 0 or not name.strip().isalnum():
                break
            key = name.strip().decode("ascii", "replace").lower()
            fields[key] = value.strip().decode("utf-8", "replace")
            if key == "elementdatafile":
                return fields, file.tell()
    raise VolumeError(
        str(path), "no MetaImage header", "lines NAME = VALUE that end with ElementDataFile"
    )


def _true(word: str) -> bool:
    return word[:1].lower() in ("t", "1", "y")


def _data_file(path: Path, name: str, attached: int) -> tuple[Path, int]:
    if name.upper() == "LOCAL":
        return path, attached
    if not name or name.split()[0].upper() == "LIST" or "%" in name:
        raise VolumeError(str(path), f"ElementDataFile = {name}", "LOCAL or one data file")
    source = path.parent / name
    if not source.is_file():
        raise VolumeError(str(path), f"data file {name!r} is missing", "the file beside the header")
    return source, 0
