"""Readers: one module per format, selected by the path's ending; for a folder, by its contents.

A new format is a module with ``read(path, options) -> Volume`` and a line in ``recognise.ENDINGS``. Readers may let
exceptions of their library pass: ``load_volume`` turns each into a VolumeError that names the file. Where there are
several channels, times or series they call ``options.choose``; ``options.warn`` reports what the user should know
although the volume can be read. Libraries are imported where they are used, so that unneeded ones cost no time.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import numpy as np

from clvol.errors import ClvolError, ClvolWarning, SeveralChannels, VolumeError
from clvol.readers.options import ReadOptions, SeveralTimes
from clvol.readers.quiet import quiet
from clvol.readers.recognise import ENDINGS, ending_of, first_line, format_of, format_of_url, is_volume_path
from clvol.readers.remote import RemotePath, is_url
from clvol.volume.axis import ValueAxis
from clvol.volume.grid import Grid
from clvol.volume.lazy import narrowed_volume
from clvol.volume.narrow import Narrowing, narrowing
from clvol.volume.volume import Volume

__all__ = ["ENDINGS", "is_url", "is_volume_path", "load_volume"]


def load_volume(
    path: str | os.PathLike,
    *,
    dims: Sequence[int] | None = None,
    dtype: str | np.dtype | None = None,
    spacing: Sequence[float] | None = None,
    header_bytes: int | None = None,
    byte_order: str | None = None,
    slope: float = 1.0,
    offset: float = 0.0,
    labels: bool = False,
    memory_cap: int | None = None,
    channel: int | str | None = None,
    time: int | str | None = None,
    series: int | str | None = None,
) -> Volume:
    """Reads a volume from a file, from a folder of DICOM or TIFF slices or in Zarr form, or from Zarr by URL.

    A volume in Zarr form, including a clvol store, is lazy: its voxels are read when ``data`` is first used.

    ``dims`` (nx, ny, nz) and ``dtype`` describe a .raw file, ``header_bytes`` counts the bytes before its voxels (-1:
    the voxels are at the end of the file), and ``byte_order`` is "little" or "big"; all four are refused for other
    formats. ``spacing`` (sx, sy, sz) in world units overrides that of the file; origin and direction stay. ``slope``
    and ``offset``, as for ``Volume``, apply to the values that the file states, after a slope and an offset of its
    own. ``labels`` is as for ``Volume``. ``memory_cap`` is the number of bytes that the voxels may take, checked
    against the header before any voxel is read. The default is 75 % of the available memory; .npy and .raw files,
    which are mapped and take no memory of their own, may then have any size.

    ``channel``, ``time`` and ``series`` select one of several by index from 0 or by name; a DICOM series also by its
    SeriesInstanceUID. Without them a file with several is refused, with an error that lists them.

    Voxels keep the file's type; big-endian data become native, and integers of 32 and 64 bits are narrowed without
    loss (``Volume``). Nothing else is converted, cropped or downsampled. World coordinates are in the file's own
    frame, named by ``Volume.frame``.

    Raises VolumeError, naming the path, for everything that cannot be read exactly. Warns (ClvolWarning) of
    everything that is left out or assumed.
    """
    try:
        volume, notes = read_volume(
            path, dims=dims, dtype=dtype, spacing=spacing, header_bytes=header_bytes, byte_order=byte_order,
            slope=slope, offset=offset, labels=labels, memory_cap=memory_cap, channel=channel, time=time, series=series,
        )  # fmt: skip
    except SeveralTimes as several:
        what = f"time = {time!r}, where one of {len(several.names)} times is read"
        raise VolumeError(os.fspath(path), what, "the index of one; a scene shows all of them") from None
    for text in notes:
        warnings.warn(ClvolWarning(os.fspath(path), text), stacklevel=2)
    return volume


def read_volume(
    path: str | os.PathLike,
    *,
    dims: Sequence[int] | None = None,
    dtype: str | np.dtype | None = None,
    spacing: Sequence[float] | None = None,
    header_bytes: int | None = None,
    byte_order: str | None = None,
    slope: float = 1.0,
    offset: float = 0.0,
    labels: bool = False,
    memory_cap: int | None = None,
    channel: int | str | None = None,
    time: int | str | None = None,
    series: int | str | None = None,
) -> tuple[Volume, list[str]]:
    """As ``load_volume``; what it would warn of is returned. SeveralTimes where ``time`` is ``ALL_TIMES`` and the file
    has an axis of times."""
    try:
        where = os.fspath(path)
        file = RemotePath(where) if is_url(where) else Path(where)
    except TypeError:
        raise VolumeError("volume", f"path of type {type(path).__name__}", "a path") from None
    axis = ValueAxis(slope, offset)
    options = ReadOptions(
        dims, dtype, spacing, memory_cap, channel, time, series, header_bytes, byte_order
    )
    format_name, module = format_of_url(where) if isinstance(file, RemotePath) else format_of(file)
    for_raw = {
        "dims": dims, "dtype": dtype, "header_bytes": header_bytes, "byte_order": byte_order
    }  # fmt: skip
    given = [name for name, value in for_raw.items() if value is not None]
    if module != "raw" and given:
        raise VolumeError(where, f"{given[0]} given", f"{given[0]} only with a .raw file")
    try:
        how = Narrowing(memory_cap, labels)
        with quiet(), narrowing(how):
            reader = import_module(f"{__name__}.{module}")
            volume = narrowed_volume(reader.read(file, options), how)
            options.check_consulted(where)
            if spacing is not None:
                grid = volume.grid
                volume.grid = Grid(grid.shape, tuple(spacing), grid.origin, grid.direction)
    except SeveralChannels:
        raise
    except VolumeError as error:
        own = error.where in (where, str(file), "volume")
        what = error.what if own else f"{error.where}: {error.what}"
        raise VolumeError(where, what, error.expected) from error.__cause__
    except (ClvolError, SeveralTimes):
        raise
    except MemoryError as error:
        raise VolumeError(where, "the volume does not fit into memory") from error
    except OSError as error:
        reason = error.strerror or first_line(error)
        raise VolumeError(where, reason, f"a readable {format_name} file") from error
    except Exception as error:  # what a library makes of a damaged file can be any exception
        raise VolumeError(
            where, f"unreadable: {first_line(error)}", f"an undamaged {format_name} file"
        ) from error
    volume.axis = axis.after(volume.axis)
    volume.labels = volume.labels or labels
    volume.path = where
    volume.format = format_name
    if volume.name is None:
        volume.name = _stem(file)
    return volume, options.notes


def _stem(path: Path | RemotePath) -> str:
    if isinstance(path, RemotePath):
        return path.name.removesuffix(".zarr")
    ending = ending_of(path)
    return path.name[: -len(ending)] if ending and path.is_file() else path.resolve().name
