"""The arithmetic of blocks: their numbers, positions and resolutions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

EDGE = 16
EDGES = (4, 8, 16, 32)


@dataclass(frozen=True)
class BlockGrid:
    """Blocks of ``edge``^3 voxels over an array of ``shape`` (nz, ny, nx).

    Block (bz, by, bx) holds the voxels edge * b ... edge * b + edge - 1 along each axis; the last blocks may reach
    beyond the array. Blocks are numbered in C order of (bz, by, bx). Level 0 is full resolution; level l has
    ``samples(l)`` = edge / 2^l samples per axis, and the last level has one. Sample i along an axis of a block at
    level l is the mean of the voxels 2^l i ... 2^l (i + 1) - 1 that are inside the array (in stores of the codec
    "labels": the most frequent label).
    """

    shape: tuple[int, int, int]
    edge: int = EDGE

    @cached_property
    def counts(self) -> tuple[int, int, int]:
        """Number of blocks along (z, y, x)."""
        nz, ny, nx = (-(-n // self.edge) for n in self.shape)
        return nz, ny, nx

    @property
    def count(self) -> int:
        """Total number of blocks."""
        z, y, x = self.counts
        return z * y * x

    @property
    def levels(self) -> int:
        """Number of resolutions: log2(edge) + 1."""
        return self.edge.bit_length()

    def samples(self, level: int) -> int:
        """Samples per axis of a block."""
        return self.edge >> level

    def level_shape(self, level: int) -> tuple[int, int, int]:
        """Samples (z, y, x) of the whole volume at ``level``; blocks at the upper faces may be cut short."""
        nz, ny, nx = (-(-n // (1 << level)) for n in self.shape)
        return nz, ny, nx

    def places(self, blocks: np.ndarray) -> np.ndarray:
        """(bz, by, bx) of blocks by number, int64 [k, 3]."""
        return np.stack(np.unravel_index(np.asarray(blocks, np.int64), self.counts), axis=-1)
