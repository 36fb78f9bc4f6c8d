"""The files that a volume consists of, which must not be overwritten, found without reading the volume.

This is separate from the readers and deliberately generous: every existing file that a header may refer to counts.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

_HEADER = 1 << 20
_NUMBER = re.compile(r"%(?:[-+ 0#]*\d*(?:\.\d+)?)[dioux]")
_NRRD = (".nrrd", ".nhdr")
_META = (".mha", ".mhd")
_PAIR = (".hdr", ".img", ".hdr.gz", ".img.gz")
_OME_FILE = re.compile(rb'FileName="([^"]{1,1000})"')


def parts_of(path: str | os.PathLike) -> list[Path]:
    """Existing files beside ``path`` that the volume in it may be spread over.

    These are the files that a NRRD or MetaImage header names, the other half of a pair, the other files of an
    OME-TIFF, and the DICOM files in the folder of one.
    """
    path = Path(path)
    name = path.name.lower()
    try:
        if not path.is_file():
            return []
        if name.endswith(_NRRD):
            found = _named(path, r"data\s*file", ":")
        elif name.endswith(_META):
            found = _named(path, "elementdatafile", "=")
        elif name.endswith(_PAIR):
            found = _pair(path)
        elif name.endswith((".tif", ".tiff")):
            found = _ome(path)
        else:
            found = iter(())
        if is_dicom(path):
            found = (part for part in sorted(path.parent.iterdir()) if is_dicom(part))
        return [part for part in dict.fromkeys(found) if part != path]
    except (OSError, ValueError):
        return []


def is_dicom(path: Path) -> bool:
    """Whether this is a DICOM file; others in its folder may then be slices of the same volume."""
    if not os.path.isfile(path):
        return False
    with path.open("rb") as file:
        return file.read(132)[128:] == b"DICM" or path.suffix.lower() in (".dcm", ".ima")


def _named(path: Path, key: str, sign: str) -> Iterator[Path]:
    """The files that the value of ``key`` and the lines after it may name. The header ends where voxels begin: at a
    byte that no text has, and in NRRD at an empty line."""
    with path.open("rb") as file:
        head = file.read(_HEADER)
    heading = re.compile(rf"\s*{key}\s*{sign}+=?(.*)", re.IGNORECASE)
    taken = False
    for raw in head.partition(b"\0")[0].split(b"\n"):
        line = os.fsdecode(raw).rstrip("\r")
        if sign == ":" and not line:
            return
        match = heading.fullmatch(line)
        if match is not None:
            taken = True
            yield from _files(path.parent, match[1])
        elif taken:
            if not line.strip() or b"\0" in raw:
                return
            yield from _files(path.parent, line)


def _files(folder: Path, text: str) -> Iterator[Path]:
    """The files named by ``text``, or by a part of it that ends at a blank.

    A pattern of numbers stands for every file that matches it.
    """
    words = text.strip().split(" ")
    for count in range(len(words), 0, -1):
        name = " ".join(words[:count]).strip().strip('"')
        if not name or "\0" in name:
            continue
        if _NUMBER.search(name):
            yield from _matching(folder / name)
        elif os.path.isfile(folder / name):
            yield folder / name


def _matching(pattern: Path) -> Iterator[Path]:
    pieces = _NUMBER.split(pattern.name)
    fits = re.compile(r"\s*[-+0-9a-fA-F]+".join(map(re.escape, pieces)))
    if not os.path.isdir(pattern.parent):
        return
    for entry in os.scandir(pattern.parent):
        if fits.fullmatch(entry.name) and entry.is_file():
            yield pattern.parent / entry.name


def _pair(path: Path) -> Iterator[Path]:
    ending = max((e for e in _PAIR if path.name.lower().endswith(e)), key=len)
    stem = path.name[: -len(ending)].lower()
    for entry in os.scandir(path.parent):
        name = entry.name.lower()
        if name.startswith(stem) and name[len(stem) :] in _PAIR and entry.is_file():
            yield path.parent / entry.name


def _ome(path: Path) -> Iterator[Path]:
    """The files that the OME-XML names. It is a text of the first page, near the beginning or the end of the file."""
    with path.open("rb") as file:
        known = file.read(_HEADER)
        file.seek(max(0, os.fstat(file.fileno()).st_size - _HEADER))
        known += file.read(_HEADER)
    if b"OME" in known:
        for match in set(_OME_FILE.findall(known)):
            beside = path.parent / os.fsdecode(match)
            if os.path.isfile(beside):
                yield beside
