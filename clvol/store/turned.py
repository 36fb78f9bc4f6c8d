"""A store whose voxels are read in reverse order of values, for axes with a negative slope."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from clvol.store.source import BlockStatistics
from clvol.store.zarr_store import StoredBlocks
from clvol.volume.axis import turned
from clvol.volume.grid import Grid


class TurnedBlocks:
    """A ``BlockSource`` with the samples of ``source`` mirrored by ``clvol.volume.axis.turned``.

    All other attributes are those of ``source``, except that there are no codes to be decoded elsewhere, since they are
    of voxels in their own order: ``codebooks`` is None.
    """

    grid: Grid
    codebooks = None

    def __init__(self, source: StoredBlocks | TurnedBlocks) -> None:
        self._source = source

    def __getattr__(self, name: str) -> Any:
        if name == "_source":  # during copying
            raise AttributeError(name)
        return getattr(self._source, name)

    @property
    def value_range(self) -> tuple[float, float]:
        source = self._source
        if source.nan_count + source.inf_count == np.prod(source.blocks.shape, dtype=np.int64):
            return source.value_range  # there is no finite voxel
        low, high = self._of(np.array(source.value_range))
        return float(high), float(low)

    def read(self, level: int, blocks: np.ndarray) -> np.ndarray:
        return self._of(self._source.read(level, blocks))

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        return self._of(self._source.box(z0, z1, y0, y1, x0, x1))

    def volume_level(self, level: int = 0) -> np.ndarray:
        return self._of(self._source.volume_level(level))

    def statistics(self) -> Iterator[BlockStatistics]:
        for part in self._source.statistics():
            yield BlockStatistics(
                first=part.first,
                minimum=self._of(part.maximum),
                maximum=self._of(part.minimum),
                mean=self._of(part.mean),
                quantiles=self._of(part.quantiles)[..., ::-1],
                deviation=part.deviation,
                reach_low=self._of(part.reach_high),
                reach_high=self._of(part.reach_low),
                holes=part.holes,
            )

    def _of(self, samples: np.ndarray) -> np.ndarray:
        return turned(samples, self._source.dtype)
