"""NIfTI-1 and NIfTI-2: .nii, .nii.gz, and pairs .hdr and .img.

nibabel parses the header and the affine; the voxels are read by ``read_parts``.
"""

from __future__ import annotations

import gzip
import math
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.forward import current_forward
from clvol.readers.nifti_header import (
    files_of,
    grid_of,
    is_packed,
    read_header,
    sizes_of,
    unit_of,
)
from clvol.readers.options import ReadOptions
from clvol.readers.samples import Part, read_chosen, read_parts
from clvol.volume.memory import check_memory
from clvol.volume.volume import Volume, check_type

_DEFLATE_RATIO = 1032  # zlib's technical notes

_LABELS = 1002  # NIFTI_INTENT_LABEL

def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a NIfTI file or pair, in NIfTI's world coordinates (RAS), by sform, else by qform.

    Without either, only voxel sizes are known, and the frame is that of the indices. Where ``scl_slope`` and
    ``scl_inter`` are a real scaling (not slope 0, nor slope 1 with inter 0) the values are slope * stored + inter,
    computed in float64 and kept as float32 for stored 8- and 16-bit integers and float32, as float64 for wider types.
    Without a scaling the stored type is kept. ``options`` select one of several times (the fourth axis) and channels
    (the fifth).
    """
    header_file, data_file = files_of(path)
    header, single = read_header(header_file)
    shape, times, channels = sizes_of(path, header)
    stored = header.get_data_dtype()
    scaling = _scaling(header, options)
    if scaling is None or not (stored.kind in "iu" and stored.itemsize == 4):
        check_type(stored, str(path))
    grid, frame = grid_of(path, header, shape, options)
    result = _scaled_type(stored)
    voxel = stored.itemsize + (0 if scaling is None else result.itemsize)
    check_memory(str(path), voxel * math.prod(shape), options.memory_cap)
    start = _data_offset(path, header, single)
    which = options.choose("time", str(path), [None] * times) if times > 1 else 0
    if channels > 1:
        which += times * options.choose("channel", str(path), [None] * channels)
    data = _voxels(data_file, start, shape, stored, which, times * channels, options)
    if scaling is not None:
        data = _scale(data, *scaling, result)
    volume = Volume(
        data, grid.spacing, grid.origin, grid.direction, frame=frame, unit=unit_of(header)
    )
    volume.files = tuple(str(file) for file in (header_file, data_file) if file != path)
    volume.labels = int(header["intent_code"]) == _LABELS
    return volume


def _scaling(header: Any, options: ReadOptions) -> tuple[float, float] | None:
    """Slope and offset; None if the header has none, or if they change nothing."""
    if np.isnan(float(header["scl_inter"])) and np.isfinite(float(header["scl_slope"])):
        header = header.copy()
        header["scl_inter"] = 0.0
        if float(header["scl_slope"]) != 0.0:
            options.warn("scl_inter is not a number, and counts as 0")
    slope, inter = header.get_slope_inter()
    return None if slope is None or (slope, inter) == (1.0, 0.0) else (slope, inter)


def _data_offset(path: Path, header: Any, single: bool) -> int:
    """The offset of the voxels in their file."""
    start = header.get_data_offset()
    if not single:
        least = 0
    else:
        least = header.single_vox_offset
        start = start or least
    if start < least:
        raise VolumeError(str(path), f"vox_offset {start}", f"{least} or more")
    return start


def _voxels(
    path: Path,
    start: int,
    shape: tuple[int, int, int],
    dtype: np.dtype,
    which: int,
    count: int,
    options: ReadOptions,
) -> np.ndarray:
    """Volume ``which`` of ``count`` consecutive ones."""
    nbytes = math.prod(shape) * dtype.itemsize
    if is_packed(path):
        if count > 1 and current_forward() is not None:
            one: tuple[int | slice, ...] = (which, slice(None), slice(None), slice(None))
            parts, cap = [Part(path, skip=start)], options.memory_cap
            return read_chosen(parts, (count, *shape), dtype, one, encoding="deflate", memory_cap=cap)
        if count > 1:
            return _from_stream(path, start, shape, dtype, which, count, options)
        part, encoding = Part(path, skip=start), "deflate"
    else:
        there = path.stat().st_size - start
        if there != nbytes * count:
            raise VolumeError(
                str(path),
                f"{max(there, 0)} bytes of voxel data",
                f"{nbytes * count} bytes as the header promises",
            )
        part, encoding = Part(path, start + which * nbytes, size=nbytes), "raw"
    return read_parts([part], shape, dtype, encoding=encoding, memory_cap=options.memory_cap)


def _from_stream(
    path: Path,
    start: int,
    shape: tuple[int, int, int],
    dtype: np.dtype,
    which: int,
    count: int,
    options: ReadOptions,
) -> np.ndarray:
    """Volume ``which`` of a gzip stream. The data before it are decoded and discarded."""
    nbytes = math.prod(shape) * dtype.itemsize
    stored = path.stat().st_size
    if start + nbytes * count > _DEFLATE_RATIO * stored:
        what = f"{stored} bytes of compressed data"
        raise VolumeError(str(path), what, f"{nbytes * count} bytes as the header promises")
    check_memory(str(path), nbytes, options.memory_cap)
    data = np.empty(shape, dtype)
    view = data.reshape(-1).view(np.uint8).data
    got = 0
    try:
        with gzip.open(path) as file:
            file.seek(start + which * nbytes)
            while got < nbytes and (step := file.readinto(view[got : got + (1 << 24)])):
                got += step
    except (EOFError, zlib.error, gzip.BadGzipFile):
        pass
    if got != nbytes:
        raise VolumeError(
            str(path), f"compressed data that end or are damaged in volume {which}", "whole data"
        )
    if not data.dtype.isnative:
        data = data.byteswap(inplace=True)
    return data.view(dtype.newbyteorder("="))


def _scaled_type(stored: np.dtype) -> np.dtype:
    wide = stored.itemsize == 8 or (stored.kind in "iu" and stored.itemsize == 4)
    return np.dtype(np.float64 if wide else np.float32)


def _scale(stored: np.ndarray, slope: float, inter: float, result: np.dtype) -> np.ndarray:
    """slope * stored + inter, slice by slice, so that float64 temporaries stay small."""
    scaled = np.empty(stored.shape, dtype=result)
    with np.errstate(all="ignore"):
        for k, plane in enumerate(stored):
            scaled[k] = plane.astype(np.float64) * slope + inter
    return scaled
