"""Reading voxels from plain or encoded files directly into their array, with every byte accounted for.

The format libraries read headers only: their own functions for voxels hold two or three copies of a compressed
volume, or do not notice truncated streams. The peak memory here is the volume and one block.
"""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.forward import ForwardReader, current_forward
from clvol.readers.numbers import hex_bytes, read_numbers
from clvol.volume.memory import check_memory, show_bytes

_BLOCK = 1 << 20
_ENCODED_BLOCK = 1 << 16  # decoders copy the rest of it with every block that they return
# Deflate cannot do better than 1032:1 (zlib's technical notes), so with less input the header is wrong.
_DEFLATE_RATIO = 1032
# Limits on data decoded only to be skipped: a few kilobytes of bzip2 can hold gigabytes.
_SKIP_RATIO, _SKIP_LEAST = 8, 64 << 20


@dataclass(frozen=True)
class Part:
    """The position of a part of the voxels in a file.

    ``offset``: first byte of the data. ``skip``: bytes to skip at the start of the decoded data, or of the text.
    ``size``: bytes of the encoded data; None: up to the end of the file. ``behind``: not None if the data are at the
    end, followed by that many bytes of the file, or of the decoded data if they are compressed; ``offset`` is then
    the earliest possible start.
    """

    path: Path
    offset: int = 0
    skip: int = 0
    size: int | None = None
    behind: int | None = None

    def start(self, nbytes: int) -> int:
        """The first of ``nbytes`` plain bytes."""
        if self.behind is None:
            return self.offset + self.skip
        return self.path.stat().st_size - self.behind - nbytes


def names_beside(path: Path, parts: Sequence[Part]) -> tuple[str, ...]:
    """The files of ``parts`` other than ``path``."""
    return tuple(os.fspath(part.path) for part in parts if part.path != path)


def read_parts(
    parts: Sequence[Part],
    shape: tuple[int, ...],
    dtype: np.dtype,
    *,
    encoding: str = "raw",
    memory_cap: int | None = None,
) -> np.ndarray:
    """The voxels [..., z, y, x] that a header describes, native-endian. ``parts`` hold equally many, one after the
    other.

    ``encoding`` is "raw", "deflate" (zlib or gzip stream), "bzip2", "text" (numbers separated by blanks) or "hex".
    VolumeError, naming the part's file, unless the decoded data have exactly the size of shape and type.
    """
    count = math.prod(shape) // len(parts)
    for part in parts:
        _check_promise(part, count, dtype, encoding)
    if encoding in ("deflate", "bzip2"):
        _check_skips(parts, math.prod(shape) * dtype.itemsize)
    check_memory(os.fspath(parts[0].path), math.prod(shape) * dtype.itemsize, memory_cap)
    samples = np.empty(shape, dtype=dtype.newbyteorder("=") if encoding == "text" else dtype)
    flat = samples.reshape(-1)
    for k, part in enumerate(parts):
        _fill(part, flat[k * count : (k + 1) * count], encoding)
    if not samples.dtype.isnative:
        samples = samples.byteswap(inplace=True)
    return samples.view(dtype.newbyteorder("="))


def read_chosen(
    parts: Sequence[Part],
    shape: tuple[int, ...],
    dtype: np.dtype,
    which: tuple[int | slice, ...],
    *,
    encoding: str = "raw",
    memory_cap: int | None = None,
) -> np.ndarray:
    """``array[which]``, three axes of the array that ``read_parts`` would return for any ``shape``.

    Of plain data in one file only these voxels are read into memory; of other data all voxels are.
    """
    if not any(isinstance(index, int) for index in which):
        return read_parts(parts, shape, dtype, encoding=encoding, memory_cap=memory_cap)
    forward = current_forward()
    leading = next((k for k, index in enumerate(which) if not isinstance(index, int)), len(which))
    if forward is not None and not any(isinstance(index, int) for index in which[leading:]):
        first = int(np.ravel_multi_index([int(k) for k in which[:leading]], shape[:leading]))  # type: ignore[arg-type]
        found = _read_run(parts, shape, leading, first, dtype, encoding, memory_cap, forward)
        if found is not None:
            return found
    if encoding != "raw" or len(parts) > 1:
        whole = read_parts(parts, shape, dtype, encoding=encoding, memory_cap=memory_cap)
        return np.ascontiguousarray(whole[which])
    part, count = parts[0], math.prod(shape)
    _check_promise(part, count, dtype, encoding)
    taken = math.prod(n for n, index in zip(shape, which) if not isinstance(index, int))
    check_memory(os.fspath(part.path), taken * dtype.itemsize, memory_cap)
    start = part.start(count * dtype.itemsize)
    mapped = np.memmap(part.path, dtype=dtype, mode="r", offset=start, shape=shape)
    return np.array(mapped[which], dtype=dtype.newbyteorder("="), order="C")


