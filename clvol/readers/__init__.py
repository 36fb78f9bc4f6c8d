"""Readers: one module a format, chosen by the path's ending; for a folder, by what is in it.

A new format is a module with ``read(path, options) -> Volume`` and a line in ``ENDINGS``. Readers
may let their library's exceptions pass: ``load_volume`` turns every one into a VolumeError that
names the file. Where there are several channels, times or series they ask ``options.choose``, and
``options.warn`` takes what the user should know though it stops nothing. Libraries are imported
where they are used, so that nothing is slow that is not needed.
"""

from __future__ import annotations

import os
import stat
import warnings
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import numpy as np

from clvol.errors import ClvolError, ClvolWarning, VolumeError
from clvol.readers.dicom.files import has_dicom, is_dicom
from clvol.readers.options import ReadOptions
from clvol.readers.quiet import quiet
from clvol.readers.tiff_slices import slice_files
from clvol.readers.zarr import is_zarr
from clvol.store.zarr_store import check_finished
from clvol.volume.axis import ValueAxis
from clvol.volume.grid import Grid
from clvol.volume.lazy import narrowed_volume
from clvol.volume.narrow import Narrowing, narrowing
from clvol.volume.volume import Volume

# Ending (lower case) to format name and module of this package. The longest ending wins.
ENDINGS: dict[str, tuple[str, str]] = {
    ".nrrd": ("NRRD", "nrrd"),
    ".nhdr": ("NRRD", "nrrd"),
    ".mha": ("MetaImage", "metaimage"),
    ".mhd": ("MetaImage", "metaimage"),
    ".nii": ("NIfTI", "nifti"),
    ".nii.gz": ("NIfTI", "nifti"),
    ".hdr": ("NIfTI", "nifti"),
    ".hdr.gz": ("NIfTI", "nifti"),
    ".img": ("NIfTI", "nifti"),
    ".img.gz": ("NIfTI", "nifti"),
    ".tif": ("TIFF", "tiff"),
    ".tiff": ("TIFF", "tiff"),
    ".npy": ("npy", "npy"),
    ".raw": ("raw", "raw"),
}
FOLDER = ("DICOM", "dicom")
SLICES = ("TIFF slices", "tiff_slices")
# Folders may be Zarr whatever their names; this one says so.
ZARR_ENDING = ".zarr"
ZARR = ("OME-Zarr", "zarr")


def is_volume_path(path: str | os.PathLike) -> bool:
    """Whether the path ends like a volume file, or is a folder or a DICOM file of whatever name. The
    file need not exist."""
    path = Path(path)
    name = path.name.lower()
    if _ending(path) is not None or name.endswith(ZARR_ENDING) or os.path.isdir(path):
        return True
    return os.path.isfile(path) and is_dicom(path)


def load_volume(
    path: str | os.PathLike,
    *,
    dims: Sequence[int] | None = None,
    dtype: str | np.dtype | None = None,
    spacing: Sequence[float] | None = None,
    header_bytes: int | None = None,
    byte_order: str | None = None,
    slope: float = 1.0,
    offset: float = 0.0,
    labels: bool = False,
    memory_cap: int | None = None,
    channel: int | str | None = None,
    time: int | str | None = None,
    series: int | str | None = None,
) -> Volume:
    """Reads a volume file, or a folder: DICOM or TIFF slices, or in Zarr form.

    What is in Zarr form, clvol's own stores too, is a volume whose voxels are read when ``data`` is
    first asked for.

    ``dims`` (nx, ny, nz) and ``dtype`` describe a .raw file, ``header_bytes`` what comes before its
    voxels (-1: whatever it is, the voxels end the file) and ``byte_order`` ("little", "big") them;
    all four are refused for other formats.
    ``spacing`` (sx, sy, sz) in world units overrides the file's; origin and direction stay.
    ``slope`` and ``offset``, as for ``Volume``, are of the values that the file states: where a file
    has a slope and an offset of its own, those are applied first. ``labels`` as for ``Volume``.
    ``memory_cap`` is the most bytes that the voxels may take, checked against the header before
    anything is read; without it, 75 % of the available memory, and .npy and .raw files, which are
    mapped and take no memory of their own, may have any size.

    ``channel``, ``time`` and ``series`` choose where a file has several: an index from 0 or a name;
    for DICOM series also the SeriesInstanceUID. Without them a file with several is refused, and
    the error lists what there is.

    Voxels keep the file's type; big-endian data become native, and integers of 32 and 64 bits are
    narrowed without loss (``Volume``). Nothing else is converted, nothing is cropped or
    downsampled. World coordinates are in the file's own frame, named by ``Volume.frame``.

    Raises VolumeError, naming the path, for whatever cannot be read exactly; warns
    (ClvolWarning) of what it had to leave out or to assume.
    """
    try:
        where = os.fspath(path)
        file = Path(where)
    except TypeError:
        raise VolumeError("volume", f"path of type {type(path).__name__}", "a path") from None
    axis = ValueAxis(slope, offset)
    options = ReadOptions(
        dims, dtype, spacing, memory_cap, channel, time, series, header_bytes, byte_order
    )
    format_name, module = _choose(file)
    for_raw = {
        "dims": dims, "dtype": dtype, "header_bytes": header_bytes, "byte_order": byte_order
    }  # fmt: skip
    given = [name for name, value in for_raw.items() if value is not None]
    if module != "raw" and given:
        raise VolumeError(where, f"{given[0]} given", f"{given[0]} only with a .raw file")
    try:
        how = Narrowing(memory_cap, labels)
        with quiet(), narrowing(how):
            reader = import_module(f"{__name__}.{module}")
            volume = narrowed_volume(reader.read(file, options), how)
            options.check_consulted(where)
            if spacing is not None:
                grid = volume.grid
                volume.grid = Grid(grid.shape, tuple(spacing), grid.origin, grid.direction)
    except VolumeError as error:
        own = error.where in (where, str(file), "volume")
        what = error.what if own else f"{error.where}: {error.what}"
        raise VolumeError(where, what, error.expected) from error.__cause__
    except ClvolError:
        raise
    except MemoryError as error:
        raise VolumeError(where, "the volume does not fit into memory") from error
    except OSError as error:
        reason = error.strerror or _first_line(error)
        raise VolumeError(where, reason, f"a readable {format_name} file") from error
    except Exception as error:  # what a library makes of a damaged file can be any exception
        raise VolumeError(
            where, f"unreadable: {_first_line(error)}", f"an undamaged {format_name} file"
        ) from error
    volume.axis = axis.after(volume.axis)
    volume.path = where
    volume.format = format_name
    if volume.name is None:
        volume.name = _stem(file)
    for text in options.notes:
        warnings.warn(ClvolWarning(where, text), stacklevel=2)
    return volume


