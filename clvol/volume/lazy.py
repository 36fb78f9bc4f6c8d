"""Volumes whose voxels are read when they are first used."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from clvol.volume.axis import ValueAxis, turned
from clvol.volume.grid import Grid
from clvol.volume.memory import check_memory
from clvol.volume.narrow import WIDE_TYPES, Narrowing, cast, exact_type
from clvol.volume.volume import Volume

_SLAB = 1 << 26  # bytes read together to find a type


class LazyVolume(Volume):
    """A volume whose voxels are read when ``data`` is first used; ``box`` reads a part of them.

    Shape, type and grid are known from the beginning. ``memory_cap`` is that of ``load_volume``, and is checked when
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
        self.axis = ValueAxis()

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
    def data(self) -> np.ndarray:  # type: ignore[override]  # mypy takes it to be read-only
        """All voxels. VolumeError if they do not fit into memory or cannot be read."""
        check_memory(self._where, self.nbytes, self._memory_cap)
        voxels = self._load()
        voxels.flags.writeable = False
        return voxels

    @property
    def is_read(self) -> bool:
        """Whether all voxels have been read."""
        return "data" in vars(self)

    def _load(self) -> np.ndarray:
        raise NotImplementedError

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        """The voxels [z0:z1, y0:y1, x0:x1], read from disk."""
        raise NotImplementedError

    def _turned(self) -> Volume:
        return TurnedVolume(self)


class _Converted(LazyVolume):
    """``volume`` with converted voxels; everything else is unchanged."""

    def __init__(self, volume: LazyVolume) -> None:
        self._volume = volume
        where, cap = volume._where, volume._memory_cap
        super().__init__(
            volume.dtype, volume.grid, volume.name, volume.frame, where, cap, volume.unit
        )
        self.path, self.format, self.axis = volume.path, volume.format, volume.axis
        self.labels, self.narrowed = volume.labels, self.narrowed or volume.narrowed

    def _load(self) -> np.ndarray:
        return self._of(self._volume._load())

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        return self._of(self._volume.box(z0, z1, y0, y1, x0, x1))

    def _of(self, voxels: np.ndarray) -> np.ndarray:
        raise NotImplementedError


class TurnedVolume(_Converted):
    """``volume`` with the order of its voxels reversed (``clvol.volume.axis.turned``)."""

    def _of(self, voxels: np.ndarray) -> np.ndarray:
        return turned(voxels, self._dtype)


def narrowed_volume(volume: Volume, how: Narrowing) -> Volume:
    """``volume`` in a type that volumes may have; only lazy volumes can have a wide type."""
    if isinstance(volume, LazyVolume) and volume.dtype.name in WIDE_TYPES:
        return NarrowedVolume(volume, how)
    return volume


class NarrowedVolume(_Converted):
    """``volume`` in the smallest type that holds every value exactly.

    The type is determined when it is first used; all voxels are read once for that, slab by slab.
    """

    narrowed = True

    def __init__(self, volume: LazyVolume, how: Narrowing) -> None:
        super().__init__(volume)
        self._how = how

    @cached_property
    def dtype(self) -> np.dtype:
        nz, ny, nx = self.shape
        depth = max(1, _SLAB // (ny * nx * self._dtype.itemsize))
        boxes = (
            self._volume.box(z, min(z + depth, nz), 0, ny, 0, nx) for z in range(0, nz, depth)
        )
        return exact_type(self._dtype, boxes, self._where, self._how)

    @property
    def nbytes(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize

    def _load(self) -> np.ndarray:
        wide = math.prod(self.shape) * self._dtype.itemsize
        if self._memory_cap is not None:
            check_memory(self._where, wide + self.nbytes, self._memory_cap)
        return super()._load()

    def _of(self, voxels: np.ndarray) -> np.ndarray:
        return cast(voxels, self.dtype, self._how)


class FilledVolume(_Converted):
    """``volume`` with ``value``, a stored number, in place of NaN voxels when they are read."""

    def __init__(self, volume: LazyVolume, value: float) -> None:
        super().__init__(volume)
        self._value = value

    @property
    def stored_range(self) -> tuple[float, float]:
        inner = self._volume
        value = float(self.dtype.type(self._value))
        low, high = inner.stored_range
        if inner.nan_count + inner.inf_count == math.prod(self.shape):  # no voxel is finite
            return value, value
        return min(low, value), max(high, value)

    @property
    def nan_count(self) -> int:
        return 0

    @property
    def inf_count(self) -> int:
        return self._volume.inf_count

    def _of(self, voxels: np.ndarray) -> np.ndarray:
        voxels = np.require(voxels, requirements="W")
        for layer in voxels:
            np.copyto(layer, self._value, where=np.isnan(layer))
        return voxels
