"""Bare voxels: a .raw file whose sizes and type the caller knows, mapped into memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.memory import check_memory
from clvol.volume.readers.options import ReadOptions
from clvol.volume.volume import ACCEPTED, Volume, check_type


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a .raw file: x fastest, nothing before or after the voxels.

    ``options.dims`` is (nx, ny, nz); ``options.dtype`` any name that numpy knows for an accepted
    type, such as "uint16" (this machine's byte order), "<u2" or ">u2".
    """
    if options.dims is None or options.dtype is None:
        raise VolumeError(
            str(path), "a .raw file without dims or dtype", "dims (nx, ny, nz) and dtype"
        )
    shape = _shape(path, options.dims)
    try:
        dtype = np.dtype(options.dtype)
    except (TypeError, ValueError, SyntaxError):
        raise VolumeError(str(path), f"dtype {options.dtype!r}", ACCEPTED) from None
    check_type(dtype, str(path))
    nbytes = math.prod(shape) * dtype.itemsize
    stored = path.stat().st_size
    if stored != nbytes:
        sizes = " x ".join(map(str, shape[::-1]))
        raise VolumeError(
            str(path), f"{stored} bytes of voxel data", f"{nbytes} bytes for {sizes} {dtype.name}"
        )
    check_memory(str(path), nbytes, options.memory_cap, mapped=dtype.isnative)
    return Volume(np.memmap(path, dtype=dtype, mode="r", shape=shape))


def _shape(path: Path, dims: Sequence[int]) -> tuple[int, int, int]:
    try:
        sizes = tuple(int(n) for n in dims)
        whole = len(sizes) == 3 and all(n == m and n >= 1 for n, m in zip(sizes, dims))
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole:
        raise VolumeError(str(path), f"dims {dims}", "three sizes (nx, ny, nz) of at least 1")
    return sizes[::-1]
