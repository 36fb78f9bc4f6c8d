"""Volumes whose voxels are read when somebody asks for them."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from clvol.volume.grid import Grid
from clvol.volume.memory import check_memory
from clvol.volume.volume import Volume


class LazyVolume(Volume):
    """A volume whose voxels are read when ``data`` is first asked for; ``box`` reads some without
    that.

    Shape, type and grid are known before. ``memory_cap`` as for ``load_volume``, checked when
    voxels are read.
    """

    def __init__(
        self,
        dtype: np.dtype,
        grid: Grid,
        name: str | None,
        frame: str,
        where: str,
        memory_cap: int | None,
        unit: str | None = None,
    ) -> None:
        self._dtype, self._where, self._memory_cap = dtype, where, memory_cap
        self.grid, self.name, self.frame, self.unit = grid, name, frame, unit
        self.path = self.format = None

    @property
    def dtype(self) -> np.dtype:
        return self._dtype

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.grid.shape

    @property
    def nbytes(self) -> int:
        return math.prod(self.shape) * self._dtype.itemsize

    @cached_property
    def data(self) -> np.ndarray:
        """The voxels, all of them; VolumeError if they do not fit or cannot be read."""
        check_memory(self._where, self.nbytes, self._memory_cap)
        voxels = self._load()
        voxels.flags.writeable = False
        return voxels

    def _load(self) -> np.ndarray:
        raise NotImplementedError

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        """Voxels [z0:z1, y0:y1, x0:x1], read from the disk."""
        raise NotImplementedError


class FilledVolume(LazyVolume):
    """``volume`` with ``value`` in the place of NaN, once its voxels are asked for."""

    def __init__(self, volume: LazyVolume, value: float) -> None:
        self._volume, self._value = volume, value
        where, cap = volume._where, volume._memory_cap
        super().__init__(
            volume.dtype, volume.grid, volume.name, volume.frame, where, cap, volume.unit
        )
        self.path, self.format = volume.path, volume.format

    @property
    def value_range(self) -> tuple[float, float]:
        inner = self._volume
        value = float(self.dtype.type(self._value))
        low, high = inner.value_range
        if inner.nan_count + inner.inf_count == math.prod(self.shape):  # none of them is finite
            return value, value
        return min(low, value), max(high, value)

    @property
    def nan_count(self) -> int:
        return 0

    @property
    def inf_count(self) -> int:
        return self._volume.inf_count

    def _load(self) -> np.ndarray:
        return self._filled(self._volume._load())

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        return self._filled(self._volume.box(z0, z1, y0, y1, x0, x1))

    def _filled(self, voxels: np.ndarray) -> np.ndarray:
        voxels = np.require(voxels, requirements="W")
        for layer in voxels:
            np.copyto(layer, self._value, where=np.isnan(layer))
        return voxels
