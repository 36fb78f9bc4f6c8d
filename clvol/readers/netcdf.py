"""netCDF 3 and 4: one variable of at least two axes, through netCDF4 (extra "netcdf")."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.coordinates import even_step, grid_of
from clvol.readers.extras import library
from clvol.readers.hdf5 import picked
from clvol.readers.netcdf_classic import least_size
from clvol.readers.options import ReadOptions
from clvol.volume.array_axes import Axis, Placed, place_axes
from clvol.volume.axis import ValueAxis
from clvol.volume.grid import Grid
from clvol.volume.memory import check_memory
from clvol.volume.volume import Volume, check_type

EXTRA = "netcdf"


def read(path: Path, options: ReadOptions) -> Volume:
    """The variable in a netCDF file. Where there are several, ``series`` is the name of one, with its group.

    Axes are recognised by the names of dimensions, else three are z, y, x. Evenly spaced coordinates become spacing and
    origin. ``scale_factor`` and ``add_offset`` become slope and offset; fill values become NaN.
    """
    netcdf = library("netCDF4", EXTRA, path)
    if (least := least_size(path)) > path.stat().st_size:
        raise VolumeError(str(path), f"{path.stat().st_size} bytes", f"{least} bytes as the header promises")
    with netcdf.Dataset(path, "r") as file:
        file.set_auto_maskandscale(False)
        found = _variables(file, "")
        if not found:
            raise VolumeError(str(path), "no numeric variable of two axes or more", "a variable [z, y, x]")
        names = list(found)
        variable = found[names[options.choose("series", str(path), names)]]
        placed = place_axes([Axis(name) for name in variable.dimensions], variable.shape, str(path))
        grid, frame, unit = _grid(variable, placed, options)
        pick = picked(placed, variable.shape, str(path), options)
        check_type(np.dtype(variable.dtype), str(path))
        check_memory(str(path), math.prod(grid.shape) * np.dtype(variable.dtype).itemsize, options.memory_cap)
        voxels = np.asarray(variable[tuple(pick.get(k, slice(None)) for k in range(variable.ndim))])
        voxels = _with_holes(voxels, variable)
        axis = _value_axis(variable, path)
        name = variable.name
    left = sorted(k for k in placed.space if k is not None)
    voxels = voxels.transpose([left.index(k) for k in placed.space if k is not None])
    voxels = voxels[None] if placed.space[0] is None else voxels
    volume = Volume(
        voxels, grid.spacing, grid.origin, grid.direction, name, frame=frame, unit=unit
    )
    volume.axis = axis
    return volume


def _variables(group: Any, prefix: str) -> dict[str, Any]:
    """The variables of at least two axes in a group and in those below, by their paths."""
    found = {
        f"{prefix}{name}": one for name, one in group.variables.items()
        if sum(n > 1 for n in one.shape) >= 2 and getattr(one.dtype, "kind", "") in "iuf"
    }  # fmt: skip
    for name, inner in group.groups.items():
        found |= _variables(inner, f"{prefix}{name}/")
    return found


def _grid(variable: Any, placed: Placed, options: ReadOptions) -> tuple[Grid, str, str | None]:
    shape = tuple(1 if k is None else int(variable.shape[k]) for k in placed.space)
    scale, shift = [1.0] * 3, [0.0] * 3
    units: list[str | None] = [None] * 3
    is_known = False
    for i, k in enumerate(placed.space):
        coordinate = None if k is None else _coordinate(variable, variable.dimensions[k])
        if k is None or coordinate is None:
            continue
        found = even_step(coordinate[...], variable.dimensions[k], options)
        if found is not None:
            (scale[i], shift[i]), is_known = found, True
            unit = getattr(coordinate, "units", None)
            units[i] = unit if isinstance(unit, str) else None
    grid, unit_name = grid_of(shape, scale, shift, units, options)
    return grid, "image" if is_known else "index", unit_name


def _coordinate(variable: Any, dimension: str) -> Any:
    """The coordinates along a dimension, in the variable's group or in one above; None if there are none."""
    group = variable.group()
    while group is not None:
        one = group.variables.get(dimension)
        if one is not None and one.dimensions == (dimension,) and getattr(one.dtype, "kind", "") in "iuf":
            return one
        group = group.parent
    return None


def _with_holes(voxels: np.ndarray, variable: Any) -> np.ndarray:
    """``voxels`` with NaN where the variable has a fill value; integers with holes become floating point."""
    holes = np.zeros(voxels.shape, bool)
    for key in ("_FillValue", "missing_value"):
        value = getattr(variable, key, None)
        if value is not None and np.size(value) == 1 and np.asarray(value).dtype.kind in "iuf":
            holes |= voxels == value
    if not holes.any():
        return voxels
    if voxels.dtype.kind in "iu":
        voxels = voxels.astype(np.float32 if voxels.dtype.itemsize <= 2 else np.float64)
    else:
        voxels = voxels.copy()
    voxels[holes] = np.nan
    return voxels


def _value_axis(variable: Any, path: Path) -> ValueAxis:
    numbers = []
    for key, default in (("scale_factor", 1.0), ("add_offset", 0.0)):
        try:
            numbers.append(float(getattr(variable, key, default)))
        except (TypeError, ValueError):
            raise VolumeError(str(path), f"{key} is not a number", "a number") from None
    return ValueAxis(*numbers)
