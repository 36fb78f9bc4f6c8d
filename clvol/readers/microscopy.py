"""Microscopes' own formats (.czi of Zeiss, .nd2 of Nikon), through bioio (extra "microscopy")."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.extras import library
from clvol.readers.options import ReadOptions
from clvol.volume.memory import check_memory
from clvol.volume.volume import Volume, check_type

EXTRA = "microscopy"
_PLUGINS = {".czi": "bioio_czi", ".nd2": "bioio_nd2"}


def read(path: Path, options: ReadOptions) -> Volume:
    """One channel and time of one scene (``series``), in micrometres."""
    bioio = library("bioio", EXTRA, path)
    plugin = library(_PLUGINS[path.suffix.lower()], EXTRA, path)
    return volume_of(bioio.BioImage(path, reader=plugin.Reader), path, options)


def volume_of(image: Any, path: Path, options: ReadOptions) -> Volume:
    """The volume of a BioImage."""
    where = str(path)
    scenes = [str(scene) for scene in image.scenes]
    image.set_scene(image.scenes[options.choose("series", where, scenes)])
    if "S" in image.dims.order and image.dims.S > 1:
        raise VolumeError(where, f"{image.dims.S} samples per voxel (RGB)", "one scalar per voxel")
    names = list(image.channel_names or []) or [None] * image.dims.C
    channel = options.choose("channel", where, names if len(names) == image.dims.C else [None] * image.dims.C)
    time = options.choose("time", where, [None] * image.dims.T)
    dtype = np.dtype(image.dtype)
    check_type(dtype, where)
    shape = image.dims.Z, image.dims.Y, image.dims.X
    check_memory(where, math.prod(shape) * dtype.itemsize, options.memory_cap)
    data = np.asarray(image.get_image_dask_data("ZYX", C=channel, T=time).compute())
    sizes = image.physical_pixel_sizes
    spacing = [size if size and math.isfinite(size) and size > 0 else 1.0 for size in (sizes.X, sizes.Y, sizes.Z)]
    is_known = bool(sizes.X and sizes.Y)
    return Volume(data, spacing, frame="image" if is_known else "index", unit="µm" if is_known else None)
