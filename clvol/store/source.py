"""The interface from which blocks are read: of a store on disk, or of a volume in memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from clvol.store.geometry import BlockGrid
from clvol.volume.grid import Grid

QUANTILES = 8
DROPPED = 255  # takes the place of a level for a block that is invisible and takes no memory


@dataclass(frozen=True, eq=False)
class BlockStatistics:
    """Statistics of the blocks ``first`` ... ``first + n - 1``; arrays [levels, n] describe the samples of each level.

    minimum, maximum, mean   [levels, n] float64: of the finite samples; NaN if there is none
    quantiles                [levels, n, QUANTILES] float32 (float64 for float64 voxels): the simplified histogram:
                             means of QUANTILES groups of equal size of the sorted finite samples
    deviation                [levels, n] float64: root mean square, over the block's voxels, of the level's
                             piecewise constant field minus the voxels; 0 at level 0
    reach_low, reach_high    [n] float64: smallest and largest finite voxel of the block and of one voxel around
                             it (the range of interpolation inside the block's space); low > high if there is none
    holes                    [n] bool: whether any of these voxels is not finite
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
    """A source of blocks.

    ``grid`` is that of the volume, ``dtype`` the type of voxels and of samples at all levels. ``value_range``,
    ``nan_count`` and ``inf_count`` are those of the volume's voxels. ``name`` is used in messages.
    """

    name: str
    grid: Grid
    blocks: BlockGrid
    dtype: np.dtype
    value_range: tuple[float, float]
    nan_count: int
    inf_count: int

    def read(self, level: int, blocks: np.ndarray) -> np.ndarray:
        """Samples [k, s, s, s] (z, y, x) of ``blocks`` (numbers, int64 [k]) at ``level``; beyond the volume its last
        samples repeat. May be called by several threads. VolumeError names the block that cannot be read.
        """
        ...

    def statistics(self) -> Iterator[BlockStatistics]:
        """The statistics of all blocks, in order, in parts of bounded size."""
        ...
