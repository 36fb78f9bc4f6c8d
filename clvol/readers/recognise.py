"""Recognising the format of a path by its name, its first bytes or the contents of a folder, without reading more.

A new file format is a module of this package with ``read(path, options) -> Volume`` and a line in ``ENDINGS``.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from clvol.errors import VolumeError
from clvol.readers.remote import EXPECTED, is_url
from clvol.readers.slice_names import natural
from clvol.store.zarr_store import check_finished, is_unfinished

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
    ".h5": ("HDF5", "hdf5"),
    ".hdf5": ("HDF5", "hdf5"),
    ".he5": ("HDF5", "hdf5"),
    ".ims": ("Imaris", "imaris"),
    ".nc": ("netCDF", "netcdf"),
    ".nc4": ("netCDF", "netcdf"),
    ".cdf": ("netCDF", "netcdf"),
    ".mrc": ("MRC", "mrc"),
    ".mrc.gz": ("MRC", "mrc"),
    ".map": ("MRC", "mrc"),
    ".map.gz": ("MRC", "mrc"),
    ".rec": ("MRC", "mrc"),
    ".ccp4": ("MRC", "mrc"),
    ".vti": ("VTI", "vti"),
    ".czi": ("CZI", "microscopy"),
    ".nd2": ("ND2", "microscopy"),
    ".raw": ("raw", "raw"),
}
# Formats without a library on PyPI, and what to do.
REFUSED = {".vdb": "OpenVDB has no wheel on PyPI: grid.copyToArray(array) of its Python module, then numpy.save"}
FOLDER = ("DICOM", "dicom")
SLICES = ("TIFF slices", "tiff_slices")
# Folders of any name may be Zarr; this ending is explicit.
ZARR_ENDING = ".zarr"
ZARR = ("OME-Zarr", "zarr")
_ZARR_MARKS = ("zarr.json", ".zgroup", ".zarray")
_TIFF_ENDINGS = (".tif", ".tiff")
_DICOM_ENDINGS = (".dcm", ".ima", ".dicom")
MAGIC_AT, MAGIC = 128, b"DICM"  # DICOM's mark, after a preamble
_DEEPEST = 6  # levels of folders below the given one


def is_volume_path(path: str | os.PathLike) -> bool:
    """Whether the path has the ending of a volume file, is a URL, or is a folder or a DICOM file of any name. The file
    need not exist.
    """
    if is_url(path):
        return True
    path = Path(path)
    name = path.name.lower()
    if ending_of(path) is not None or name.endswith(ZARR_ENDING) or os.path.isdir(path):
        return True
    return os.path.isfile(path) and is_dicom(path)


def format_of_url(url: str) -> tuple[str, str]:
    """As ``format_of``; VolumeError for a URL of a file, since files are not read from afar."""
    ending = ending_of(Path(url.rstrip("/")))
    if ending is not None:
        raise VolumeError(url, f"the URL of a {ENDINGS[ending][0]} file", f"{EXPECTED}; download other files")
    return ZARR


def format_of(path: Path) -> tuple[str, str]:
    """Name and module of the format of a path; VolumeError unless it is a regular file or a folder of a known format.
    """
    known = ", ".join([*ENDINGS, ZARR_ENDING])
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        check_finished(path)
        raise VolumeError(str(path), "no such file", "a volume file or a DICOM folder") from None
    except (OSError, ValueError) as error:
        raise VolumeError(str(path), first_line(error), "a volume file") from None
    ending = ending_of(path)
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
        if (hint := REFUSED.get(path.suffix.lower())) is not None:
            raise VolumeError(str(path), f"{path.suffix} cannot be read", f"{known} ({hint})")
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
        reason = error.strerror or first_line(error)
        raise VolumeError(str(path), reason, "a folder that can be read") from None


def _check_entries(folder: Path) -> None:
    """VolumeError if the folder holds a pipe, a socket or a device: opening one may block."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if not (entry.is_dir() or entry.is_file()) and os.path.exists(entry.path):
                what = f"{entry.name} is a pipe, a socket or a device"
                raise VolumeError(str(folder), what, "files alone")


def ending_of(path: Path) -> str | None:
    """The longest ending in ENDINGS that the name has, or None."""
    name = path.name.lower()
    found = [ending for ending in ENDINGS if name.endswith(ending)]
    return max(found, key=len, default=None)


def is_zarr(path: Path) -> bool:
    """Whether the folder is a Zarr array or group, or a store whose building was interrupted."""
    return any((path / name).exists() for name in _ZARR_MARKS) or is_unfinished(path)


def slice_files(path: Path) -> list[Path]:
    """The TIFF files of a folder in natural order (sl_2 before sl_10), without hidden files."""
    with os.scandir(path) as entries:
        names = [entry.name for entry in entries if entry.is_file()]
    found = [n for n in names if n.lower().endswith(_TIFF_ENDINGS) and not n.startswith(".")]
    return [path / name for name in sorted(found, key=natural)]


def is_dicom(path: Path) -> bool:
    """Whether a file is DICOM, by its preamble or by its ending."""
    if path.name.lower().endswith(_DICOM_ENDINGS):
        return True
    return begins(path)[MAGIC_AT:] == MAGIC


def has_dicom(path: Path) -> bool:
    """Whether a file in the folder begins as DICOM files do; if it holds none, folders below are searched."""
    return any(begins(file)[MAGIC_AT:] == MAGIC for file in files_below(path))


def files_below(path: Path) -> Iterator[Path]:
    """Regular files of the folder, sorted by name, followed by those of the folders below."""
    for folder, folders, names in os.walk(path):
        folders.sort()
        if len(Path(folder).relative_to(path).parts) >= _DEEPEST:
            folders.clear()
        for name in sorted(names):
            if os.path.isfile(os.path.join(folder, name)):
                yield Path(folder, name)


def begins(path: Path) -> bytes:
    """The bytes that hold DICOM's preamble and mark; empty if the file cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(MAGIC_AT + len(MAGIC))
    except OSError:
        return b""


def first_line(error: BaseException) -> str:
    """The line of a library's message that states the error, at most 200 characters."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    # ITK puts the throwing function and source line first, and the reason last.
    text = lines[-1] if lines and lines[0].startswith("Exception thrown") else "".join(lines[:1])
    return text[:200] or type(error).__name__
