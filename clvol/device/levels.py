"""Levels of a volume on a device (cl/volume_levels.h): means of its voxels, and what a cell of them can show.

A voxel of a level is the mean of the finite voxels that it stands for, and not a number where fewer than half of them
are finite, as in the levels of a store. Means are those of the unrounded level below, rounded to the voxels' type
(halves to even): they never leave the range of what they stand for.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from clvol.device.host_cells import pair_rows
from clvol.device.volume import DeviceVolume, ResidentVolume
from clvol.errors import VolumeError
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.volume import Volume
from clvol.volume.level_layout import Level, coarser_bytes, levels_of
from clvol.volume.voxel_layout import CELL_SHIFT, FINE_SHIFT, LARGEST_OFFSET, cell_count, device_bytes

_BESIDE = 1e-3  # of a level's lattice units: how far rounding may take a place beyond its cell


def means(data: np.ndarray, levels: tuple[Level, ...]) -> list[np.ndarray]:
    """The arrays of ``levels``, each [z, y, x] in the type of ``data`` [z, y, x]; the first is ``data`` itself."""
    finite = np.isfinite(data) if data.dtype.kind == "f" else None
    share: np.ndarray | None = None  # of what a voxel stands for that is finite
    values = data
    if finite is not None and not finite.all():
        values, share = np.where(finite, data, data.dtype.type(0)), finite.astype(np.float32)
    found = [data]
    for before, level in zip(levels, levels[1:]):
        if level == before:
            found.append(found[-1])
            continue
        for axis, (more, less) in enumerate(zip(level.halvings[::-1], before.halvings[::-1])):
            if more > less:
                values, share = _halved(values, share, axis)
        stored = values if data.dtype.kind == "f" else np.rint(values)
        stored = stored if share is None else np.where(share < 0.5, np.nan, stored)
        found.append(np.ascontiguousarray(stored, data.dtype))
    return found


def _halved(values: np.ndarray, share: np.ndarray | None, axis: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Means of pairs along ``axis``, weighed by ``share``, and the means of these; the last of an odd number is one of
    both. Sums do not overflow, and means lie between what they are of."""
    wide = np.float32 if values.dtype.itemsize < 4 else np.float64
    first, second = _pairs(values, axis)
    if share is None:
        return np.multiply(first, 0.5, dtype=wide) + np.multiply(second, 0.5, dtype=wide), None
    one, other = _pairs(share, axis)
    both = one + other
    weight = np.divide(one, both, out=np.zeros(one.shape, wide), where=both > 0)
    mean = weight * first + np.where(both > 0, 1.0 - weight, 0.0) * second
    low = np.minimum(np.where(one > 0, first, np.inf), np.where(other > 0, second, np.inf))
    high = np.maximum(np.where(one > 0, first, -np.inf), np.where(other > 0, second, -np.inf))
    return np.where(both > 0, np.clip(mean, low, high), 0.0), 0.5 * both


