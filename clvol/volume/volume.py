"""A scalar volume: an array [z, y, x] on a grid, with the meaning and the statistics of its values."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from clvol.errors import ClvolWarning, VolumeError
from clvol.volume.adopted import Adopted, adopt
from clvol.volume.axis import ValueAxis, turned
from clvol.volume.colored import Colors, ColorValue, colored_volume, components
from clvol.volume.grid import Grid
from clvol.volume.narrow import WIDE_TYPES, Narrowing, current_narrowing, narrowed

ACCEPTED_TYPES = ("uint8", "int8", "uint16", "int16", "float32", "float64")
ACCEPTED = (
    "uint8, int8, uint16, int16, float32, float64 (bool counts as uint8; 32- and 64-bit integers "
    "and float16 become one of these)"
)

# Voxels that are examined together: few enough for the cache, enough to hide the overhead of Python.
_BLOCK = 1 << 20
_LOOKED_AT = 257  # voxels that are compared to find a change


class Volume:
    """An array [z, y, x] of scalars on a regular grid.

    ``array`` is an array of numpy, or an object that states its own grid: a DataArray of xarray (dimensions and
    coordinates), an image of SimpleITK (LPS) or nibabel (RAS), a vtkImageData or pyvista.ImageData; or an array of
    zarr, dask, h5py, tensorstore or DLPack. ``spacing``, ``origin``, ``direction``, ``name``, ``frame`` and ``unit``
    take the place of the object's; without one, spacing is 1 and the first voxel at the origin.

    ``array`` is 3-D, of uint8, int8, uint16, int16, float32 or float64; bool is viewed as uint8 (0 and 1). Integers
    of 32 and 64 bits, and float16, are copied into the smallest of these types that holds every value exactly. No
    value is ever changed: VolumeError is raised if no type holds them all, and for any other type. Arrays of another
    byte order or memory layout are copied into native C order. All others are shared, not copied, and must not be
    modified once the volume has been used: for modified voxels create another Volume (which costs nothing) and another
    Renderer. ``check_unchanged``, which a Renderer calls per frame, detects most modifications. ``spacing``,
    ``origin`` and ``direction`` are as in Grid.

    ``slope`` (not 0) and ``offset`` map stored numbers to values: value = slope * stored + offset. ``value_range``,
    transfer functions, iso-values and labels are in values; ``data`` holds the stored numbers. ``labels``: the voxels
    are labels, so integers beyond +-2^53, which no scene can name, may become +-2^53. The attribute ``labels`` says
    whether they are labels as far as is known: by this argument, by the file, or since they are bool.

    ``data`` is the C-contiguous, native-endian, read-only array. ``frame`` names the world's frame ("LPS", "RAS", ...;
    "index" if it is unknown), ``unit`` its unit of length ("mm", "µm", ...; None if it is unknown). ``path`` and
    ``format`` say where the volume came from, or are None.
    """

    axis = ValueAxis()
    labels = False
    narrowed = False  # the voxels were of a type that no volume has, and their own follows from their values
    files: tuple[str, ...] = ()  # data files beside ``path`` that the voxels come from
    colors: Colors | None = None  # of voxels that have some; ``data`` is then one value of each
    _seen: bytes | None = None  # a sample of voxels that others can write to, as they were

    def __init__(
        self,
        array: Any,
        spacing: Sequence[float] | None = None,
        origin: Sequence[float] | None = None,
        direction: np.ndarray | None = None,
        name: str | None = None,
        *,
        frame: str | None = None,
        path: str | None = None,
        format: str | None = None,
        unit: str | None = None,
        slope: float = 1.0,
        offset: float = 0.0,
        labels: bool = False,
    ) -> None:
        own = adopt(array) or Adopted(array)
        if own.note is not None:
            warnings.warn(ClvolWarning("volume", own.note), stacklevel=2)
        self.axis = ValueAxis(slope, offset).after(ValueAxis(own.slope, own.offset))
        self.data = _as_voxels(own.array, Narrowing(labels=True) if labels else current_narrowing())
        self.labels = labels or getattr(own.array, "dtype", None) == np.bool_
        self.narrowed = _is_wide(own.array)
        self.grid = _placed(own.grid or Grid(self.data.shape), spacing, origin, direction)
        self.name = own.name if name is None else name
        self.frame = frame or own.frame or "index"
        self.path = path
        self.format = format
        self.unit = own.unit if unit is None else unit

    @classmethod
    def from_colors(cls, array: Any, value: ColorValue = "luminance", **keys: Any) -> Volume:
        """A volume whose voxels have colours: ``array`` [z, y, x, 3], or 4 with alpha.

        Integers are sRGB-encoded over the range of their type, floating-point numbers are linear light from 0 to 1.
        ``value`` is what the transfer function classifies: the "luminance" (Rec. 709), the "brightness" (largest
        component) or the "alpha". Other arguments are those of ``Volume``. Raises VolumeError.
        """
        return colored_volume([cls(each, **keys) for each in components(array, value)], value, cls)

    @property
    def dtype(self) -> np.dtype:
        """The voxels' type, native-endian."""
        return self.data.dtype

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nz, ny, nx)."""
        return self.data.shape

    @property
    def nbytes(self) -> int:
        """Bytes of all voxels."""
        return self.data.nbytes

    @cached_property
    def _census(self) -> Census:
        self._seen = _some_bytes(self.data)
        return _take_census(self.data)

    def check_unchanged(self) -> None:
        """VolumeError if voxels have changed since the value range, on which other data depend, was determined.

        Only some voxels, evenly spread, are compared: computations in place are detected, a change of one voxel may
        not be.
        """
        if self._seen is not None and _some_bytes(self.data) != self._seen:
            what = "its array was changed while the volume is in use"
            raise VolumeError(self.name or "volume", what, "another Volume and Renderer for changed voxels")

    @property
    def slope(self) -> float:
        """Values are slope * stored + offset; never 0."""
        return self.axis.slope

    @property
    def offset(self) -> float:
        """See ``slope``."""
        return self.axis.offset

    @property
    def value_range(self) -> tuple[float, float]:
        """Smallest and largest value of a finite voxel; (0.0, 0.0) if no voxel is finite."""
        if self.axis.is_plain:
            return self.stored_range
        if self.nan_count + self.inf_count == math.prod(self.shape):
            return 0.0, 0.0
        return self.axis.span(self.stored_range)

    @property
    def stored_range(self) -> tuple[float, float]:
        """As ``value_range``, in the stored numbers of ``data``."""
        return self._census.lower, self._census.upper

    @property
    def plain(self) -> tuple[Volume, ValueAxis]:
        """A volume whose stored numbers are its values, and the axis from them to the values of this volume.

        The axis has a positive slope: if that of this volume is negative, the voxels are mirrored in their type, so
        that the order of values is kept; otherwise they are shared.
        """
        # Not cached if it is this volume itself: a reference cycle would keep it alive.
        return (self, self.axis) if self.axis.is_plain else self._plain

    @cached_property
    def _plain(self) -> tuple[Volume, ValueAxis]:
        if self.axis.slope > 0:
            plain, axis = copy.copy(self), self.axis
        else:
            plain, axis = self._turned(), self.axis.turned(self.dtype)
        plain.axis = ValueAxis()
        return plain, axis

    def _turned(self) -> Volume:
        """A copy whose voxels have the reverse order of values."""
        data = turned(self.data, self.dtype)
        data.flags.writeable = False
        other = copy.copy(self)
        other.__dict__.pop("_census", None)
        other.data = data
        return other

    @property
    def nan_count(self) -> int:
        """Voxels that are NaN."""
        return self._census.nans

    @property
    def inf_count(self) -> int:
        """Voxels that are +inf or -inf."""
        return self._census.infs

    def __repr__(self) -> str:
        nx, ny, nz = self.grid.size
        label = f" {self.name!r}" if self.name else ""
        return f"<Volume{label} {nx} x {ny} x {nz} {self.dtype}>"


@dataclass(frozen=True)
class Census:
    lower: float
    upper: float
    nans: int
    infs: int


def check_type(dtype: np.dtype, where: str) -> np.dtype:
    """The native type in which voxels of ``dtype`` are read; VolumeError if there is none.

    Types in ``WIDE_TYPES`` are narrowed once their values are known.
    """
    if dtype.fields is not None or dtype.kind == "c" or dtype.subdtype is not None:
        kind = "complex" if dtype.kind == "c" else "RGB or vector"
        raise VolumeError(where, f"{kind} voxels ({dtype})", f"one scalar per voxel: {ACCEPTED}")
    if dtype.kind == "b":
        return np.dtype(np.uint8)
    native = dtype.newbyteorder("=")
    if native.name not in ACCEPTED_TYPES and native.name not in WIDE_TYPES:
        raise VolumeError(where, f"voxels of type {native.name}", ACCEPTED)
    return native


def _is_wide(array: Any) -> bool:
    dtype = getattr(array, "dtype", None)
    return isinstance(dtype, np.dtype) and dtype.newbyteorder("=").name in WIDE_TYPES


def _placed(
    grid: Grid, spacing: Sequence[float] | None, origin: Sequence[float] | None, direction: np.ndarray | None
) -> Grid:
    """``grid`` with what the caller states in place of its own."""
    if spacing is None and origin is None and direction is None:
        return grid
    return Grid(
        grid.shape,
        grid.spacing if spacing is None else spacing,
        grid.origin if origin is None else origin,
        grid.direction if direction is None else direction,
    )


def _as_voxels(array: np.ndarray, how: Narrowing) -> np.ndarray:
    if isinstance(array, np.ma.MaskedArray):
        raise VolumeError("volume", "a masked array", "a plain array (masked voxels set to NaN)")
    try:
        array = np.asarray(array)
    except ValueError:
        raise VolumeError("volume", "no array of numbers", "an array [z, y, x]") from None
    native = check_type(array.dtype, "volume")
    if array.ndim != 3:
        hint = " (RGB, vector or time-dependent data?)" if array.ndim > 3 else ""
        raise VolumeError("volume", f"{array.ndim}-D array{hint}", "a 3-D array [z, y, x]")
    if array.size == 0:
        raise VolumeError("volume", f"empty array of shape {array.shape}", "at least one voxel")
    if array.dtype.kind == "b":
        array = np.ascontiguousarray(array).view(np.uint8)
    voxels = narrowed(np.ascontiguousarray(array, dtype=native), "volume", how).view()
    voxels.flags.writeable = False
    return voxels


def _some_bytes(data: np.ndarray) -> bytes | None:
    """A sample of the voxels of an array that can be written to; None for a read-only one."""
    owner: np.ndarray | None = data
    while isinstance(owner, np.ndarray) and not owner.flags.writeable:
        owner = owner.base
    if not isinstance(owner, np.ndarray):  # a mapped file, or bytes
        return None
    flat = data.reshape(-1)
    return flat[:: max(1, flat.size // _LOOKED_AT)].tobytes()


def _take_census(data: np.ndarray) -> Census:
    """Range and counts in one pass over the voxels, block by block, so that temporaries stay small."""
    flat = data.reshape(-1)
    lower, upper, nans, infs = np.inf, -np.inf, 0, 0
    with np.errstate(all="ignore"):
        for start in range(0, flat.size, _BLOCK):
            block = flat[start : start + _BLOCK]
            low, high = float(block.min()), float(block.max())
            # min and max carry NaN and inf, so finite ones prove the block finite.
            if not (np.isfinite(low) and np.isfinite(high)):
                block_nans = int(np.count_nonzero(np.isnan(block)))
                finite = block[np.isfinite(block)]
                nans += block_nans
                infs += block.size - finite.size - block_nans
                if finite.size == 0:
                    continue
                low, high = float(finite.min()), float(finite.max())
            lower, upper = min(lower, low), max(upper, high)
    if lower > upper:
        lower = upper = 0.0
    return Census(lower, upper, nans, infs)


def describe(volume: Volume) -> dict:
    """What ``clvol info`` prints, as JSON types.

    ``direction`` is row by row (column k is index axis k), ``bounds_world`` the lower and the upper
    corner of the axis-parallel box around the domain, ``unit`` the name of the world's unit of
    length or None. ``value_range`` is in values, which are slope * stored + offset; ``dtype`` is the type
    of the stored numbers.
    """
    corners = volume.grid.world_corners()
    return {
        "path": volume.path,
        "format": volume.format,
        "shape_zyx": list(volume.shape),
        "size_xyz": list(volume.grid.size),
        "dtype": volume.dtype.name,
        "spacing": list(volume.grid.spacing),
        "origin": list(volume.grid.origin),
        "direction": volume.grid.direction.tolist(),
        "frame": volume.frame,
        "unit": volume.unit,
        "slope": volume.slope,
        "offset": volume.offset,
        "value_range": list(volume.value_range),
        "nan_count": volume.nan_count,
        "inf_count": volume.inf_count,
        "nbytes": volume.nbytes,
        "bounds_world": [corners.min(axis=0).tolist(), corners.max(axis=0).tolist()],
    }
