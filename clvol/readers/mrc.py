"""MRC and CCP4 maps (.mrc, .map, .rec, .ccp4, packed or not), through mrcfile (extra "mrc")."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.extras import library
from clvol.readers.options import ReadOptions
from clvol.volume.grid import Grid
from clvol.volume.memory import check_memory
from clvol.volume.volume import Volume, check_type

EXTRA = "mrc"
_TYPES = {0: "int8", 1: "int16", 2: "float32", 4: "complex64", 6: "uint16", 12: "float16"}


def read(path: Path, options: ReadOptions) -> Volume:
    """The map in an MRC file, in Å: axes by mapc, mapr and maps, steps by the unit cell, origin by ``origin`` or by
    ``nstart``. ``series`` selects one of a stack of volumes.
    """
    mrcfile = library("mrcfile", EXTRA, path)
    with mrcfile.open(path, mode="r", permissive=False, header_only=True) as file:
        header = file.header.copy()
    sizes = [int(header[key]) for key in ("nz", "ny", "nx")]
    if min(sizes) < 1:
        raise VolumeError(str(path), f"sizes {sizes}", "three sizes of at least 1")
    mode = int(header["mode"])
    if mode not in _TYPES:
        raise VolumeError(str(path), f"mode {mode}", "a mode of " + ", ".join(map(str, _TYPES)))
    check_type(np.dtype(_TYPES[mode]), str(path))
    check_memory(str(path), math.prod(sizes) * np.dtype(_TYPES[mode]).itemsize, options.memory_cap)
    with mrcfile.open(path, mode="r", permissive=False) as file:
        data = np.array(file.data)
    if data.ndim == 4:
        data = data[options.choose("series", str(path), [None] * len(data))]
    data = data[None] if data.ndim == 2 else data
    order = [int(header[key]) - 1 for key in ("maps", "mapr", "mapc")]  # the axis (x = 0) of each of the data's
    if order == [-1, -1, -1]:
        order = [2, 1, 0]
    if sorted(order) != [0, 1, 2]:
        raise VolumeError(str(path), f"axes {[axis + 1 for axis in order[::-1]]}", "mapc, mapr and maps of 1, 2 and 3")
    data = data.transpose([order.index(axis) for axis in (2, 1, 0)])
    grid, unit = _grid(header, data.shape, order, path, options)
    return Volume(data, grid.spacing, grid.origin, grid.direction, unit=unit)


def _grid(
    header: Any, shape: tuple[int, ...], order: list[int], path: Path, options: ReadOptions
) -> tuple[Grid, str | None]:
    cell = np.array([float(header["cella"][axis]) for axis in "xyz"])
    counts = np.array([int(header[key]) for key in ("mx", "my", "mz")])
    if not np.isfinite(cell).all() or (cell <= 0).any() or (counts <= 0).any():
        options.warn("no unit cell; the spacing is 1")
        return Grid(shape), None
    steps = _cell_axes(header, options) * (cell / counts)
    origin = np.array([float(header["origin"][axis]) for axis in "xyz"])
    if not np.isfinite(origin).all():
        raise VolumeError(str(path), f"origin {origin.tolist()}", "finite numbers")
    if not origin.any():
        starts = [int(header[key]) for key in ("nzstart", "nystart", "nxstart")]  # of sections, rows, columns
        origin = steps @ np.array([starts[order.index(axis)] for axis in range(3)], float)
    return Grid.from_steps(shape, steps, origin), "Å"


def _cell_axes(header: Any, options: ReadOptions) -> np.ndarray:
    """Unit vectors (columns) along the axes of the unit cell: x along a, b in the plane of x and y."""
    angles = np.array([float(header["cellb"][key]) for key in ("alpha", "beta", "gamma")])
    if not angles.any() or np.array_equal(angles, [90.0, 90.0, 90.0]):
        return np.eye(3)
    alpha, beta, gamma = np.radians(angles)
    with np.errstate(all="ignore"):
        y = (np.cos(alpha) - np.cos(beta) * np.cos(gamma)) / np.sin(gamma)
        z = np.sqrt(1.0 - np.cos(beta) ** 2 - y**2)
    axes = np.array([[1.0, np.cos(gamma), np.cos(beta)], [0.0, np.sin(gamma), y], [0.0, 0.0, z]])
    if not np.isfinite(axes).all() or not z > 1e-3:
        options.warn(f"impossible angles of the unit cell {angles.tolist()}; they count as right ones")
        return np.eye(3)
    return axes