def _read_run(
    parts: Sequence[Part], shape: tuple[int, ...], leading: int, number: int, dtype: np.dtype, encoding: str,
    memory_cap: int | None, forward: ForwardReader,
) -> np.ndarray | None:  # fmt: skip
    """Volume ``number`` of those that follow one another: of ``shape`` [..., z, y, x] with ``leading`` axes of choices.
    Files and compressed data of other volumes are not read. None where the encoding does not allow that."""
    inner = shape[leading:]
    voxels, per_part = math.prod(inner), math.prod(shape) // len(parts)
    if len(parts) > 1:
        if voxels % per_part == 0:  # each file holds a part of one volume
            count = voxels // per_part
            own = parts[number * count : (number + 1) * count]
            return read_parts(own, inner, dtype, encoding=encoding, memory_cap=memory_cap)
        if per_part % voxels:
            return None
        held = per_part // voxels
        return read_chosen(
            [parts[number // held]], (held, *inner), dtype, (number % held, *[slice(None)] * len(inner)),
            encoding=encoding, memory_cap=memory_cap,
        )  # fmt: skip
    (part,) = parts
    if encoding not in ("deflate", "bzip2") or part.behind is not None:
        return None
    _check_promise(part, math.prod(shape), dtype, encoding)
    check_memory(os.fspath(part.path), voxels * dtype.itemsize, memory_cap)
    samples = np.empty(inner, dtype)
    view = samples.reshape(-1).view(np.uint8).data

    def opened() -> tuple[BufferedReader, Iterator[bytes]]:
        file = part.path.open("rb")
        file.seek(part.offset)
        return file, _decoded(_Limited(file, part.size), encoding)

    key = part, encoding, part.path.stat().st_mtime_ns
    try:
        got = forward.read(key, part.skip + number * len(view), view, opened)
    except (zlib.error, EOFError, OSError) as error:
        what = f"compressed data damaged or cut off ({error})"
        raise VolumeError(os.fspath(part.path), what, f"{len(view)} bytes of volume {number}") from error
    if got != len(view):
        _wrong_size(part.path, f"the encoded data end after {got} bytes of volume {number}", len(view))
    if not samples.dtype.isnative:
        samples = samples.byteswap(inplace=True)
    return samples.view(dtype.newbyteorder("="))


def _check_promise(part: Part, count: int, dtype: np.dtype, encoding: str) -> None:
    """VolumeError if the file is clearly too small, or would take long to decode in vain."""
    nbytes = count * dtype.itemsize
    stored = part.path.stat().st_size
    there = stored - part.offset
    if part.size is not None:
        if part.size > there:
            _wrong_size(part.path, f"{max(there, 0)} bytes of encoded data", part.size)
        there = part.size
    if encoding == "raw":
        if part.behind is None:
            _check_size(part.path, there - part.skip, nbytes)
        elif part.start(nbytes) < part.offset:
            said = f" before a byte skip of {-1 - part.behind}" if part.behind else ""
            _wrong_size(part.path, f"{max(there - part.behind, 0)} bytes of voxel data{said}", nbytes)
    elif encoding == "deflate":
        if nbytes + part.skip > _DEFLATE_RATIO * there:
            _wrong_size(part.path, f"{max(there, 0)} bytes of compressed data", nbytes)
    elif encoding == "text":
        if 2 * count - 1 > there:  # a digit and a blank per voxel
            raise VolumeError(os.fspath(part.path), "too few numbers", f"{count} numbers")
    elif encoding == "hex" and 2 * nbytes > there:
        what = f"encoding hex with {max(there, 0)} digits"
        raise VolumeError(os.fspath(part.path), what, f"{2 * nbytes} digits")


def _check_skips(parts: Sequence[Part], nbytes: int) -> None:
    """VolumeError if far more than ``nbytes`` would be decoded only to be skipped."""
    skipped, most = sum(part.skip for part in parts), _SKIP_RATIO * nbytes + _SKIP_LEAST
    if skipped > most:
        files = f" of {len(parts)} files" if len(parts) > 1 else ""
        what = f"a byte skip of {show_bytes(skipped)} in the compressed data{files}"
        raise VolumeError(os.fspath(parts[0].path), what, f"at most {show_bytes(most)}")


def _fill(part: Part, target: np.ndarray, encoding: str) -> None:
    """Fills ``target`` from one part."""
    with part.path.open("rb") as file:
        if encoding == "text":
            file.seek(part.offset + part.skip)
            read_numbers(file, target, os.fspath(part.path))
            return
        view = target.view(np.uint8).data
        if encoding == "raw":
            file.seek(part.start(len(view)))
            got = _fill_raw(file, view)
            _check_size(part.path, got, len(view))
        elif encoding == "hex":
            file.seek(part.offset + part.skip)
            _fill_decoded(part.path, hex_bytes(file, os.fspath(part.path)), 0, view)
        else:
            file.seek(part.offset)
            blocks = _decoded(_Limited(file, part.size), encoding)
            if part.behind is not None:
                blocks = iter([_last(part.path, blocks, len(view))])
            _fill_decoded(part.path, blocks, part.skip, view)


class _Limited:
    """The next ``size`` bytes of a file, or all that are left."""

    def __init__(self, file: BinaryIO, size: int | None) -> None:
        self._file, self._left = file, size

    def read(self, most: int) -> bytes:
        if self._left is not None:
            most = min(most, self._left)
        block = self._file.read(most)
        if self._left is not None:
            self._left -= len(block)
        return block


def _fill_raw(file: BufferedReader, view: memoryview) -> int:
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
                _wrong_size(path, "the encoded data hold more", len(view))
            if at > 0:
                view[max(start, 0) : at] = block[max(-start, 0) :]
    except (zlib.error, EOFError, OSError) as error:
        raise VolumeError(
            os.fspath(path),
            f"compressed data damaged or cut off after {max(at, 0)} bytes ({error})",
            f"{len(view)} bytes as the header promises",
        ) from error
    if at != len(view):
        _wrong_size(path, f"the encoded data hold {max(at, 0)} bytes", len(view))


def _last(path: Path, blocks: Iterator[bytes], nbytes: int) -> bytes:
    """The last ``nbytes`` of all that ``blocks`` yields, or all of them if there are fewer."""
    tail, passed = bytearray(), 0
    most = _SKIP_RATIO * nbytes + _SKIP_LEAST
    for block in blocks:
        tail += block
        if len(tail) > 2 * nbytes + _BLOCK:
            passed += len(tail) - nbytes
            del tail[: len(tail) - nbytes]
        if passed > most:
            what = f"more than {show_bytes(most)} of compressed data to skip"
            raise VolumeError(os.fspath(path), what, "less before the voxels")
    return bytes(tail[max(len(tail) - nbytes, 0) :])


def _decoded(file: _Limited, encoding: str) -> Iterator[bytes]:
    """The decoded data block by block. Raises zlib.error, EOFError or OSError if they are damaged."""
    yield from _inflated(file) if encoding == "deflate" else _unpacked(file)


def _unpacked(file: _Limited) -> Iterator[bytes]:
    """Decodes bzip2 streams one after the other (zero padding may follow)."""
    import bz2

    stream, pending = bz2.BZ2Decompressor(), b""
    while True:
        if not pending and stream.needs_input:
            pending = file.read(_ENCODED_BLOCK)
            if not pending:
                break
        if stream.eof:
            pending = pending.lstrip(b"\0")
            if not pending:
                pending = file.read(_ENCODED_BLOCK)
                if not pending:
                    return
                continue
            stream = bz2.BZ2Decompressor()
        block = stream.decompress(pending, _BLOCK)
        pending = stream.unused_data if stream.eof else b""
        if block:
            yield block
    raise EOFError("the stream ends early")


def _inflated(file: _Limited) -> Iterator[bytes]:
    """Decodes a zlib stream, or gzip members one after the other (zero padding may follow)."""
    stream = zlib.decompressobj(zlib.MAX_WBITS | 32)
    pending = b""
    while True:
        if not pending:
            pending = file.read(_ENCODED_BLOCK)
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
