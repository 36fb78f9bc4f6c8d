"""DICOM: a folder with the slices of one series, read by SimpleITK's GDCM."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.grid import Grid
from clvol.volume.memory import check_memory
from clvol.volume.readers.itk import itk_type, read_information
from clvol.volume.readers.options import ReadOptions
from clvol.volume.readers.quiet import quiet_native
from clvol.volume.volume import Volume

_GDCM = "GDCMImageIO"
# After rescaling, 16-bit data may need 32 bits for a moment.
_RESCALED = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")
# Slice positions are written with few digits; gaps may differ by this share of a gap.
_GAP_TOLERANCE = 0.01
_SERIES_SHOWN = 8


@dataclass(frozen=True)
class _Slice:
    name: str
    reader: Any
    position: np.ndarray
    direction: np.ndarray
    spacing: tuple[float, ...]
    dtype: np.dtype


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a folder with one series; world coordinates are DICOM's (LPS, mm).

    Slices are ordered by position along their normal; the z axis runs from the first slice's
    position to the last one's, so a tilted gantry gives a sheared grid. Rescale slope and intercept
    are applied a slice at a time; the type is then the smallest of the accepted ones that holds all
    values exactly. VolumeError for several series, colour, missing or doubled slices, and slices
    that differ in size or orientation.
    """
    slices = [_slice(path, name) for name in _series_files(path)]
    first = slices[0]
    for other in slices[1:]:
        if other.reader.GetSize()[:2] != first.reader.GetSize()[:2]:
            raise VolumeError(str(path), f"{_base(other)} has another size", "slices of one size")
        if not np.allclose(other.direction, first.direction, atol=1e-3) or not np.allclose(
            other.spacing[:2], first.spacing[:2], rtol=1e-3
        ):
            raise VolumeError(
                str(path), f"{_base(other)} lies or is spaced otherwise", "parallel slices"
            )
    slices.sort(key=lambda one: float(one.position @ first.direction[:, 2]))
    nx, ny = first.reader.GetSize()[:2]
    shape = (len(slices), ny, nx)
    wide = np.result_type(*{one.dtype for one in slices})
    check_memory(str(path), math.prod(shape) * wide.itemsize, options.memory_cap)
    step = _step(path, slices)
    steps = slices[0].direction * np.array([*slices[0].spacing[:2], 1.0])
    steps[:, 2] = step
    grid = Grid.from_steps(shape, steps, slices[0].position)
    data = np.empty(shape, dtype=wide)
    for k, one in enumerate(slices):
        data[k] = _pixels(path, one, (ny, nx))
    return Volume(
        _smallest_exact(path, data), grid.spacing, grid.origin, grid.direction, frame="LPS"
    )


def _series_files(path: Path) -> list[str]:
    import SimpleITK

    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    finder = SimpleITK.ImageSeriesReader
    with quiet_native():
        names = {
            uid: finder.GetGDCMSeriesFileNames(str(path), uid)
            for uid in finder.GetGDCMSeriesIDs(str(path))
        }
    if not names:
        raise VolumeError(str(path), "no DICOM series in the folder", "a folder with one series")
    if len(names) > 1:
        shown = [f"{uid} ({len(files)} files)" for uid, files in names.items()]
        more = f" and {len(shown) - _SERIES_SHOWN} more" if len(shown) > _SERIES_SHOWN else ""
        raise VolumeError(
            str(path),
            f"{len(names)} DICOM series: {'; '.join(shown[:_SERIES_SHOWN])}{more}",
            "one series in the folder",
        )
    files = list(next(iter(names.values())))
    _check_leftovers(path, files)
    return files


def _check_leftovers(path: Path, files: list[str]) -> None:
    """GDCM leaves out files that it cannot parse; a volume without them would be cropped."""
    known = {Path(name).name for name in files} | {"DICOMDIR"}
    for entry in sorted(path.iterdir()):
        if entry.name in known or not entry.is_file():
            continue
        with entry.open("rb") as file:
            if file.read(132)[128:] == b"DICM":
                raise VolumeError(
                    str(path), f"{entry.name} is damaged or no image", "undamaged slices only"
                )


def _slice(path: Path, name: str) -> _Slice:
    reader = read_information(name, _GDCM)
    where = f"{Path(name).name} in {path}"
    size = reader.GetSize()
    if reader.GetNumberOfComponents() != 1:
        raise VolumeError(where, "colour or vector pixels", "one scalar per pixel")
    if len(size) > 3 or (len(size) == 3 and size[2] != 1):
        raise VolumeError(where, f"a multi-frame file of {size[-1]} frames", "one file per slice")
    if len(size) != 3:
        raise VolumeError(where, "a slice without a position in space", "ImagePositionPatient")
    return _Slice(
        name,
        reader,
        np.array(reader.GetOrigin()),
        np.array(reader.GetDirection()).reshape(3, 3),
        reader.GetSpacing(),
        itk_type(reader, where, _RESCALED),
    )


def _base(one: _Slice) -> str:
    return Path(one.name).name


def _step(path: Path, slices: list[_Slice]) -> np.ndarray:
    """The world vector from one slice to the next; the header's thickness for a single slice."""
    if len(slices) == 1:
        return slices[0].direction[:, 2] * _thickness(slices[0])
    positions = np.array([one.position for one in slices])
    step = (positions[-1] - positions[0]) / (len(slices) - 1)
    normal = slices[0].direction[:, 2]
    gap = float(step @ normal)
    if gap <= 0.0:
        raise VolumeError(str(path), "all slices at one position", "slices side by side")
    off = positions - (positions[0] + np.arange(len(slices))[:, None] * step)
    worst = int(np.argmax(np.linalg.norm(off, axis=1)))
    if np.linalg.norm(off[worst]) > _GAP_TOLERANCE * gap:
        raise VolumeError(
            str(path),
            f"slices missing, doubled or unevenly spaced near {_base(slices[worst])}",
            f"positions {gap:g} apart, within {_GAP_TOLERANCE:.0%}",
        )
    return step


def _thickness(one: _Slice) -> float:
    """SliceThickness of the header, else what ITK assumes."""
    if one.reader.HasMetaDataKey("0018|0050"):
        text = one.reader.GetMetaData("0018|0050").strip()
        if text:
            return float(text)
    return one.spacing[2]


def _pixels(path: Path, one: _Slice, shape: tuple[int, int]) -> np.ndarray:
    import SimpleITK

    with quiet_native():
        image = one.reader.Execute()
    pixels = SimpleITK.GetArrayFromImage(image)
    if pixels.size != shape[0] * shape[1]:
        raise VolumeError(f"{_base(one)} in {path}", f"{pixels.size} pixels", f"{shape}")
    return pixels.reshape(shape)


def _smallest_exact(path: Path, data: np.ndarray) -> np.ndarray:
    """``data`` in the smallest accepted type that holds every value exactly, if it is too wide."""
    if data.dtype.name in ("uint8", "int8", "uint16", "int16", "float32"):
        return data
    lower, upper = data.min(), data.max()
    for name in ("uint8", "int8", "uint16", "int16"):
        limits = np.iinfo(name)
        inside = limits.min <= lower and upper <= limits.max
        if inside and all(np.array_equal(plane.astype(name), plane) for plane in data):
            return data.astype(name)
    if all(np.array_equal(plane.astype(np.float32), plane, equal_nan=True) for plane in data):
        return data.astype(np.float32)
    return data.astype(np.float64, copy=False)
