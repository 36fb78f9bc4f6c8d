"""A volume in memory as blocks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clvol.store.geometry import EDGE, BlockGrid
from clvol.store.resolutions import array_statistics, block_samples
from clvol.store.source import BlockStatistics
from clvol.volume.volume import Volume


class VolumeBlocks:
    """A ``clvol.store.source.BlockSource`` of a volume in memory. Only its statistics are stored."""

    def __init__(self, volume: Volume, edge: int = EDGE) -> None:
        self.volume = volume
        self.name = volume.name or "volume"
        self.grid, self.dtype = volume.grid, volume.dtype
        self.blocks = BlockGrid(volume.shape, edge)
        self.value_range = volume.value_range
        self.nan_count, self.inf_count = volume.nan_count, volume.inf_count

    def read(self, level: int, blocks: np.ndarray) -> np.ndarray:
        return block_samples(self.volume.data, self.blocks, level, blocks)

    def statistics(self) -> Iterator[BlockStatistics]:
        yield from array_statistics(self.volume.data, self.blocks)
