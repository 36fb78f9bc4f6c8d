"""Checks that the chain of page directories in a TIFF file has no loop."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from clvol.errors import VolumeError

# (format of an offset, of the number of tags, bytes of a tag) by the version in the header.
_KINDS = {42: ("I", "H", 12), 43: ("Q", "Q", 20)}


def check_chain(path: Path, where: str) -> None:
    """VolumeError if the chain of pages has a loop, which tifffile would follow forever.

    Other mistakes in the file are left to tifffile.
    """
    with path.open("rb") as file:
        header = file.read(16)
        order = {b"II": "<", b"MM": ">"}.get(header[:2])
        if order is None or len(header) < 16:
            return
        kind = _KINDS.get(struct.unpack(order + "H", header[2:4])[0])
        if kind is None:
            return
        pointer, count, tag = order + kind[0], order + kind[1], kind[2]
        at = 4 if kind[0] == "I" else 8
        offset = struct.unpack_from(pointer, header, at)[0]
        seen: set[int] = set()
        while offset:
            if offset in seen:
                what = f"a chain of pages that leads back after {len(seen)} of them"
                raise VolumeError(where, what, "an undamaged TIFF file")
            seen.add(offset)
            if offset >= 2**62:  # beyond the end of any file
                return
            file.seek(offset)
            tags = _number(file, count)
            if tags is None:
                return
            if tags >= 2**40:
                return
            file.seek(offset + struct.calcsize(count) + tags * tag)
            offset = _number(file, pointer)


def _number(file: BinaryIO, form: str) -> int | None:
    raw = file.read(struct.calcsize(form))
    return struct.unpack(form, raw)[0] if len(raw) == struct.calcsize(form) else None
