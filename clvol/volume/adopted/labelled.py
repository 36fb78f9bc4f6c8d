"""Arrays whose axes have names: xarray's DataArray with its coordinates, and arrays of zarr."""

from __future__ import annotations

from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.adopted.arrays import voxels_of
from clvol.volume.adopted.facts import Adopted, name_of, refused
from clvol.volume.array_axes import Axis, Placed, place_axes
from clvol.volume.grid import Grid
from clvol.volume.memory import check_memory
from clvol.volume.units import one_unit

_EVEN = 1e-3  # tolerance of coordinates, as a share of a step


def adopt_xarray(value: Any) -> Adopted:
    """A DataArray: axes by the names of its dimensions, spacing and origin by its coordinates.

    Descending coordinates are kept: the axis is flipped in the world. Without coordinates the spacing is 1. VolumeError
    for coordinates that are not evenly spaced, for several times or channels, and for a Dataset.
    """
    if not hasattr(value, "dims") or not hasattr(value, "values") or hasattr(value, "data_vars"):
        names = ", ".join(map(repr, list(getattr(value, "data_vars", ()))[:8]))
        raise refused(f"a {name_of(value)}", f"one of its variables ({names}), as in dataset[name]")
    dims = [str(dim) for dim in value.dims]
    placed = _placed(dims, value.shape, "x.isel({}=0)")
    check_memory("volume", int(value.size) * np.dtype(value.dtype).itemsize, None)
    array = _arranged(np.asarray(value.values), placed)
    steps, shifts, units = [1.0] * 3, [0.0] * 3, [None] * 3
    is_known = False
    for i, k in enumerate(placed.space):
        if k is None or value.dims[k] not in value.coords:
            continue
        coordinate = value.coords[value.dims[k]]
        steps[i], shifts[i] = _even(np.asarray(coordinate.values), dims[k], coordinate.shape)
        units[i] = coordinate.attrs.get("units")
        is_known = True
    unit_names = [unit if isinstance(unit, str) else None for unit in units[::-1]]
    factors, unit, wrong = one_unit(unit_names, [n > 1 for n in array.shape[::-1]])
    grid = Grid.from_steps(
        array.shape, np.diag(np.array(steps[::-1]) * factors), np.array(shifts[::-1]) * factors
    )
    name = None if value.name is None else str(value.name)
    return Adopted(array, grid, "image" if is_known else None, unit, name, note=wrong)


def adopt_zarr(value: Any) -> Adopted:
    """An array of zarr, with its axes by their names where it has names, and spacing 1."""
    if not hasattr(value, "chunks") or not hasattr(value, "dtype"):
        raise refused(
            f"a {name_of(value)}", "one of the arrays in it: group['0']; clvol.load_volume(path) reads OME-Zarr"
        )
    names = getattr(getattr(value, "metadata", None), "dimension_names", None)
    names = names or value.attrs.get("_ARRAY_DIMENSIONS")
    if not names or len(names) != value.ndim:
        return Adopted(voxels_of(value))
    placed = _placed([str(name or "") for name in names], value.shape, "x[index of {}]")
    return Adopted(_arranged(voxels_of(value), placed))


def _placed(names: list[str], shape: tuple[int, ...], pick: str) -> Placed:
    try:
        placed = place_axes([Axis(name) for name in names], shape, "volume")
    except VolumeError as error:
        raise VolumeError("volume", error.what, f"{error.expected}; x.transpose('z', 'y', 'x') orders them") from None
    for kind, axis in (("channels", placed.channel), ("times", placed.time)):
        if axis is not None and shape[axis] != 1:
            series = "; clvol.VolumeSeries(x) shows all of them" if kind == "times" and "isel" in pick else ""
            one = f"one of them: {pick.format(names[axis])}{series}"
            raise refused(f"{shape[axis]} {kind} along {names[axis]}", one)
    return placed


def _arranged(array: np.ndarray, placed: Placed) -> np.ndarray:
    """``array`` as [z, y, x]; axes of length 1 that are none of these go."""
    space = [k for k in placed.space if k is not None]
    array = array[tuple(slice(None) if k in space else 0 for k in range(array.ndim))]
    left = sorted(space)
    array = array.transpose([left.index(k) for k in space])
    return array[None] if placed.space[0] is None else array


def _even(values: np.ndarray, name: str, shape: tuple[int, ...]) -> tuple[float, float]:
    """Step and first of evenly spaced coordinates."""
    instead = f"evenly spaced coordinates along {name}: x.interp({name}=…), or x.drop_vars({name!r}) for a spacing of 1"
    if values.ndim != 1 or values.dtype.kind not in "iuf":
        raise refused(f"coordinates of type {values.dtype} along {name}", instead)
    exact = values.astype(np.float64)
    if not np.isfinite(exact).all():
        raise refused(f"coordinates along {name} that are not finite", instead)
    if len(exact) == 1:
        return 1.0, float(exact[0])
    step = float(exact[-1] - exact[0]) / (len(exact) - 1)
    off = float(np.abs(exact - (exact[0] + step * np.arange(len(exact)))).max())
    rounding = float(np.spacing(np.abs(values).max())) if values.dtype.kind == "f" else 0.0
    if step == 0.0 or off > _EVEN * abs(step) + 2.0 * min(rounding, 0.05 * abs(step)):
        raise refused(f"coordinates along {name} that are not evenly spaced", instead)
    return step, float(exact[0])
