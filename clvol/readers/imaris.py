"""Imaris 5.5 (.ims): HDF5 with a fixed layout, through h5py (extra "hdf5"). The full resolution is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.extras import library
from clvol.readers.hdf5 import EXTRA, Hdf5Volume, check_chunk
from clvol.readers.options import ReadOptions
from clvol.volume.array_axes import Placed
from clvol.volume.grid import Grid
from clvol.volume.units import find_unit
from clvol.volume.volume import Volume, check_type

_ROOT = "DataSet/ResolutionLevel 0"


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume of one channel and time. Extents of the file become spacing and origin, in its unit."""
    h5py = library("h5py", EXTRA, path)
    with h5py.File(path, "r") as file:
        times = _numbered(file.get(_ROOT), "TimePoint")
        if not times:
            raise VolumeError(str(path), "no data set of Imaris in it", "a file of Imaris 5.5 or newer")
        time = times[options.choose("time", str(path), [None] * len(times))]
        channels = _numbered(file[f"{_ROOT}/{time}"], "Channel")
        names = [_attribute(file.get(f"DataSetInfo/{channel}"), "Name") for channel in channels]
        channel = channels[options.choose("channel", str(path), names)]
        inside = f"/{_ROOT}/{time}/{channel}/Data"
        array, info = file[inside], file["DataSetInfo/Image"]
        if array.ndim != 3:
            raise VolumeError(str(path), f"an array of {array.ndim} axes", "an array [z, y, x]")
        sizes = [int(_attribute(info, key) or 0) for key in "XYZ"]
        low = np.array([float(_attribute(info, f"ExtMin{k}") or 0.0) for k in range(3)])
        high = np.array([float(_attribute(info, f"ExtMax{k}") or 0.0) for k in range(3)])
        # Blocks are stored whole, so the array may be larger than the picture.
        sizes = [min(n, have) if n else have for n, have in zip(sizes, array.shape[::-1])]
        dtype = check_type(array.dtype, str(path))
        check_chunk(array, path, options)
        unit = find_unit(_attribute(info, "Unit"))
    steps = (high - low) / sizes
    if not np.isfinite(steps).all() or (steps <= 0).any():
        options.warn("extents that are not ascending; the spacing is 1")
        steps, low = np.ones(3), -0.5 * np.ones(3)
    grid = Grid(tuple(sizes[::-1]), steps, low + 0.5 * steps)
    return Hdf5Volume(
        path, inside, {}, Placed((0, 1, 2), None, None), dtype, grid, None, "image", options, unit[0] if unit else None
    )


def _numbered(group: Any, word: str) -> list[str]:
    """The members called "WORD n", by n."""
    names = [name for name in group or () if name.startswith(f"{word} ") and name.split(" ")[1].isdecimal()]
    return sorted(names, key=lambda name: int(name.split(" ")[1]))


def _attribute(node: Any, key: str) -> str | None:
    """A text, which Imaris stores as an array of characters."""
    value = None if node is None else node.attrs.get(key)
    if value is None:
        return None
    text = b"".join(np.atleast_1d(value).tolist()) if isinstance(value, np.ndarray) else value
    return text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
