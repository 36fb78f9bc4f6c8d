"""Voxels out of a file: plain or compressed, straight into their array, every byte accounted for.

The format libraries read headers; their own ways to the voxels hold two or three copies of a
compressed volume, or do not notice that a stream is too short. Here the peak is the volume and one
block.
"""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.memory import check_memory

_BLOCK = 1 << 20
# Deflate cannot do better than 1032:1 (zlib's technical notes), so less input is a lying header.
_DEFLATE_RATIO = 1032


def read_samples(
    path: Path,
    shape: tuple[int, int, int],
    dtype: np.dtype,
    *,
    offset: int | None,
    encoding: str = "raw",
    skip: int = 0,
    memory_cap: int | None = None,
) -> np.ndarray:
    """The voxels [z, y, x] that a header promises, native-endian.

    ``offset`` is the first byte of the data in the file, None for data that end with the file.
    ``encoding`` is "raw", "deflate" (zlib or gzip stream) or "bzip2"; ``skip`` bytes are left out
    at the start of the decoded data. VolumeError unless the decoded data have exactly the size that
    shape and type ask for.
    """
    nbytes = math.prod(shape) * dtype.itemsize
    stored = path.stat().st_size
    if encoding == "raw":
        if offset is None:
            offset = stored - nbytes
        _check_size(path, stored - offset - skip, nbytes)
    elif encoding == "deflate" and nbytes > _DEFLATE_RATIO * stored:
        _wrong_size(path, f"{stored} bytes of compressed data", nbytes)
    check_memory(str(path), nbytes, memory_cap)
    samples = np.empty(shape, dtype=dtype)
    view = memoryview(samples.reshape(-1).view(np.uint8))
    with path.open("rb") as file:
        if encoding == "raw":
            file.seek(offset + skip)
            got = _fill_raw(file, view)
            _check_size(path, got, nbytes)
        else:
            file.seek(offset or 0)
            _fill_decoded(path, _decoded(file, encoding), skip, view)
    if not samples.dtype.isnative:
        samples = samples.byteswap(inplace=True)
    return samples.view(dtype.newbyteorder("="))


def _fill_raw(file: BinaryIO, view: memoryview) -> int:
    got = 0
    while got < len(view):
        step = file.readinto(view[got : got + (1 << 26)])
        if not step:
            break
        got += step
    return got


def _fill_decoded(path: Path, blocks: Iterator[bytes], skip: int, view: memoryview) -> None:
    at = -skip
    try:
        for block in blocks:
            start, at = at, at + len(block)
            if at > len(view):
                _wrong_size(path, "the compressed data hold more", len(view))
            if at > 0:
                view[max(start, 0) : at] = block[max(-start, 0) :]
    except (zlib.error, EOFError, OSError) as error:
        raise VolumeError(
            str(path),
            f"compressed data damaged or cut off after {max(at, 0)} bytes ({error})",
            f"{len(view)} bytes as the header promises",
        ) from error
    if at != len(view):
        _wrong_size(path, f"the compressed data hold {max(at, 0)} bytes", len(view))


def _decoded(file: BinaryIO, encoding: str) -> Iterator[bytes]:
    """The decoded data block by block; zlib.error, EOFError or OSError where they are damaged."""
    if encoding == "deflate":
        yield from _inflated(file)
        return
    import bz2

    with bz2.BZ2File(file) as stream:
        while block := stream.read(_BLOCK):
            yield block


def _inflated(file: BinaryIO) -> Iterator[bytes]:
    """Decodes a zlib stream, or gzip members one after the other (zero padding may follow)."""
    stream = zlib.decompressobj(zlib.MAX_WBITS | 32)
    pending = b""
    while True:
        if not pending:
            pending = file.read(_BLOCK)
            if not pending:
                break
        if stream.eof:
            pending = pending.lstrip(b"\0")
            if not pending:
                continue
            stream = zlib.decompressobj(zlib.MAX_WBITS | 16)
        block = stream.decompress(pending, _BLOCK)
        pending = stream.unused_data if stream.eof else stream.unconsumed_tail
        if block:
            yield block
    while not stream.eof and (block := stream.decompress(b"", _BLOCK)):
        yield block
    if not stream.eof:
        raise EOFError("the stream ends early")


def _check_size(path: Path, got: int, nbytes: int) -> None:
    if got != nbytes:
        _wrong_size(path, f"{max(got, 0)} bytes of voxel data", nbytes)


def _wrong_size(path: Path, what: str, nbytes: int) -> None:
    raise VolumeError(os.fspath(path), what, f"{nbytes} bytes as the header promises")
