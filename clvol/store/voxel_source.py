"""Sources of voxels for building a store."""

from __future__ import annotations

import hashlib
import mmap
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from clvol.lazily import lazily
from clvol.volume.axis import ValueAxis
from clvol.volume.grid import Grid
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.volume import procedural
else:
    procedural = lazily("clvol.volume.procedural")


class VoxelSource(Protocol):
    """The source of a store's voxels: anything that can return a box of voxels.

    A source may have an ``axis`` (``ValueAxis``), which the store records, and ``labels``: whether its voxels are
    labels, which no lossy codec takes. ``identity`` (JSON) changes when the voxels do: an interrupted build is resumed
    only with the same identity.
    """

    shape: tuple[int, int, int]
    dtype: np.dtype
    grid: Grid
    name: str | None
    frame: str

    @property
    def identity(self) -> dict:
        """What distinguishes these voxels from others, as JSON types."""
        ...

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        """Voxels [z0:z1, y0:y1, x0:x1] of ``dtype``. Called by several threads."""
        ...


class VolumeSource:
    """A volume in memory, mapped from a file, or one that reads boxes itself (``Volume.box``).

    ``settings`` (JSON): everything else that decides how the file's bytes become voxels.
    """

    def __init__(self, volume: Volume, settings: dict | None = None) -> None:
        self.volume, self.settings = volume, settings or {}
        self.shape, self.dtype, self.grid = volume.shape, volume.dtype, volume.grid
        self.name, self.frame, self.axis = volume.name, volume.frame, volume.axis
        self.unit, self.labels = volume.unit, volume.labels

    @property
    def identity(self) -> dict:
        """The path, size and time of a file; for an array without a file, a digest of its bytes."""
        volume = self.volume
        if volume.path is not None:
            place = os.path.realpath(volume.path)
            files = [_files_digest(Path(name)) for name in (volume.path, *volume.files)]
            return {"path": place, "files": " ".join(files), "settings": self.settings}
        digest = hashlib.blake2b(digest_size=16)
        for layer in volume.data:
            digest.update(layer)
        return {"digest": digest.hexdigest()}

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        if hasattr(self.volume, "box"):
            return self.volume.box(z0, z1, y0, y1, x0, x1)
        return np.array(self.volume.data[z0:z1, y0:y1, x0:x1])

    def forget(self) -> None:
        """Releases the pages of a mapped file that have been read from this process's memory."""
        if hasattr(self.volume, "box"):
            return
        array: Any = self.volume.data
        while isinstance(array, np.ndarray):
            array = array.base
        if isinstance(array, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
            array.madvise(mmap.MADV_DONTNEED)


def _files_digest(path: Path) -> str:
    """A digest of the names, sizes and times of the file, or of the folder's files."""
    digest = hashlib.blake2b(digest_size=16)
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for file in files:
        facts = file.stat()
        digest.update(f"{file.relative_to(path)} {facts.st_size} {facts.st_mtime_ns}\n".encode())
    return digest.hexdigest()


class FieldSource:
    """A computed field (``clvol.volume.procedural.scene_field``) of any size: only one box at a time is in memory.
    ``size`` (nx, ny, nz); voxels of 8 bits.
    """

    dtype = np.dtype(np.uint8)
    frame = "world"

    def __init__(
        self,
        kind: str,
        size: Sequence[int],
        spacing: Sequence[float] = (1.0, 1.0, 1.0),
        axis: ValueAxis = ValueAxis(),
    ) -> None:
        self.name: str | None = kind
        self.axis = axis
        self._field, self.grid = procedural.placed_field(kind, size, spacing)
        self.shape = self.grid.shape

    @property
    def identity(self) -> dict:
        return {"field": self.name}

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        box = slice(z0, z1), slice(y0, y1), slice(x0, x1)
        return procedural.sample_box(self._field, self.grid, self.dtype, box)