def _ending(path: Path) -> str | None:
    name = path.name.lower()
    found = [ending for ending in ENDINGS if name.endswith(ending)]
    return max(found, key=len, default=None)


def _stem(path: Path) -> str:
    ending = _ending(path)
    return path.name[: -len(ending)] if ending and path.is_file() else path.resolve().name


def _choose(path: Path) -> tuple[str, str]:
    """Format and module for a path that exists and is a plain file or a folder."""
    known = ", ".join([*ENDINGS, ZARR_ENDING])
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        check_finished(path)
        raise VolumeError(str(path), "no such file", "a volume file or a DICOM folder") from None
    except (OSError, ValueError) as error:
        raise VolumeError(str(path), _first_line(error), "a volume file") from None
    ending = _ending(path)
    if stat.S_ISREG(mode) and ending in (None, ".img") and is_dicom(path):
        return FOLDER
    if stat.S_ISDIR(mode):
        if ending is not None:
            raise VolumeError(str(path), "a folder", f"a {ENDINGS[ending][0]} file")
        _check_entries(path)
        if is_zarr(path):
            return ZARR
        if path.name.lower().endswith(ZARR_ENDING):
            raise VolumeError(str(path), "no Zarr metadata in it", "zarr.json, .zgroup or .zarray")
        return _folder(path)
    if not stat.S_ISREG(mode):
        raise VolumeError(str(path), "not a regular file", "a volume file or a DICOM folder")
    if ending is None:
        if path.name.lower().endswith(ZARR_ENDING):
            raise VolumeError(str(path), "a file", "a Zarr folder")
        what = f"unknown ending {path.suffix!r}" if path.suffix else "no ending"
        raise VolumeError(str(path), what, f"one of {known}, or a DICOM folder")
    if path.stat().st_size == 0:
        raise VolumeError(str(path), "empty file", f"a {ENDINGS[ending][0]} file")
    return ENDINGS[ending]


def _folder(path: Path) -> tuple[str, str]:
    """A folder with TIFF files is a stack of slices, unless there are DICOM files in it."""
    try:
        return SLICES if slice_files(path) and not has_dicom(path) else FOLDER
    except OSError as error:
        reason = error.strerror or _first_line(error)
        raise VolumeError(str(path), reason, "a folder that can be read") from None


def _check_entries(folder: Path) -> None:
    """VolumeError for a pipe, a socket or a device in the folder: whoever opens one may wait."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if not (entry.is_dir() or entry.is_file()) and os.path.exists(entry.path):
                what = f"{entry.name} is a pipe, a socket or a device"
                raise VolumeError(str(folder), what, "files alone")


def _first_line(error: BaseException) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    # ITK puts the throwing function and source line first, and the reason last.
    text = lines[-1] if lines and lines[0].startswith("Exception thrown") else "".join(lines[:1])
    return text[:200] or type(error).__name__
