"""Parsing MetaImage headers, without MetaIO, which some headers crash.

A header consists of lines ``Name = Value``, in any order, up to ElementDataFile. Fields that are not used may have
any name (SimpleITK writes an image's metadata there) and any text as their value.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clvol.errors import VolumeError

LIMIT = 1 << 20  # bytes of a header
LIST_LIMIT = 1 << 26  # and of the names of data files after it
_DATA_FILE = "ElementDataFile"
# Alternative names of a field, as in MetaIO; the first that exists is used.
_ALIASES = {
    "Offset": ("Offset", "Position", "Origin"),
    "TransformMatrix": ("TransformMatrix", "Rotation", "Orientation"),
    "BinaryDataByteOrderMSB": ("BinaryDataByteOrderMSB", "ElementByteOrderMSB"),
    "ElementSpacing": ("ElementSpacing", "ElementSize"),
}
_READ = {
    "ObjectType", "NDims", "DimSize", "ElementType", "ElementNumberOfChannels", "BinaryData",
    "DistanceUnits",
    "CompressedData", "CompressedDataSize", "HeaderSize", "ElementToIntensityFunctionSlope",
    "ElementToIntensityFunctionOffset", _DATA_FILE,
}.union(*_ALIASES.values())  # fmt: skip


@dataclass
class MetaHeader:
    """``fields``: text by name; ``data_file``: ElementDataFile as bytes; ``rest``: the first byte
    after the header."""

    path: Path
    fields: dict[str, str]
    data_file: bytes
    rest: int

    def text(self, name: str, default: str = "") -> str:
        names = _ALIASES.get(name, (name,))
        return next((self.fields[one] for one in names if one in self.fields), default)

    def is_true(self, name: str, default: bool = False) -> bool:
        word = self.text(name)
        return word[:1].lower() in ("t", "1", "y") if word else default

    def whole(self, name: str, default: int) -> int:
        """The field as a whole number."""
        word = self.text(name, str(default))
        try:
            return int(word) if len(word) < 20 else int("")
        except ValueError:
            raise self.wrong(name, "a whole number") from None

    def numbers(self, name: str, count: int) -> np.ndarray | None:
        """The field as ``count`` numbers, float64; None if it does not exist."""
        text = self.text(name)
        if not text:
            return None
        try:
            found = [float(word) for word in text.split()]
        except ValueError:
            found = []
        if len(found) != count:
            raise self.wrong(name, f"{count} numbers")
        return np.array(found)

    def wrong(self, name: str, expected: str) -> VolumeError:
        said = self.text(name)
        what = f"{name} = {said[:60]}" if said else f"no {name}"
        return VolumeError(str(self.path), what, expected)


def read_header(path: Path) -> MetaHeader:
    """The header up to and including ElementDataFile."""
    fields: dict[str, str] = {}
    room = LIMIT
    with path.open("rb") as file:
        while room > 0 and (line := file.readline(room)):
            room -= len(line)
            key, value = _parted(line)
            if key in _READ:
                fields[key] = value.decode("utf-8", "replace")
            if key == _DATA_FILE:
                return MetaHeader(path, fields, value, file.tell())
            if not fields and room < LIMIT - 4096:  # a file that begins without fields is not a MetaImage
                break
    raise VolumeError(
        str(path), "no MetaImage header", "lines NAME = VALUE that end with ElementDataFile"
    )


def _parted(line: bytes) -> tuple[str, bytes]:
    """Name and value of a field. Lines of another form are not fields: the text of metadata may span several lines."""
    name, equals, value = line.partition(b"=")
    if not equals:
        name, equals, value = line.partition(b":")
    return name.strip().decode("latin-1") if equals else "", value.strip()
