"""The histogram of a volume's values."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.choice.sample import sample_of
from clvol.volume.volume import Volume

_SLAB = 1 << 22  # voxels that are counted together


@dataclass(frozen=True, eq=False)
class Histogram:
    """``counts`` [n] of finite voxels whose value lies from ``edges`` [n + 1] to the next; the last bin has both ends.

    ``voxels``: those that were examined, of ``all_voxels``; fewer of a store, of which a coarse level is read.
    """

    edges: np.ndarray
    counts: np.ndarray
    voxels: int
    all_voxels: int

    def to_json(self) -> dict[str, Any]:
        return {
            "edges": self.edges.tolist(), "counts": self.counts.tolist(), "voxels": self.voxels,
            "all_voxels": self.all_voxels,
        }  # fmt: skip


def histogram_of(volume: Volume, bins: int = 24) -> Histogram:
    """The histogram of ``volume`` over its whole range, in at most ``bins`` bins of equal width. Bins of integers hold
    the same number of integers each, so that none is empty because of its width alone."""
    low, high = volume.value_range
    edges = _edges(volume, low, high, bins)
    counts = np.zeros(edges.size - 1, np.int64)
    examined = 0
    for values in _parts(volume):
        examined += values.size
        counts += np.histogram(values[np.isfinite(values)], edges)[0]
    return Histogram(edges, counts, examined, math.prod(volume.shape))


def _parts(volume: Volume) -> Iterator[np.ndarray]:
    """The values, slab by slab; of a store those of a coarse level."""
    if "data" not in vars(volume) and getattr(volume, "blocks_source", None) is not None:
        yield sample_of(volume).values
        return
    depth = max(1, _SLAB // max(1, math.prod(volume.shape[1:])))
    for z in range(0, volume.shape[0], depth):
        yield volume.axis.values(volume.data[z : z + depth].astype(np.float64))


def _edges(volume: Volume, low: float, high: float, bins: int) -> np.ndarray:
    if not low < high:
        return np.array([low - 0.5, low + 0.5])
    if volume.dtype.kind in "iu":
        step = abs(volume.slope)
        levels = round((high - low) / step) + 1
        width = math.ceil(levels / bins)
        count = math.ceil(levels / width)
        return low + step * (width * np.arange(count + 1) - 0.5)
    return np.linspace(low, high, bins + 1)
