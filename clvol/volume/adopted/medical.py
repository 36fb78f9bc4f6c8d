"""Images of SimpleITK, ITK and nibabel, with their grids in millimetres."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from clvol.volume.adopted.facts import Adopted, name_of, refused
from clvol.volume.grid import Grid

_XFORM_NAMES = {1: "scanner", 2: "aligned", 3: "Talairach", 4: "MNI"}


def adopt_simpleitk(value: Any) -> Adopted:
    """A SimpleITK image of three dimensions, whose world is LPS. Its voxels are copied, since views end with it."""
    if not hasattr(value, "GetNumberOfComponentsPerPixel"):
        raise refused(f"a {name_of(value)}", "an image, as of SimpleITK.ReadImage(path)")
    if value.GetDimension() != 3:
        raise refused(f"an image of {value.GetDimension()} dimensions", "three dimensions: image[:, :, :, 0] of four")
    if value.GetNumberOfComponentsPerPixel() != 1:
        count = value.GetNumberOfComponentsPerPixel()
        raise refused(f"{count} components per voxel", "one: SimpleITK.VectorIndexSelectionCast(image, 0)")
    array = sys.modules["SimpleITK"].GetArrayFromImage(value)
    direction = np.array(value.GetDirection()).reshape(3, 3)
    return Adopted(array, Grid(array.shape, value.GetSpacing(), value.GetOrigin(), direction), "LPS", "mm")


def adopt_itk(value: Any) -> Adopted:
    raise refused(
        f"an {name_of(value)}",
        "clvol.Volume(itk.array_from_image(x), x.GetSpacing(), x.GetOrigin(), itk.array_from_matrix(x.GetDirection()))",
    )


def adopt_nibabel(value: Any) -> Adopted:
    """A spatial image of nibabel, whose world is RAS. A scaling of stored integers becomes slope and offset."""
    if not hasattr(value, "dataobj") or not hasattr(value, "affine"):
        raise refused(f"a {name_of(value)}", "an image, as of nibabel.load(path)")
    shape = tuple(value.shape)
    if len(shape) < 3 or any(n != 1 for n in shape[3:]):
        raise refused(f"an image of shape {shape}", "three dimensions: image.slicer[..., 0]")
    source, slope, offset = value.dataobj, 1.0, 0.0
    if hasattr(source, "get_unscaled"):  # voxels in a file, as stored
        stated = float(source.slope), float(source.inter)
        slope, offset = stated if np.isfinite(stated).all() and stated[0] != 0.0 else (1.0, 0.0)
        source = source.get_unscaled()
    array = np.asarray(source).reshape(shape[:3]).T
    affine = value.affine
    if affine is None:
        return Adopted(array, slope=slope, offset=offset)
    code = _code(value.header)
    if code == 0:
        return Adopted(array, Grid(array.shape, value.header.get_zooms()[:3]), None, "mm", slope=slope, offset=offset)
    grid = Grid.from_steps(array.shape, affine[:3, :3], affine[:3, 3])
    label = _XFORM_NAMES.get(code or 0)
    frame = f"RAS ({label})" if label else "RAS"
    return Adopted(array, grid, frame, "mm", slope=slope, offset=offset)


def _code(header: Any) -> int | None:
    """What NIfTI says of the frame; 0 if it states the sizes of voxels alone, None for other formats."""
    keys = header.keys() if hasattr(header, "keys") else ()
    codes = [int(header[key]) for key in ("sform_code", "qform_code") if key in keys]
    return next((code for code in codes if code > 0), 0) if codes else None
