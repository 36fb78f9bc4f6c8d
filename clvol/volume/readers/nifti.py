"""NIfTI-1 and NIfTI-2: .nii and .nii.gz.

nibabel parses the header and the affine; the voxels are read by ``read_samples``.
"""

from __future__ import annotations

import gzip
import math
import struct
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.grid import Grid
from clvol.volume.memory import check_memory
from clvol.volume.readers.options import ReadOptions
from clvol.volume.readers.samples import read_samples
from clvol.volume.volume import Volume, check_type

_XFORM_NAMES = {1: "scanner", 2: "aligned", 3: "Talairach", 4: "MNI"}


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a NIfTI file; world coordinates are NIfTI's (RAS), by sform, else qform.

    Where ``scl_slope`` and ``scl_inter`` are a real scaling (not slope 0, nor slope 1 with inter 0)
    the values are slope * stored + inter: computed in float64 and kept as float32 for stored 8- and
    16-bit integers and float32, as float64 for stored 32-bit integers and float64. Without a
    scaling the stored type is kept. Trailing axes of length 1 are dropped.
    """
    from nibabel.nifti1 import Nifti1Header
    from nibabel.nifti2 import Nifti2Header

    compressed = path.name.lower().endswith(".gz")
    with gzip.open(path) if compressed else path.open("rb") as file:
        block = _header_block(path, file)
    header_type = {348: Nifti1Header, 540: Nifti2Header}[len(block)]
    header = header_type(block, check=False)
    shape = _shape(path, header)
    stored = header.get_data_dtype()
    slope, inter = header.get_slope_inter()
    scaled = slope is not None and (slope, inter) != (1.0, 0.0)
    if not (scaled and stored.kind in "iu" and stored.itemsize == 4):
        check_type(stored, str(path))
    affine = header.get_best_affine()
    grid = Grid.from_steps(shape, affine[:3, :3], affine[:3, 3])
    result = _scaled_type(stored) if scaled else None
    voxel = stored.itemsize + (result.itemsize if scaled else 0)
    check_memory(str(path), voxel * math.prod(shape), options.memory_cap)
    start = header.get_data_offset() or header_type.single_vox_offset
    if start < header_type.single_vox_offset:
        least = header_type.single_vox_offset
        raise VolumeError(str(path), f"vox_offset {start}", f"{least} or more")
    data = read_samples(
        path,
        shape,
        stored,
        offset=0 if compressed else start,
        encoding="deflate" if compressed else "raw",
        skip=start if compressed else 0,
        memory_cap=options.memory_cap,
    )
    if result is not None:
        data = _scale(data, slope, inter, result)
    label = _XFORM_NAMES.get(int(header["sform_code"]) or int(header["qform_code"]))
    frame = f"RAS ({label})" if label else "RAS"
    return Volume(data, grid.spacing, grid.origin, grid.direction, frame=frame)


def _header_block(path: Path, file: BinaryIO) -> bytes:
    """The 348 bytes of a NIfTI-1 header or the 540 of a NIfTI-2 header, in either byte order."""
    block = file.read(540)
    for order in ("<", ">"):
        size = struct.unpack(order + "i", block[:4].ljust(4, b"\0"))[0]
        if size == 348 and block[344:348] == b"n+1\0":
            return block[:348]
        if size == 540 and len(block) == 540 and block[4:8] == b"n+2\0":
            return block
    raise VolumeError(str(path), "no NIfTI header", "a single-file NIfTI-1 or NIfTI-2 header")


def _shape(path: Path, header: Any) -> tuple[int, int, int]:
    sizes = [int(n) for n in header.get_data_shape()]
    spatial = sizes[:3] + [1] * (3 - len(sizes))
    if not sizes or min(sizes) < 1 or any(n != 1 for n in sizes[3:]):
        raise VolumeError(
            str(path),
            f"{len(sizes)}-D data, sizes {' '.join(map(str, sizes))}",
            "three axes in space and one scalar per voxel",
        )
    return tuple(spatial[::-1])


def _scaled_type(stored: np.dtype) -> np.dtype:
    wide = stored.itemsize == 8 or (stored.kind in "iu" and stored.itemsize == 4)
    return np.dtype(np.float64 if wide else np.float32)


def _scale(stored: np.ndarray, slope: float, inter: float, result: np.dtype) -> np.ndarray:
    """slope * stored + inter slice by slice, so that the float64 in between stay small."""
    scaled = np.empty(stored.shape, dtype=result)
    with np.errstate(all="ignore"):
        for k, plane in enumerate(stored):
            scaled[k] = plane.astype(np.float64) * slope + inter
    return scaled
