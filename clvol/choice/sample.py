"""A regular sample of a volume, small enough to be analysed in a second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.volume.grid import Grid
from clvol.volume.volume import Volume

MOST_SAMPLES = 2_500_000


@dataclass(frozen=True, eq=False)
class Sample:
    """Voxels of a volume on a coarser lattice, in values.

    ``values``: float64 [z, y, x], NaN where a voxel is not finite. Sample [k, j, i] is the voxel at the continuous
    index ``first + step * (i, j, k)``, in the order (x, y, z). ``grid``: that of the volume.
    """

    values: np.ndarray
    first: np.ndarray
    step: np.ndarray
    grid: Grid
    is_integer: bool

    @property
    def spacing(self) -> np.ndarray:
        """World distance between samples along (x, y, z)."""
        return self.step * np.asarray(self.grid.spacing)

    def world(self, zyx: np.ndarray) -> np.ndarray:
        """World positions [n, 3] of the samples at the indices ``zyx`` [n, 3]."""
        index = self.first + self.step * np.asarray(zyx, np.float64)[:, ::-1]
        matrix = self.grid.index_to_world()
        return index @ matrix[:3, :3].T + matrix[:3, 3]


def sample_of(volume: Volume, most: int = MOST_SAMPLES) -> Sample:
    """At most about ``most`` voxels of ``volume``: every n-th along each axis, or the level of a store that is coarse
    enough. Of a store only that level is read."""
    source = getattr(volume, "blocks_source", None)
    if source is not None and "data" not in vars(volume):
        return _level_of(volume, source, most)
    step = _steps(volume.shape, volume.grid.spacing[::-1], most)
    start = [(n - 1) % s // 2 for n, s in zip(volume.shape, step)]
    stored = volume.data[tuple(slice(a, None, s) for a, s in zip(start, step))]
    return _sample(volume, stored, np.array(start[::-1], float), np.array(step[::-1], float))


def _steps(shape: tuple[int, ...], spacing: tuple[float, ...], most: int) -> list[int]:
    """Whole steps [z, y, x] that leave at most ``most`` samples, about evenly spaced in the world."""
    step = [1, 1, 1]
    while np.prod([-(-n // s) for n, s in zip(shape, step)]) > most:
        coarse = [s * length if n > s else np.inf for n, s, length in zip(shape, step, spacing)]
        step[int(np.argmin(coarse))] += 1
    return step


def _level_of(volume: Volume, source, most: int) -> Sample:
    levels = source.blocks.levels
    level = next((k for k in range(levels) if np.prod([-(-n >> k) for n in volume.shape]) <= most), levels - 1)
    stored = source.volume_level(level)
    scale = float(2**level)
    return _sample(volume, stored, np.full(3, 0.5 * (scale - 1.0)), np.full(3, scale))


def _sample(volume: Volume, stored: np.ndarray, first: np.ndarray, step: np.ndarray) -> Sample:
    values = np.asarray(volume.axis.values(stored.astype(np.float64)))
    values[~np.isfinite(values)] = np.nan
    return Sample(values, first, step, volume.grid, stored.dtype.kind in "iu")
