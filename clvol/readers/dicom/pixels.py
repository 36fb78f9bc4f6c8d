"""The values of slices: stored pixels, read by pydicom, times the rescale slope plus the intercept."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.dicom.codecs import SYNTAXES, decoded_frames
from clvol.readers.dicom.files import DEFLATED
from clvol.readers.dicom.frames import Frame
from clvol.readers.options import ReadOptions
from clvol.volume.memory import check_memory

_SMALL = ("uint8", "int8", "uint16", "int16")


def read_frames(path: Path, frames: list[Frame], options: ReadOptions) -> np.ndarray:
    """Values [z, y, x] in the smallest accepted type that holds each exactly."""
    if any(frame.image.header.get("ModalityLUTSequence") for frame in frames):
        options.warn("a table for the values (Modality LUT) is not applied; values are as stored")
    planes = _stored(path, frames)
    first = next(planes)
    stored = np.empty((len(frames), *first.shape), first.dtype)
    stored[0] = first
    for k, pixels in enumerate(planes, 1):
        if pixels.dtype != stored.dtype:
            stored = _widened(path, stored, pixels.dtype, options)
        stored[k] = pixels
    slopes = np.array([frame.slope for frame in frames])
    intercepts = np.array([frame.intercept for frame in frames])
    if (slopes == 1.0).all() and (intercepts == 0.0).all():
        return stored if stored.dtype.name in (*_SMALL, "float32") else _smallest(stored)
    return _rescaled(path, stored, slopes, intercepts, _limits(frames, stored.dtype), options)


def _widened(
    path: Path, stored: np.ndarray, other: np.dtype, options: ReadOptions
) -> np.ndarray:
    wide = np.result_type(stored.dtype, other)
    check_memory(str(path), stored.size * (wide.itemsize + stored.itemsize), options.memory_cap)
    return stored.astype(wide)


def _stored(path: Path, frames: list[Frame]) -> Iterator[np.ndarray]:
    """Stored pixels [y, x] of each frame. Frames of one file are read together."""
    for _, group in groupby(frames, key=lambda frame: frame.image.path):
        members = list(group)
        image = members[0].image
        wanted = (members[0].rows, members[0].columns)
        try:
            for pixels in _decoded(members):
                if pixels.shape != wanted:
                    raise ValueError(f"{pixels.shape} pixels for {wanted}")
                yield _used_bits(pixels, image.header)
        except MemoryError:
            raise
        except Exception as error:  # raised by pydicom or by a decoder
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise VolumeError(
                str(path), f"the pixels of {image.name} cannot be read ({reason})", "whole slices"
            ) from error


def _decoded(frames: list[Frame]) -> Iterator[np.ndarray]:
    from pydicom import dcmread
    from pydicom.pixels import iter_pixels, pixel_array

    image = frames[0].image
    syntax = image.header.file_meta.get("TransferSyntaxUID")
    indices = [frame.index for frame in frames]
    if syntax in SYNTAXES:
        yield from decoded_frames(image.path, image.header, indices)
        return
    # pydicom reads only the pixels where it can; it has to inflate a deflated file as a whole
    source = dcmread(image.path) if syntax == DEFLATED else image.path
    if int(image.header.get("NumberOfFrames") or 1) == 1:
        yield pixel_array(source, raw=True).reshape(frames[0].rows, frames[0].columns)
    else:
        yield from iter_pixels(source, raw=True, indices=indices)


def _used_bits(pixels: np.ndarray, header: Any) -> np.ndarray:
    """Pixels with only the stored bits (without overlays, for example), sign-extended."""
    if pixels.dtype.kind not in "iu":
        return pixels
    allocated = pixels.dtype.itemsize * 8
    stored = int(header.get("BitsStored") or allocated)
    high = header.get("HighBit")
    high = stored - 1 if high is None else int(high)
    if not 0 < stored <= high + 1 <= allocated or stored == allocated:
        return pixels
    return (pixels << (allocated - high - 1)) >> (allocated - stored)


# ---- values --------------------------------------------------------------------------------------


def _limits(frames: list[Frame], dtype: np.dtype) -> tuple[float, float] | None:
    """The range of numbers that the frames can store."""
    if dtype.kind == "f":
        return None
    bits = max(
        int(frame.image.header.get("BitsStored") or dtype.itemsize * 8) for frame in frames
    )
    half = 2.0 ** (bits - 1)
    return (-half, half - 1) if dtype.kind == "i" else (0.0, 2 * half - 1)


def _rescaled(
    path: Path,
    stored: np.ndarray,
    slopes: np.ndarray,
    intercepts: np.ndarray,
    limits: tuple[float, float] | None,
    options: ReadOptions,
) -> np.ndarray:
    """slope * stored + intercept, slice by slice, in float64 before the type is known."""
    dtype = None
    if limits is not None and (slopes % 1 == 0).all() and (intercepts % 1 == 0).all():
        ends = np.outer(limits, slopes) + intercepts
        dtype = _holding(float(ends.min()), float(ends.max()))
        if dtype is None:
            low = min(_values(p, s, i).min() for p, s, i in zip(stored, slopes, intercepts))
            high = max(_values(p, s, i).max() for p, s, i in zip(stored, slopes, intercepts))
            dtype = _holding(low, high)
    if dtype is None:
        dtype = np.dtype(np.float32)
        for plane, slope, intercept in zip(stored, slopes, intercepts):
            values = _values(plane, slope, intercept)
            if not np.array_equal(values.astype(np.float32), values, equal_nan=True):
                dtype = np.dtype(np.float64)
                break
    if dtype.itemsize != stored.itemsize:
        check_memory(str(path), stored.nbytes + stored.size * dtype.itemsize, options.memory_cap)
        out = np.empty(stored.shape, dtype)
    else:
        out = stored.view(dtype)
    for k, plane in enumerate(stored):
        out[k] = _values(plane, slopes[k], intercepts[k])
    return out


def _values(stored: np.ndarray, slope: float, intercept: float) -> np.ndarray:
    with np.errstate(all="ignore"):
        return stored.astype(np.float64) * slope + intercept


def _holding(low: float, high: float) -> np.dtype | None:
    for name in _SMALL:
        limits = np.iinfo(name)
        if limits.min <= low and high <= limits.max:
            return np.dtype(name)
    return None


def _smallest(stored: np.ndarray) -> np.ndarray:
    """Wide integers in 16 bits or fewer without loss, else in floating point."""
    if stored.dtype.kind == "f":
        exact = all(np.array_equal(p.astype(np.float32), p, equal_nan=True) for p in stored)
        return stored.astype(np.float32) if exact else stored.astype(np.float64, copy=False)
    dtype = _holding(float(stored.min()), float(stored.max()))
    if dtype is None:
        exact = all(np.array_equal(p.astype(np.float32).astype(np.float64), p) for p in stored)
        dtype = np.dtype(np.float32 if exact else np.float64)
    return stored.astype(dtype)
