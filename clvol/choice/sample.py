"""A regular sample of a volume, small enough to be analysed in a second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.errors import VolumeError
from clvol.store.source import BlockSource
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
    if "data" not in vars(volume):
        inner = getattr(volume, "_volume", None)  # of a store whose voxels are converted when they are read
        source = getattr(volume if inner is None else inner, "blocks_source", None)
        if source is not None:
            stored, scale = _coarse_level(source, most)
            stored = stored if inner is None else volume._of(stored)  # type: ignore[attr-defined]
            return _sample(volume, stored, np.full(3, 0.5 * (scale - 1.0)), np.full(3, scale))
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


def _coarse_level(source: BlockSource, most: int) -> tuple[np.ndarray, float]:
    """The samples [z, y, x] of the finest level with at most ``most`` of them, and the voxels between two of them.

    Where a block of it is damaged, a coarser level: whether a picture needs the block is not decided here.
    """
    grid = source.blocks
    counts = [int(np.prod(grid.level_shape(level))) for level in range(grid.levels)]
    finest = next((level for level, count in enumerate(counts) if count <= most), grid.levels - 1)
    failed: VolumeError | None = None
    for level in range(finest, grid.levels):
        try:
            samples = source.read(level, np.arange(grid.count))
        except VolumeError as error:
            failed = failed or error
            continue
        s = grid.samples(level)
        whole = samples.reshape(*grid.counts, s, s, s).transpose(0, 3, 1, 4, 2, 5)
        nz, ny, nx = grid.level_shape(level)
        joined = whole.reshape(*(n * s for n in grid.counts))[:nz, :ny, :nx]
        return np.ascontiguousarray(joined), float(2**level)
    assert failed is not None
    raise failed


def _sample(volume: Volume, stored: np.ndarray, first: np.ndarray, step: np.ndarray) -> Sample:
    values = np.asarray(volume.axis.values(stored.astype(np.float64)))
    values[~np.isfinite(values)] = np.nan
    return Sample(values, first, step, volume.grid, stored.dtype.kind in "iu")
