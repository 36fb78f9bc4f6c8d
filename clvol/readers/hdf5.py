"""HDF5: one numeric array of at least two axes, lazily, through h5py (extra "hdf5")."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.coordinates import even_step, grid_of
from clvol.readers.extras import library
from clvol.readers.options import Key, ReadOptions, named_axes
from clvol.volume.array_axes import Placed, place_axes
from clvol.volume.grid import Grid
from clvol.volume.lazy import LazyVolume
from clvol.volume.memory import check_memory
from clvol.volume.volume import Volume, check_type

EXTRA = "hdf5"
_SIZE = "element_size_um"  # along the axes: written by Fiji, ilastik and others


def read(path: Path, options: ReadOptions) -> Volume:
    """The array in an HDF5 file. Where there are several, ``series`` is the path inside the file of one.

    Axes are recognised by their labels (dimension scales), else three axes are z, y, x. Spacing is that of evenly
    spaced dimension scales, or of the attribute ``element_size_um``. Only metadata are read until voxels are used.
    """
    h5py = library("h5py", EXTRA, path)
    with h5py.File(path, "r") as file:
        names = arrays_in(file, h5py)
        if not names:
            raise VolumeError(str(path), "no numeric array of two axes or more", "an array [z, y, x]")
        inside = names[options.choose("series", str(path), names)]
        array = file[inside]
        labels = [str(dim.label) or None for dim in array.dims]
        placed = place_axes(named_axes(labels, options), array.shape, str(path))
        grid, frame, unit = _grid(array, placed, labels, options)
        pick = picked(placed, array.shape, str(path), options)
        dtype = check_type(array.dtype, str(path))
        check_chunk(array, path, options)
    return Hdf5Volume(path, inside, pick, placed, dtype, grid, Path(inside).name, frame, options, unit)


def arrays_in(file: Any, h5py: Any) -> list[str]:
    """The paths of the numeric arrays of at least two axes, in order. Links out of the file are not followed."""
    found: list[str] = []

    def visit(name: str, node: Any) -> None:
        is_array = isinstance(node, h5py.Dataset) and node.shape is not None
        if is_array and sum(n > 1 for n in node.shape) >= 2 and node.dtype.kind in "iufbc":
            found.append(f"/{name}")

    file.visititems(visit)
    return sorted(found)


def picked(placed: Placed, shape: tuple[int, ...], where: str, options: ReadOptions) -> dict[int, int]:
    """The index along each axis that is none of z, y, x."""
    pick = {k: 0 for k in range(len(shape)) if k not in placed.space}
    chosen: tuple[tuple[Key, int | None], ...] = (("channel", placed.channel), ("time", placed.time))
    for key, axis in chosen:
        if axis is not None:
            pick[axis] = options.choose(key, where, [None] * shape[axis])
    return pick


def _grid(
    array: Any, placed: Placed, labels: list[str | None], options: ReadOptions
) -> tuple[Grid, str, str | None]:
    shape = tuple(1 if k is None else int(array.shape[k]) for k in placed.space)
    scale, shift = [1.0] * 3, [0.0] * 3
    units: list[str | None] = [None] * 3
    sizes = np.atleast_1d(np.asarray(array.attrs.get(_SIZE, ()), float))
    is_known = False
    for i, k in enumerate(placed.space):
        if k is None:
            continue
        scales = [one for one in array.dims[k].values() if one.shape == (array.shape[k],) and one.dtype.kind in "iuf"]
        found = even_step(scales[0][...], labels[k] or str(k), options) if scales else None
        if found is not None:
            (scale[i], shift[i]), is_known = found, True
            units[i] = _text(scales[0].attrs.get("units"))
        elif len(sizes) in (3, array.ndim) and np.isfinite(sizes).all() and (sizes > 0).all():
            scale[i], units[i], is_known = float(sizes[k - array.ndim + len(sizes)]), "µm", True
    grid, unit = grid_of(shape, scale, shift, units, options)
    return grid, "image" if is_known else "index", unit


def _text(value: Any) -> str | None:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, str) else None


def check_chunk(array: Any, path: Path, options: ReadOptions) -> None:
    """VolumeError if a decoded chunk, which may be larger than the array, does not fit into memory."""
    if array.chunks is not None:
        nbytes = int(np.prod([int(n) for n in array.chunks], dtype=object)) * array.dtype.itemsize
        check_memory(str(path), nbytes, options.memory_cap)


class Hdf5Volume(LazyVolume):
    """An array of an HDF5 file, which is opened for each read. ``crop`` is the used part along z, y and x."""

    def __init__(
        self, path: Path, inside: str, pick: dict[int, int], placed: Placed, dtype: np.dtype, grid: Grid,
        name: str | None, frame: str, options: ReadOptions, unit: str | None,
    ) -> None:  # fmt: skip
        super().__init__(dtype, grid, name, frame, str(path), options.memory_cap, unit)
        self._file, self._inside, self._pick, self._placed = path, inside, pick, placed

    def _load(self) -> np.ndarray:
        nz, ny, nx = self.shape
        return self.box(0, nz, 0, ny, 0, nx)

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        h5py = library("h5py", EXTRA, self._file)
        space = self._placed.space
        ranges = dict(zip(space, (slice(z0, z1), slice(y0, y1), slice(x0, x1))))
        try:
            with h5py.File(self._file, "r") as file:
                array = file[self._inside]
                voxels = array[tuple(self._pick.get(k, ranges.get(k)) for k in range(array.ndim))]
        except (OSError, KeyError, ValueError, RuntimeError) as error:
            line = " ".join(str(error).split())[:120]
            raise VolumeError(self._where, f"voxels cannot be read ({line})", "an undamaged HDF5 file") from None
        left = sorted(k for k in space if k is not None)
        voxels = voxels.transpose([left.index(k) for k in space if k is not None])
        voxels = voxels[None] if space[0] is None else voxels
        return np.array(voxels, dtype=self._dtype, order="C")