def _pairs(array: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """The first and the second voxels of the pairs along ``axis``; the last one is alone, or a pair's first."""
    along = np.moveaxis(array, axis, 0)
    first, second = along[::2], along[1::2]
    if len(first) > len(second):
        second = np.concatenate([second, first[-1:]])
    return np.moveaxis(first, 0, axis), np.moveaxis(second, 0, axis)


class LevelledVolume(DeviceVolume):
    """A volume and its levels in one buffer. VolumeError where they do not fit on the device."""

    def __init__(self, context: DeviceContext, volume: Volume) -> None:
        self.levels = levels_of(volume)
        self._check_levels(context, volume)
        super().__init__(context, volume)

    def _check_levels(self, context: DeviceContext, volume: Volume) -> None:
        needed = device_bytes(volume) + coarser_bytes(volume)
        where, last = volume.name or "volume", self.levels[-1]
        what = f"{volume.grid.size} voxels of {volume.dtype} and their levels need {needed} bytes on {context.name}"
        most = min(int(context.device.max_mem_alloc_size), int(context.device.global_mem_size))
        if needed > most:
            raise VolumeError(where, what, f"at most {most} bytes, or integration.minification = 'off'")
        if last.first + last.elements > LARGEST_OFFSET:
            what = f"{last.first + last.elements} voxels with their levels"
            raise VolumeError(where, what, f"at most {LARGEST_OFFSET}, or integration.minification = 'off'")

    def _stored(self, context: DeviceContext, data: np.ndarray, kept: DeviceArray | None) -> DeviceArray:
        self.arrays = means(data, self.levels)
        last = self.levels[-1]
        elements, fill = last.first + last.elements, partial(_fill, self.arrays, self.levels)
        if self._has_pairs:
            return context.resident(np.uint8, (elements + 4, 2), partial(_fill_pairs, self.arrays, self.levels))
        # 32-bit loads of the last bytes must stay inside the buffer.
        return context.resident(data.dtype, (elements + 4 // data.dtype.itemsize,), fill)

    def bounds_of_level(self, level: int, shift: int) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest finite value, [z, y, x], that samples of ``level`` read in each cell of 2^``shift``
        lattice units, in the values that kernels compute with; inf and -inf where none is finite."""
        return self.keep(("level", level, shift), lambda: self._bounds_of_level(level, shift))

    def _bounds_of_level(self, level: int, shift: int) -> tuple[np.ndarray, np.ndarray]:
        data = self.arrays[level]
        low = high = data
        if data.dtype.kind == "f":
            finite = np.isfinite(data)
            low, high = np.where(finite, data, np.inf), np.where(finite, data, -np.inf)
        shape = zip(self.levels[level].halvings[::-1], self.size[::-1], data.shape)
        for axis, (halvings, fine, n) in enumerate(shape):
            first, last = _points_of_cells(halvings, fine, n, shift)
            low = _extremes(low, axis, first, last, np.minimum)
            high = _extremes(high, axis, first, last, np.maximum)
        some = low <= high
        with np.errstate(over="ignore", invalid="ignore"):
            low, high = self.values(low), self.values(high)
        return np.where(some, low, np.inf), np.where(some, high, -np.inf)


def _points_of_cells(halvings: int, fine: int, n: int, shift: int) -> tuple[np.ndarray, np.ndarray]:
    """int [cells]: the first and the last of ``n`` lattice points of a level that samples in each cell of 2^``shift``
    of ``fine`` lattice points read along an axis."""
    cells = np.arange(cell_count(fine, shift))
    ends = cells << shift, np.minimum((cells + 1) << shift, fine - 1)
    scale, beside = 0.5**halvings, _BESIDE if halvings else 0.0
    low, high = (np.clip((x + 0.5) * scale - 0.5, 0.0, n - 1.0) for x in ends)
    first = np.clip(np.floor(low - beside), 0, n - 2).astype(np.int64)
    return first, np.clip(np.ceil(high + beside), 1, n - 1).astype(np.int64)


def _extremes(array: np.ndarray, axis: int, first: np.ndarray, last: np.ndarray, over: np.ufunc) -> np.ndarray:
    found = array.take(first, axis=axis)
    for k in range(1, int((last - first).max()) + 1):
        over(found, array.take(np.minimum(first + k, last), axis=axis), out=found)
    return found


class SeenLevels(ResidentVolume):
    """A volume as pictures see it that use its levels from ``first`` to ``last``: its cells can show what these can."""

    has_fine_bounds = True

    def __init__(self, volume: LevelledVolume, first: int, last: int) -> None:
        self.whole, self.first, self.last = volume, first, last
        self.voxels, self.values, self.switches = volume.voxels, volume.values, volume.switches
        self.size, self.stride = volume.size, volume.stride
        self.cells, self.cell_shift = volume.cells, volume.cell_shift
        self.levels = volume.levels

    @property
    def value_range(self) -> tuple[float, float]:
        return self.whole.value_range

    def plain(self) -> DeviceArray:
        return self.whole.plain()

    def bounds(self, apron: int) -> tuple[np.ndarray, np.ndarray]:
        """As in ``ResidentVolume``, of all that a blend of the levels can be; there is no apron but the filter's."""
        return self._marked(*self._joined(CELL_SHIFT))

    def fine_bounds(self, apron: int, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As in ``ResidentVolume``."""
        low, high = self._joined(FINE_SHIFT)
        return self._marked(low[wanted], high[wanted])

    def _joined(self, shift: int) -> tuple[np.ndarray, np.ndarray]:
        low, high = self.whole.bounds_of_level(self.first, shift)
        for level in range(self.first + 1, self.last + 1):
            more = self.whole.bounds_of_level(level, shift)
            low, high = np.minimum(low, more[0]), np.maximum(high, more[1])
        return low, high

    @staticmethod
    def _marked(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        some = low <= high
        return np.where(some, low, 1.0), np.where(some, high, 0.0)


def _fill(arrays: list[np.ndarray], levels: tuple[Level, ...], out: np.ndarray) -> None:
    out[levels[-1].first + levels[-1].elements :] = 0
    for array, level in zip(arrays, levels):
        out[level.first : level.first + level.elements] = array.ravel()


def _fill_pairs(arrays: list[np.ndarray], levels: tuple[Level, ...], out: np.ndarray) -> None:
    out[levels[-1].first + levels[-1].elements :] = 0
    for array, level in zip(arrays, levels):
        pair_rows(array, out[level.first : level.first + level.elements])
