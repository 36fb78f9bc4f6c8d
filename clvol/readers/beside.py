"""The data files that a header names: one file, a list, or a numbered pattern."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from clvol.errors import VolumeError

# One integer conversion of C's printf; %% is a percent sign.
_CONVERSION = re.compile(rb"%[-+0]*\d{0,3}(?:\.\d{1,3})?[diu]")
_MOST_FILES = 10**6


def find_beside(header: Path, name: bytes) -> Path:
    """The file called ``name`` (bytes as in ``header``), relative to the header.

    Names are tried byte by byte, then as UTF-8 and Latin-1 text in the other encoding and in the other Unicode normal
    form, and with slashes in place of backslashes. VolumeError if no such file exists.
    """
    for spelled in _spellings(name):
        try:
            found = header.parent / os.fsdecode(spelled)
            if found.is_file():
                return found
        except (ValueError, OSError):  # a null character, or a name that is too long
            continue
    shown = _text(name)
    raise VolumeError(str(header), f"data file {shown!r} is missing", "the file beside the header")


def _spellings(name: bytes) -> Sequence[bytes]:
    texts = []
    for encoding in ("utf-8", "latin-1"):
        try:
            texts.append(name.decode(encoding))
        except UnicodeDecodeError:
            continue
    found = [name]
    for text in texts:
        for form in ("NFC", "NFD"):
            composed = unicodedata.normalize(form, text)
            for other in ("utf-8", "latin-1"):
                with suppress(UnicodeEncodeError):
                    found.append(composed.encode(other))
    found += [one.replace(b"\\", b"/") for one in found if b"\\" in one]
    return list(dict.fromkeys(found))


def _text(name: bytes) -> str:
    try:
        return name.decode("utf-8")
    except UnicodeDecodeError:
        return name.decode("latin-1")


def exists_beside(header: Path, name: bytes) -> bool:
    """Whether ``find_beside`` finds it."""
    try:
        find_beside(header, name)
    except VolumeError:
        return False
    return True


def numbered_names(
    header: Path, pattern: bytes, first: int, last: int, step: int
) -> list[bytes] | None:
    """The names of a ``pattern`` such as ``slice_%03d.raw`` for first, first + step, ..., last; None if it is not a
    pattern. VolumeError if the numbers do not lead from the first to the last.
    """
    spans = [match.span() for match in _CONVERSION.finditer(pattern.replace(b"%%", b"\0\0"))]
    if len(spans) != 1 or b"\0" in pattern:
        return None
    if step == 0 or (last - first) * step < 0 or (last - first) // step >= _MOST_FILES:
        numbers = f"{first} {last} {step}"
        raise VolumeError(str(header), f"data files numbered {numbers}", "first, last and step")
    begin, end = spans[0]
    conversion = pattern[begin:end]
    before, after = (part.replace(b"%%", b"%") for part in (pattern[:begin], pattern[end:]))
    count = (last - first) // step + 1
    return [before + conversion % (first + k * step) + after for k in range(count)]


def count_of_files(sizes: Sequence[int], per_file: int | None) -> tuple[int, bool]:
    """The number of files of a volume of ``sizes`` (x, y, z), and whether any divisor of the last size would do as
    well.

    Each file has ``per_file`` axes (None: one less than the volume). Files with as many axes as the volume may divide
    the last axis in any way.
    """
    axes = len(sizes) - 1 if per_file is None else per_file
    if axes == len(sizes):
        return sizes[-1], True
    count = 1
    for n in sizes[axes:]:
        count *= n
    return count, False


def check_count(header: Path, count: int, sizes: Sequence[int], per_file: int | None) -> None:
    """VolumeError unless ``count`` data files can hold the volume."""
    if per_file is not None and not 1 <= per_file <= len(sizes):
        what = f"data files of {per_file} axes each"
        raise VolumeError(str(header), what, f"from 1 to {len(sizes)} axes")
    wanted, or_divisor = count_of_files(sizes, per_file)
    if count == wanted or (or_divisor and count and wanted % count == 0):
        return
    each = "slab" if or_divisor else "slice" if wanted == sizes[-1] else "part"
    raise VolumeError(
        str(header), f"{count} data files named", f"one data file per {each}, {wanted} in all"
    )


_NUMBERED = re.compile(rb"(?P<pattern>.+?)(?P<numbers>(\s+[-+]?\d{1,9}){3,4})$", re.DOTALL)


def data_files(header: Path, named: bytes, sizes: Sequence[int]) -> list[Path]:
    """The files that ``named``, the data file field of a header, refers to.

    It is one file, or a pattern with first, last and step (and the number of axes of each file), sufficient for
    ``sizes`` (x, y, z). A file of exactly that name takes precedence over a pattern. VolumeError names missing files.
    """
    numbered = _NUMBERED.match(named)
    if numbered is None or b"%" not in named or exists_beside(header, named):
        return [find_beside(header, named)]
    first, last, step, *axes = (int(word) for word in numbered["numbers"].split())
    names = numbered_names(header, numbered["pattern"], first, last, step)
    if names is None:
        return [find_beside(header, named)]
    check_count(header, len(names), sizes, axes[0] if axes else None)
    return [find_beside(header, name) for name in names]


def listed_files(
    header: Path, names: Sequence[bytes], axes: int | None, sizes: Sequence[int]
) -> list[Path]:
    """The files of a list in the header. ``axes``: the number of axes of each file, None for one less than the
    volume.
    """
    check_count(header, len(names), sizes, axes)
    return [find_beside(header, name) for name in names]
