"""Readers: one module a format, chosen by the path's ending; for a folder, by what is in it.

A new format is a module with ``read(path, options) -> Volume`` and a line in ``ENDINGS``. Readers
may let their library's exceptions pass: ``load_volume`` turns every one into a VolumeError that
names the file. Libraries are imported where they are used, so that nothing is slow that is not
needed.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import numpy as np

from clvol.errors import ClvolError, VolumeError
from clvol.volume.grid import Grid
from clvol.volume.readers.options import ReadOptions
from clvol.volume.readers.quiet import quiet
from clvol.volume.volume import Volume

# Ending (lower case) to format name and module of this package. The longest ending wins.
ENDINGS: dict[str, tuple[str, str]] = {
    ".nrrd": ("NRRD", "nrrd"),
    ".nhdr": ("NRRD", "nrrd"),
    ".mha": ("MetaImage", "metaimage"),
    ".mhd": ("MetaImage", "metaimage"),
    ".nii": ("NIfTI", "nifti"),
    ".nii.gz": ("NIfTI", "nifti"),
    ".tif": ("TIFF", "tiff"),
    ".tiff": ("TIFF", "tiff"),
    ".npy": ("npy", "npy"),
    ".raw": ("raw", "raw"),
}
FOLDER = ("DICOM", "dicom")
# Folders may be Zarr whatever their names; this one says so.
ZARR_ENDING = ".zarr"
ZARR = ("OME-Zarr", "zarr")


def is_volume_path(path: str | os.PathLike) -> bool:
    """Whether the path ends like a volume file, or is a folder. The file need not exist."""
    path = Path(path)
    name = path.name.lower()
    return _ending(path) is not None or name.endswith(ZARR_ENDING) or os.path.isdir(path)


def load_volume(
    path: str | os.PathLike,
    *,
    dims: Sequence[int] | None = None,
    dtype: str | np.dtype | None = None,
    spacing: Sequence[float] | None = None,
    memory_cap: int | None = None,
) -> Volume:
    """Reads a volume file, or a folder with one DICOM series or in Zarr form.

    What is in Zarr form, clvol's own stores too, is a volume whose voxels are read when ``data`` is
    first asked for.

    ``dims`` (nx, ny, nz) and ``dtype`` describe a .raw file and are refused for other formats.
    ``spacing`` (sx, sy, sz) in world units overrides the file's; origin and direction stay.
    ``memory_cap`` is the most bytes that the voxels may take, checked against the header before
    anything is read; without it, 75 % of the available memory, and .npy and .raw files, which are
    mapped and take no memory of their own, may have any size.

    Voxels keep the file's type; big-endian data become native. Nothing is converted, cropped or
    downsampled. World coordinates are in the file's own frame, named by ``Volume.frame``.

    Raises VolumeError, naming the path, for whatever cannot be read exactly.
    """
    try:
        where = os.fspath(path)
        file = Path(where)
    except TypeError:
        raise VolumeError("volume", f"path of type {type(path).__name__}", "a path") from None
    options = ReadOptions(dims, dtype, spacing, memory_cap)
    format_name, module = _choose(file)
    if module != "raw" and (dims is not None or dtype is not None):
        raise VolumeError(where, "dims or dtype given", "dims and dtype only with a .raw file")
    try:
        with quiet():
            reader = import_module(f"{__name__}.{module}")
            volume = reader.read(file, options)
            if spacing is not None:
                grid = volume.grid
                volume.grid = Grid(grid.shape, tuple(spacing), grid.origin, grid.direction)
    except VolumeError as error:
        what = error.what if error.where in (where, str(file)) else f"{error.where}: {error.what}"
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
    volume.path = where
    volume.format = format_name
    if volume.name is None:
        volume.name = _stem(file)
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
        from clvol.store.zarr_store import check_finished

        check_finished(path)
        raise VolumeError(str(path), "no such file", "a volume file or a DICOM folder") from None
    except (OSError, ValueError) as error:
        raise VolumeError(str(path), _first_line(error), "a volume file") from None
    ending = _ending(path)
    if stat.S_ISDIR(mode):
        if ending is not None:
            raise VolumeError(str(path), "a folder", f"a {ENDINGS[ending][0]} file")
        _check_entries(path)
        from clvol.volume.readers.zarr import is_zarr

        if is_zarr(path):
            return ZARR
        if path.name.lower().endswith(ZARR_ENDING):
            raise VolumeError(str(path), "no Zarr metadata in it", "zarr.json, .zgroup or .zarray")
        return FOLDER
    if not stat.S_ISREG(mode):
        raise VolumeError(str(path), "not a regular file", "a volume file or a DICOM folder")
    if ending is None:
        if path.name.lower().endswith(ZARR_ENDING):
            raise VolumeError(str(path), "a file", "a Zarr folder")
        what = f"unknown ending {path.suffix!r}" if path.suffix else "no ending"
        if path.suffix.lower() in (".dcm", ".ima"):
            raise VolumeError(str(path), "one DICOM file", "the folder that holds the series")
        raise VolumeError(str(path), what, f"one of {known}, or a DICOM folder")
    if path.stat().st_size == 0:
        raise VolumeError(str(path), "empty file", f"a {ENDINGS[ending][0]} file")
    return ENDINGS[ending]


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
