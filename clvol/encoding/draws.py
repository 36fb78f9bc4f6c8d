"""Draws from a source in bounded memory, and of rows by weight: the same ones for the same seed on every machine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clvol.store.geometry import EDGE
from clvol.store.voxel_source import VoxelSource

_REGION = 2 * EDGE  # voxels per axis of the regions that are drawn
_AT_ONCE = 64  # regions


def scrambled(numbers: np.ndarray, seed: int) -> np.ndarray:
    """uint64 of the shape of ``numbers``: pseudo-random bits of each (splitmix64, Steele, Lea and Flood 2014)."""
    with np.errstate(over="ignore"):
        z = np.asarray(numbers, np.uint64) + np.uint64((seed * 2 + 1) * 0x9E3779B97F4A7C15 % 2**64)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return z ^ (z >> np.uint64(31))


def drawn(places: np.ndarray, count: int, seed: int) -> np.ndarray:
    """About ``count`` of ``places`` (ascending), evenly: one of every few; all of them if there are no more."""
    if len(places) <= count:
        return places
    stride = -(-len(places) // count)
    first = np.arange(0, len(places), stride)
    jitter = (scrambled(first, seed) % np.uint64(stride)).astype(np.int64)
    return places[np.minimum(first + jitter, len(places) - 1)]


@dataclass(frozen=True, eq=False)
class DrawnBlocks:
    """Blocks [k, EDGE, EDGE, EDGE] of level 0, padded by repetition. ``inside`` int64 [k, 3]: how many voxels of each
    are the volume's own along z, y and x."""

    voxels: np.ndarray
    inside: np.ndarray

    @property
    def own(self) -> np.ndarray | None:
        """bool [k, EDGE, EDGE, EDGE]: the volume's own voxels; None if all are."""
        if (self.inside == EDGE).all():
            return None
        axis = np.arange(EDGE) < self.inside[:, :, None]
        return axis[:, 0, :, None, None] & axis[:, 1, None, :, None] & axis[:, 2, None, None, :]


def drawn_blocks(source: VoxelSource, most: int, seed: int, dtype: np.dtype) -> Iterator[DrawnBlocks]:
    """Blocks of a ``source`` as ``dtype``: all of them if they have no more than ``most`` voxels together, else those
    of about as many voxels in regions spread evenly over it."""
    counts = tuple(-(-n // _REGION) for n in source.shape)
    regions = np.arange(int(np.prod(counts, dtype=np.int64)))
    if int(np.prod(source.shape, dtype=np.int64)) > most:
        regions = drawn(regions, max(1, most // _REGION**3), seed)
    for first in range(0, len(regions), _AT_ONCE):
        places = np.stack(np.unravel_index(regions[first : first + _AT_ONCE], counts), axis=1) * _REGION
        parts = [_region(source, place) for place in places]
        voxels = np.concatenate([part.voxels for part in parts])
        with np.errstate(over="ignore"):  # float64 beyond float32 becomes infinite
            yield DrawnBlocks(voxels.astype(dtype, copy=False), np.concatenate([part.inside for part in parts]))


def _region(source: VoxelSource, place: np.ndarray) -> DrawnBlocks:
    start = [int(p) for p in place]
    end = [min(s + _REGION, n) for s, n in zip(start, source.shape)]
    voxels = source.box(start[0], end[0], start[1], end[1], start[2], end[2])
    padded = np.pad(voxels, [(0, -n % EDGE) for n in voxels.shape], mode="edge")
    z, y, x = (n // EDGE for n in padded.shape)
    blocks = padded.reshape(z, EDGE, y, EDGE, x, EDGE).transpose(0, 2, 4, 1, 3, 5).reshape(-1, EDGE, EDGE, EDGE)
    corners = np.stack(np.unravel_index(np.arange(len(blocks)), (z, y, x)), axis=1) * EDGE
    return DrawnBlocks(blocks, np.minimum(np.array(voxels.shape) - corners, EDGE))
