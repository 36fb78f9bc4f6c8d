"""Zarr folders: clvol stores, OME-Zarr images, and plain arrays, read lazily by tensorstore."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.options import ReadOptions
from clvol.readers.remote import RemotePath
from clvol.readers.zarr_image import find_image
from clvol.store.arrays import what_failed
from clvol.store.turned import TurnedBlocks
from clvol.store.zarr_store import StoredBlocks, is_store, open_store
from clvol.volume.grid import Grid
from clvol.volume.lazy import LazyVolume
from clvol.volume.volume import Volume, check_type


def read(path: Path | RemotePath, options: ReadOptions) -> Volume:
    """The volume in a Zarr folder. Only metadata are read until voxels are used.

    Of a multiscale image the finest level is read. Axes are recognised by their names where they have names;
    ``options`` select channel and time; an image without z is one slice. Scale and translation of OME-Zarr become
    spacing and origin, in the unit of x.
    """
    if isinstance(path, Path) and is_store(path):
        return StoredVolume(open_store(path), options.memory_cap)
    if isinstance(path, RemotePath) and not path.is_dir():
        raise VolumeError(str(path), "no Zarr metadata there", "zarr.json, .zgroup or .zarray below the URL")
    image = find_image(path, options)
    volume = ZarrVolume(
        image.array, image.grid, image.name, image.frame, str(path), options.memory_cap
    )
    volume.unit = image.unit
    volume.labels = image.labels or np.dtype(image.array.dtype.numpy_dtype).kind == "b"
    return volume


class StoredVolume(LazyVolume):
    """A clvol store, whose range and counts are known without reading voxels. ``blocks_source`` holds its blocks."""

    def __init__(self, source: StoredBlocks | TurnedBlocks, memory_cap: int | None = None) -> None:
        self.blocks_source = source
        super().__init__(
            source.dtype, source.grid, source.name, source.facts.frame, str(source.path), memory_cap
        )
        self.axis, self.unit = source.facts.axis, source.facts.unit
        self.labels = source.codes is not None and source.codes.codec == "labels"

    @property
    def grid(self) -> Grid:
        """The grid, which is also that of ``blocks_source``."""
        return self.blocks_source.grid

    @grid.setter
    def grid(self, grid: Grid) -> None:
        self.blocks_source.grid = grid

    @property
    def stored_range(self) -> tuple[float, float]:
        return self.blocks_source.value_range

    @property
    def nan_count(self) -> int:
        return self.blocks_source.nan_count

    @property
    def inf_count(self) -> int:
        return self.blocks_source.inf_count

    def _turned(self) -> Volume:
        other = StoredVolume(TurnedBlocks(self.blocks_source), self._memory_cap)
        other.path, other.format = self.path, self.format
        return other

    def _load(self) -> np.ndarray:
        return self.blocks_source.volume_level(0)

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        return self.blocks_source.box(z0, z1, y0, y1, x0, x1)


class ZarrVolume(LazyVolume):
    """A Zarr array [z, y, x] that is not a clvol store. Missing chunks count as the fill value, as in Zarr."""

    def __init__(
        self,
        array: Any,
        grid: Grid,
        name: str | None,
        frame: str,
        where: str,
        memory_cap: int | None,
    ) -> None:
        self._array = array
        dtype = check_type(np.dtype(array.dtype.numpy_dtype), where)
        super().__init__(dtype, grid, name, frame, where, memory_cap)

    def _load(self) -> np.ndarray:
        nz, ny, nx = self.shape
        return self.box(0, nz, 0, ny, 0, nx)

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        try:
            voxels = self._array[z0:z1, y0:y1, x0:x1].read().result()
        except ValueError as error:
            raise VolumeError(
                self._where, f"a chunk {what_failed(error)}", "undamaged chunks"
            ) from None
        voxels = np.ascontiguousarray(voxels)
        return voxels.view(np.uint8) if voxels.dtype.kind == "b" else voxels
