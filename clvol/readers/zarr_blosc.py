"""Checks of the sizes that chunks compressed by Blosc claim: the decoder allocates that much, up to 2 GiB per chunk,
before it is compared with the chunk's shape.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from clvol.errors import VolumeError
from clvol.readers.remote import RemotePath
from clvol.store.arrays import cores
from clvol.volume.memory import check_memory

_LARGEST = 2**31
_HEADER = 16
_NOTHING = 2**64 - 1  # the offset of a chunk that is missing from its shard


def check_blosc(path: Path | RemotePath, where: str, chunk_bytes: int, memory_cap: int | None) -> None:
    """VolumeError if a chunk of the array claims to be larger than its shape. Chunks behind a URL are not examined.

    ``path`` is the array's folder. Nothing is read if the largest possible claims fit into memory anyway.
    """
    if not isinstance(path, Path):
        return
    try:
        check_memory(where, cores() * _LARGEST, memory_cap)
        return
    except VolumeError:
        pass
    shard = _layout(path)
    if shard is None:
        return
    for file in _chunk_files(path):
        with file.open("rb") as stream:
            for start in _starts(stream, file, shard):
                stream.seek(start)
                header = stream.read(_HEADER)
                claimed = int.from_bytes(header[4:8], "little")
                if len(header) == _HEADER and claimed > chunk_bytes:
                    raise VolumeError(
                        where,
                        f"chunk {file.relative_to(path)} claims {claimed} bytes",
                        f"{chunk_bytes} as the array's metadata say",
                    )


def _layout(path: Path) -> tuple[int, int, bool] | None:
    """(chunks per file, bytes of the index after them, whether the index comes first instead); None for an array
    without Blosc.
    """
    if (path / ".zarray").exists():
        array = json.loads((path / ".zarray").read_text(encoding="utf-8"))
        compressor = array.get("compressor") or {}
        return (1, 0, False) if compressor.get("id") == "blosc" else None
    array = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
    codecs = array["codecs"]
    outer = array["chunk_grid"]["configuration"]["chunk_shape"]
    for codec in codecs:
        if codec["name"] == "blosc":
            return 1, 0, False
        if codec["name"] == "sharding_indexed":
            how = codec["configuration"]
            if any(inner["name"] == "blosc" for inner in how["codecs"]):
                count = math.prod(n // m for n, m in zip(outer, how["chunk_shape"]))
                checked = any(one["name"] == "crc32c" for one in how["index_codecs"])
                size = 16 * count + 4 * checked
                return count, size, how.get("index_location", "end") == "start"
    return None


def _chunk_files(path: Path) -> Iterator[Path]:
    for folder, _, names in os.walk(path):
        for name in names:
            if not name.startswith(".") and name != "zarr.json":
                yield Path(folder, name)


def _starts(stream: BinaryIO, file: Path, shard: tuple[int, int, bool]) -> Iterator[int]:
    """The offsets of the chunks in the file."""
    count, size, first = shard
    if not size:
        yield 0
        return
    stored = file.stat().st_size
    if stored < size:
        return
    stream.seek(0 if first else stored - size)
    index: Any = memoryview(stream.read(16 * count)).cast("Q")
    for start, length in zip(index[::2], index[1::2]):
        if start != _NOTHING and start + length <= stored:
            yield start
