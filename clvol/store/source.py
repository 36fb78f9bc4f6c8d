"""What blocks are read from: a store on disk, or a volume in memory, behind one interface."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from clvol.store.geometry import BlockGrid
from clvol.volume.grid import Grid

QUANTILES = 8
DROPPED = 255  # in place of a level: a block that shows nothing, and takes no memory


@dataclass(frozen=True, eq=False)
class BlockStatistics:
    """Of the blocks ``first`` ... ``first + n - 1``; arrays [levels, n] are of each level's samples.

    minimum, maximum, mean   [levels, n] float64: of the finite samples; NaN where none is
    quantiles                [levels, n, QUANTILES] float32 (float64 for float64 voxels): the simplified histogram:
                             finite samples in order, in as many groups of equal size, each group's mean
    deviation                [levels, n] float64: root mean square, over the block's voxels, of the level's
                             piecewise constant field minus the voxels; 0 at level 0
    reach_low, reach_high    [n] float64: smallest and largest finite voxel of the block and of one voxel around
                             it (what interpolation inside the block's space can use); low > high where none is
    holes                    [n] bool: whether a voxel of those is not finite
    """

    first: int
    minimum: np.ndarray
    maximum: np.ndarray
    mean: np.ndarray
    quantiles: np.ndarray
    deviation: np.ndarray
    reach_low: np.ndarray
    reach_high: np.ndarray
    holes: np.ndarray


class BlockSource(Protocol):
    """``grid``: the volume's. ``dtype``: of voxels and of samples at all levels. ``value_range``, ``nan_count``,
    ``inf_count``: of the volume's voxels. ``name``: for messages."""

    name: str
    grid: Grid
    blocks: BlockGrid
    dtype: np.dtype
    value_range: tuple[float, float]
    nan_count: int
    inf_count: int

    def read(self, level: int, blocks: np.ndarray) -> np.ndarray:
        """Samples [k, s, s, s] (z, y, x) of ``blocks`` (numbers, int64 [k]) at ``level``; beyond the volume its last
        samples repeat. May be called by several threads. VolumeError names the block that cannot be read."""
        ...

    def statistics(self) -> Iterator[BlockStatistics]:
        """All blocks' statistics, in order, in parts of bounded size."""
        ...
