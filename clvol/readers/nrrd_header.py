"""Parsing NRRD headers in all their spellings.

pynrrd parses the values. Before that, lines are normalised to the spelling that it accepts: field names in any case
and with or without blanks, blanks inside vectors, and line ends of other systems; ``key:=value`` pairs are left out
even if they are named like a field. Format: teem.sourceforge.net/nrrd/format.html.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from clvol.errors import ClvolError, VolumeError

LIMIT = 1 << 20  # bytes of a header
LIST_LIMIT = 1 << 26  # and of the names of data files after it
_READ = (
    "dimension", "type", "sizes", "encoding", "endian", "space", "space dimension",
    "space directions", "space origin", "space units", "spacings", "axis mins", "axis maxs",
    "centerings", "kinds", "units", "line skip", "byte skip", "data file",
)  # fmt: skip
# Fields that are recognised and ignored.
_IGNORED = (
    "content", "number", "block size", "min", "max", "old min", "old max", "sample units",
    "thicknesses", "labels", "measurement frame",
)  # fmt: skip
_ALIASES = {"centers": "centerings"}
_BY_LETTERS = {name.replace(" ", ""): name for name in (*_READ, *_IGNORED)} | _ALIASES
_LOWERED = ("type", "encoding", "endian", "centerings", "space directions", "space origin")
_MAGIC = re.compile(rb"NRRD00(0[1-6]|\.01)$")


@dataclass
class NrrdHeader:
    """``fields`` by the names of the format's document, as pynrrd gives them; ``data_file``: the
    bytes after "data file:", or None; ``listed``: the lines after "data file: LIST"; ``segments``: there are pairs that
    name segments, as in the files *.seg.nrrd of 3D Slicer."""

    fields: dict[str, Any] = field(default_factory=dict)
    data_file: bytes | None = None
    listed: list[bytes] = field(default_factory=list)
    segments: bool = False

    def get(self, name: str, default: Any = None) -> Any:
        return self.fields.get(name, default)


def read_header(path: Path, file: BinaryIO) -> NrrdHeader:
    """The header up to its blank line, leaving ``file`` at the first byte after it."""
    header = NrrdHeader()
    texts: dict[str, str] = {}
    for line in _lines(path, file, header):
        header.segments |= line.startswith(b"Segment0_") and b":=" in line
        name, value = _parted(path, line)
        if name == "data file":
            texts[name], header.data_file = "-", value
            continue
        if name not in _READ:
            continue
        text = _plain(name, value)
        if texts.setdefault(name, text) != text:
            raise VolumeError(str(path), f"two fields {name!r} in the NRRD header", "one of them")
    texts.pop("data file", None)
    header.fields = _parsed(path, texts)
    return header


def _lines(path: Path, file: BinaryIO, header: NrrdHeader):
    """The header's fields and pairs; the names of LIST go into ``header``."""
    room, is_first, in_list = LIMIT, True, False
    while line := file.readline(room):
        room -= len(line)
        if is_first and not _MAGIC.match(line.rstrip()):
            raise VolumeError(str(path), "no NRRD header", "a file that starts with NRRD000")
        if room <= 0:
            raise VolumeError(str(path), "endless NRRD header", f"at most {LIMIT} bytes")
        text = line.strip() if in_list else line.rstrip()
        if not text:
            return
        if in_list:
            header.listed.append(text)
        elif not is_first and not text.startswith(b"#"):
            yield text
            in_list = header.data_file is not None and _is_list(header.data_file)
            room += LIST_LIMIT if in_list else 0
        is_first = False


def _is_list(data_file: bytes) -> bool:
    return bool(re.fullmatch(rb"LIST(\s+\d+)?", data_file))


def _parted(path: Path, line: bytes) -> tuple[str | None, bytes]:
    """Name (None: a field that the format does not know) and value of a line of the header."""
    name, colon, value = line.partition(b":")
    known = _BY_LETTERS.get(re.sub(r"[\s_]+", "", name.decode("latin-1")).lower())
    if not colon:
        shown = line[:60].decode("ascii", "replace")
        raise VolumeError(str(path), f"NRRD header line {shown!r}", "FIELD: VALUE")
    # A pair key:=value, or an unknown field; a blank follows the colon of a field.
    if known is None or value.startswith(b"=") or (value[:1] > b" " and b":=" in value):
        return None, value
    return known, value.strip()


def _plain(name: str, value: bytes) -> str:
    """A value in the form that pynrrd accepts."""
    text = value.decode("latin-1")
    if name in _LOWERED:
        text = text.lower()
    if name in ("space directions", "space origin"):
        text = re.sub(r"\s*([(,)])\s*", r"\1", text)
        text = re.sub(r"\)\s*(?=\S)", ") ", text)
        text = re.sub(r"(?<=none)\s*(?=\()", " ", text)
    return re.sub(r"\s+", " ", text).strip()


def _parsed(path: Path, texts: dict[str, str]) -> dict[str, Any]:
    import nrrd

    fields: dict[str, Any] = {}
    for name, text in texts.items():
        if name in ("units", "space units"):
            fields[name] = re.findall(r'"([^"]*)"', text) or text.split()
            continue
        if name == "sizes" and not re.fullmatch(r"\d+( \d+)*", text):  # pynrrd would cut 4.5 to 4
            raise VolumeError(str(path), f"sizes {text[:60]}", "whole numbers of at least 1")
        try:
            fields[name] = nrrd.read_header(["NRRD0005", f"{name}: {text}"])[name]
        except (ClvolError, MemoryError, ImportError):
            raise
        except Exception as error:  # it raises exceptions of many types for malformed values
            what = f"field {name!r} is {text[:60]!r} ({error})"
            raise VolumeError(str(path), what, "a value as the NRRD format has it") from None
    return fields
