"""Headers of NIfTI files: their position, the size of the data, and the grid in world space."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.options import ReadOptions
from clvol.volume.grid import Grid

_XFORM_NAMES = {1: "scanner", 2: "aligned", 3: "Talairach", 4: "MNI"}
_UNITS = {1: "m", 2: "mm", 3: "µm"}
_PAIR = (".hdr", ".img")


def files_of(path: Path) -> tuple[Path, Path]:
    """The files of header and voxels: the same file, or a pair .hdr and .img."""
    name = path.name
    packed = name[-3:] if name.lower().endswith(".gz") else ""
    stem, ending = name[: len(name) - len(packed)][:-4], name[: len(name) - len(packed)][-4:]
    if ending.lower() not in _PAIR:
        return path, path
    other = _PAIR[1 - _PAIR.index(ending.lower())]
    for end in (other, other.upper()):
        for pack in (packed, "", ".gz", ".GZ"):
            partner = path.with_name(stem + end + pack)
            if partner.is_file():
                return (path, partner) if ending.lower() == ".hdr" else (partner, path)
    raise VolumeError(
        str(path), f"no {stem}{other} beside it", "a NIfTI pair of .hdr (header) and .img (voxels)"
    )


def read_header(path: Path) -> tuple[Any, bool]:
    """nibabel's header, unchecked, and whether the voxels follow it in the same file."""
    from nibabel.nifti1 import Nifti1Header
    from nibabel.nifti2 import Nifti2Header

    with gzip.open(path) if is_packed(path) else path.open("rb") as file:
        block, single = _block(path, file)
    header_type = {348: Nifti1Header, 540: Nifti2Header}[len(block)]
    return header_type(block, check=False), single


def is_packed(path: Path) -> bool:
    return path.name.lower().endswith(".gz")


def _block(path: Path, file: BinaryIO | gzip.GzipFile) -> tuple[bytes, bool]:
    """The 348 bytes of a NIfTI-1 header or the 540 of a NIfTI-2 header, in either byte order."""
    block = file.read(540)
    pair = any(path.name.lower().removesuffix(".gz").endswith(ending) for ending in _PAIR)
    for order in ("<", ">"):
        size = struct.unpack(order + "i", block[:4].ljust(4, b"\0"))[0]
        if size == 348 and block[344:348] in (b"n+1\0", b"ni1\0"):
            block, mark = block[:348], block[344:346]
        elif size == 540 and len(block) == 540 and block[4:8] in (b"n+2\0", b"ni2\0"):
            mark = block[4:6]
        else:
            continue
        if mark == b"ni" and not pair:
            break
        return block, not pair
    if pair:
        expected = "a NIfTI header (one of Analyze 7.5 does not say which way the axes point)"
        raise VolumeError(str(path), "no NIfTI header", expected)
    raise VolumeError(str(path), "no NIfTI header", "a single-file NIfTI-1 or NIfTI-2 header")


def sizes_of(path: Path, header: Any) -> tuple[tuple[int, int, int], int, int]:
    """Shape (nz, ny, nx), number of times, number of channels."""
    sizes = [int(n) for n in header.get_data_shape()]
    if not sizes or min(sizes) < 1 or any(n != 1 for n in sizes[5:]):
        raise VolumeError(
            str(path),
            f"{len(sizes)}-D data, sizes {' '.join(map(str, sizes))}",
            "three axes in space, time and channel",
        )
    sizes += [1] * (5 - len(sizes))
    nx, ny, nz, times, channels = sizes[:5]
    return (nz, ny, nx), times, channels


def grid_of(
    path: Path, header: Any, shape: tuple[int, int, int], options: ReadOptions
) -> tuple[Grid, str]:
    """The grid, and the name of its frame: by sform, else by qform, else by voxel sizes alone.

    An invalid form is skipped with a warning if there is another one.
    """
    sform, qform = int(header["sform_code"]), int(header["qform_code"])
    ways = []
    if sform > 0:
        ways.append((sform, "sform", lambda: header.get_sform()))
    if qform > 0:
        ways.append((qform, "qform", lambda: _qform(path, header)))
    failed: VolumeError | None = None
    for code, name, affine in ways:
        try:
            matrix = np.asarray(affine(), np.float64)
            grid = Grid.from_steps(shape, matrix[:3, :3], matrix[:3, 3])
        except VolumeError as error:
            # A form of zeros was never filled in.
            blank = name == "sform" and not header.get_sform()[:3, :3].any()
            failed = failed or (None if blank else error)
            options.warn(f"the {name} is invalid ({error.where}: {error.what}) and is not used")
            continue
        label = _XFORM_NAMES.get(code)
        return grid, f"RAS ({label})" if label else "RAS"
    if failed is not None:
        raise failed
    # Method 1 of the standard: x = pixdim[1] * i, and no orientation.
    lengths = np.abs(np.asarray(header["pixdim"][1:4], np.float64))
    lengths[(lengths == 0) & (np.array(shape[::-1]) == 1)] = 1.0
    return Grid.from_steps(shape, np.diag(lengths)), "index"


def _qform(path: Path, header: Any) -> np.ndarray:
    """nibabel's qform, except that a qfac of 0 counts as 1, as in the standard."""
    from nibabel.spatialimages import HeaderDataError

    if float(header["pixdim"][0]) not in (-1.0, 1.0):
        header = header.copy()
        header["pixdim"][0] = 1.0
    try:
        return header.get_qform()
    except (HeaderDataError, ValueError) as error:
        raise VolumeError("qform", str(error), "a unit quaternion") from None


def unit_of(header: Any) -> str | None:
    return _UNITS.get(int(header["xyzt_units"]) & 7)
