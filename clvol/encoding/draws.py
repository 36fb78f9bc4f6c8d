"""Draws from a source in bounded memory, and of rows by weight: the same ones for the same seed on every machine."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clvol.store.voxel_source import VoxelSource

MOST_VOXELS = 1 << 27  # volumes of up to as many are drawn over everything
_EDGE = 32  # of the blocks that are drawn


def scrambled(numbers: np.ndarray, seed: int) -> np.ndarray:
    """uint64 of the shape of ``numbers``: pseudo-random bits of each (splitmix64, Steele, Lea and Flood 2014)."""
    with np.errstate(over="ignore"):
        z = np.asarray(numbers, np.uint64) + np.uint64((seed * 2 + 1) * 0x9E3779B97F4A7C15 % 2**64)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return z ^ (z >> np.uint64(31))


def drawn_by_weight(weights: np.ndarray, count: int, seed: int) -> np.ndarray:
    """int64 [count]: places in ``weights`` (integers >= 0), ascending, each as often as its share of their sum says, to
    within one; empty if all weights are 0."""
    ends = np.cumsum(weights.astype(np.uint64), dtype=np.uint64)
    total = int(ends[-1]) if len(ends) else 0
    if not total:
        return np.empty(0, np.int64)
    offset = int(scrambled(np.array([count]), seed)[0] % np.uint64(total))
    ticks = [(offset + i * total // count) % total for i in range(count)]
    return np.sort(np.searchsorted(ends, np.array(ticks, np.uint64), side="right"))


def drawn_blocks(source: VoxelSource, most: int, seed: int) -> Iterator[tuple[np.ndarray, int]]:
    """Blocks [k, 32, 32, 32] (int k <= 128) of a ``source``, padded by repetition, with the number of blocks that each
    stands for. All of them, or about ``most`` voxels' worth: one of every few blocks in z-order of rows."""
    counts = tuple(-(-n // _EDGE) for n in source.shape)
    number = int(np.prod(counts, dtype=np.int64))
    stride = max(1, -(-number * _EDGE**3 // most)) if np.prod(source.shape, dtype=np.int64) > most else 1
    chosen = np.arange(0, number, stride)
    if stride > 1:  # one of each `stride` neighbours
        chosen = np.minimum(chosen + (scrambled(chosen, seed) % np.uint64(stride)).astype(np.int64), number - 1)
    for first in range(0, len(chosen), 128):
        places = np.stack(np.unravel_index(chosen[first : first + 128], counts), axis=1)
        yield np.stack([padded_box(source, place) for place in places]), stride


def padded_box(source: VoxelSource, place: np.ndarray) -> np.ndarray:
    """Block ``place`` (z, y, x) of 32^3 voxels."""
    start = [int(p) * _EDGE for p in place]
    end = [min(s + _EDGE, n) for s, n in zip(start, source.shape)]
    voxels = source.box(start[0], end[0], start[1], end[1], start[2], end[2])
    return np.pad(voxels, [(0, _EDGE - n) for n in voxels.shape], mode="edge")
