"""Plain voxels: a .raw file, whose sizes and type the caller states, mapped into memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.options import ReadOptions
from clvol.volume.memory import check_memory
from clvol.volume.narrow import WIDE_TYPES
from clvol.volume.volume import ACCEPTED, Volume, check_type

_ORDERS: dict[str, Literal["<", ">"]] = {"little": "<", "big": ">"}


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a .raw file, x fastest, with nothing after the voxels.

    ``options.dims`` is (nx, ny, nz); ``options.dtype`` any name that numpy knows for an accepted type, such as
    "uint16", "<u2" or ">u2". Without "<" or ">" the byte order is that of the machine, or ``options.byte_order``.
    ``options.header_bytes`` precede the voxels; -1 means that the voxels are at the end of the file.
    """
    if options.dims is None or options.dtype is None:
        raise VolumeError(
            str(path), "a .raw file without dims or dtype", "dims (nx, ny, nz) and dtype"
        )
    shape = _shape(path, options.dims)
    dtype = _dtype(path, options.dtype, options.byte_order)
    native = check_type(dtype, str(path))
    nbytes = math.prod(shape) * dtype.itemsize
    stored = path.stat().st_size
    header = _header_bytes(path, options.header_bytes, stored - nbytes)
    if stored - header != nbytes:
        sizes = " x ".join(map(str, shape[::-1]))
        after = f" after {header} bytes of header" if header > 0 else ""
        hint = "; volume.header_bytes says what comes before them" if header == 0 < stored - nbytes else ""
        raise VolumeError(
            str(path),
            f"{max(stored - header, 0)} bytes of voxel data{after}",
            f"{nbytes} bytes for {sizes} {dtype.name}{hint}",
        )
    aligned = header % dtype.itemsize == 0
    mapped = dtype.isnative and aligned and native.name not in WIDE_TYPES
    check_memory(str(path), nbytes, options.memory_cap, mapped=mapped)
    voxels = np.memmap(path, dtype=dtype, mode="r", shape=shape, offset=header)
    return Volume(voxels if aligned else np.array(voxels))


def _dtype(path: Path, given: str | np.dtype, order: str | None) -> np.dtype:
    try:
        dtype = np.dtype(given)
    except (TypeError, ValueError, SyntaxError):
        raise VolumeError(str(path), f"dtype {given!r}", ACCEPTED) from None
    if order is None:
        return dtype
    if order not in _ORDERS:
        raise VolumeError(str(path), f"byte_order {order!r}", "'little' or 'big'")
    said = given[:1] if isinstance(given, str) else ""
    if said in ("<", ">") and said != _ORDERS[order]:
        what = f"dtype {given!r} with byte_order {order!r}"
        raise VolumeError(str(path), what, "one byte order")
    return dtype.newbyteorder(_ORDERS[order])


def _header_bytes(path: Path, given: Any, before: int) -> int:
    """The number of bytes before the voxels. ``before``: bytes of the file that are not voxels."""
    if given is None:
        return 0
    try:
        header = int(given)
        whole = header == given and -1 <= header < 2**63
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole:
        raise VolumeError(str(path), f"header_bytes {given}", "a number of bytes, or -1")
    return max(before, 0) if header == -1 else header


def _shape(path: Path, dims: Sequence[int]) -> tuple[int, int, int]:
    try:
        nx, ny, nz = sizes = tuple(int(n) for n in dims)
        whole = all(n == m and n >= 1 for n, m in zip(sizes, dims))
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole:
        raise VolumeError(str(path), f"dims {dims}", "three sizes (nx, ny, nz) of at least 1")
    return nz, ny, nx
