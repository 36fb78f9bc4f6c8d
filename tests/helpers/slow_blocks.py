"""The plain twin of clvol.store.resolutions: the same definitions, voxel by voxel and slowly.

Coarser samples are means of the voxels themselves (not of already rounded means), rounded to the voxels' type. Where
fewer than half of a sample's voxels are finite the sample is NaN.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clvol.store.geometry import BlockGrid
from clvol.store.source import QUANTILES, BlockStatistics

_PIECE = 1 << 22  # voxels looked at together


def block_samples(data: np.ndarray, grid: BlockGrid, level: int, blocks: np.ndarray) -> np.ndarray:
    """[k, s, s, s] of ``data``'s dtype: samples of ``blocks`` at ``level``, the last ones repeated beyond the array."""
    s = grid.samples(level)
    out = np.empty((len(blocks), s, s, s), data.dtype)
    for k, place in enumerate(grid.places(blocks)):
        out[k] = region_level(data, grid, level, tuple(place), tuple(place + 1))
    return out


def region_level(data: np.ndarray, grid: BlockGrid, level: int, first: tuple, last: tuple) -> np.ndarray:
    """[z, y, x] of the blocks ``first`` <= (bz, by, bx) < ``last`` at ``level``, last samples repeated beyond it."""
    edge = grid.edge
    box = tuple(slice(a * edge, min(b * edge, n)) for a, b, n in zip(first, last, data.shape))
    found = reduced(data[box], level)
    wanted = [(b - a) * grid.samples(level) for a, b in zip(first, last)]
    missing = [(0, n - have) for n, have in zip(wanted, found.shape)]
    return np.pad(found, missing, mode="edge") if any(m for _, m in missing) else found


def reduced(box: np.ndarray, level: int) -> np.ndarray:
    """``box`` at ``level``: means over 2^level voxels along each axis, fewer at the upper faces."""
    if level == 0:
        return box
    values = box.astype(np.float64)
    if box.dtype.kind == "f":
        finite = np.isfinite(box)
        values[~finite] = 0.0
        counts, all_voxels = _sums(finite.astype(np.float64), level), _sums(np.ones(box.shape), level)
    else:
        counts = all_voxels = _sums(np.ones(box.shape), level)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        means = _sums(values, level) / counts
        means[2 * counts < all_voxels] = np.nan
    return means.astype(box.dtype) if box.dtype.kind == "f" else np.rint(means).astype(box.dtype)


def _sums(values: np.ndarray, level: int) -> np.ndarray:
    for axis in range(3):
        places = np.arange(0, values.shape[axis], 1 << level)
        values = np.add.reduceat(values, places, axis=axis)
    return values


def array_statistics(data: np.ndarray, grid: BlockGrid) -> Iterator[BlockStatistics]:
    """All blocks of ``data`` in order, as many rows of blocks at a time as make a piece."""
    nz, ny, nx = grid.counts
    rows = int(np.clip(_PIECE // (grid.edge**3 * nx), 1, ny))
    for z in range(nz):
        for y in range(0, ny, rows):
            first, last = (z, y, 0), (z + 1, min(y + rows, ny), nx)
            yield region_statistics(data, grid, first, last)


def region_statistics(data: np.ndarray, grid: BlockGrid, first: tuple, last: tuple) -> BlockStatistics:
    """Of the blocks ``first`` <= (bz, by, bx) < ``last``, in C order. ``first`` of the result is the number of
    the first; the blocks are consecutive where the caller makes them so."""
    levels = [region_level(data, grid, level, first, last) for level in range(grid.levels)]
    by_block = [_split(level, grid.samples(k)) for k, level in enumerate(levels)]
    summaries = [_summary(samples) for samples in by_block]
    low, high, holes = _reach(data, grid, first, last)
    return BlockStatistics(
        int(np.ravel_multi_index(first, grid.counts)),
        *(np.stack([summary[name] for summary in summaries]) for name in ("minimum", "maximum", "mean")),
        np.stack([summary["quantiles"] for summary in summaries]).astype(
            np.float64 if data.dtype == np.float64 else np.float32
        ),
        np.stack([_deviation(by_block[0], samples, k) for k, samples in enumerate(by_block)]),
        low, high, holes,
    )  # fmt: skip


def _split(box: np.ndarray, s: int) -> np.ndarray:
    """[blocks, s, s, s] of ``box`` [z, y, x]."""
    z, y, x = (n // s for n in box.shape)
    return box.reshape(z, s, y, s, x, s).transpose(0, 2, 4, 1, 3, 5).reshape(-1, s, s, s)


def _summary(samples: np.ndarray) -> dict[str, np.ndarray]:
    flat = np.sort(samples.reshape(len(samples), -1), axis=1)
    n = flat.shape[1]
    if flat.dtype.kind == "f":
        return _summary_with_holes(flat)
    groups = min(QUANTILES, n)
    means = flat.reshape(len(flat), groups, -1).mean(axis=2, dtype=np.float64)
    return {
        "minimum": flat[:, 0].astype(np.float64),
        "maximum": flat[:, -1].astype(np.float64),
        "mean": means.mean(axis=1),
        "quantiles": np.repeat(means, QUANTILES // groups, axis=1),
    }


def _summary_with_holes(flat: np.ndarray) -> dict[str, np.ndarray]:
    """Blocks without holes together, the others one by one."""
    whole = np.isfinite(flat).all(axis=1)
    count = len(flat)
    out = {name: np.full(count, np.nan) for name in ("minimum", "maximum", "mean")}
    out["quantiles"] = np.full((count, QUANTILES), np.nan)
    n = flat.shape[1]
    groups = min(QUANTILES, n)
    values = flat[whole].astype(np.float64)
    if len(values):
        out["minimum"][whole], out["maximum"][whole] = values[:, 0], values[:, -1]
        out["mean"][whole] = _mean(values)
        means = _mean(values.reshape(len(values), groups, -1))
        out["quantiles"][whole] = np.repeat(means, QUANTILES // groups, axis=1)
    for k in np.flatnonzero(~whole):
        values = np.sort(flat[k][np.isfinite(flat[k])].astype(np.float64))
        if not values.size:
            continue
        out["minimum"][k], out["maximum"][k], out["mean"][k] = values[0], values[-1], _mean(values)
        at = (np.arange(QUANTILES) + 0.5) / QUANTILES * values.size - 0.5
        out["quantiles"][k] = np.interp(at, np.arange(values.size), values)
    return out


def _mean(values: np.ndarray) -> np.ndarray:
    """Over the last axis, of values whose sum may overflow."""
    return (values / values.shape[-1]).sum(axis=-1)


def _deviation(full: np.ndarray, samples: np.ndarray, level: int) -> np.ndarray:
    if level == 0:
        return np.zeros(len(full))
    fine = samples.astype(np.float64)
    for axis in (1, 2, 3):
        fine = np.repeat(fine, 1 << level, axis=axis)
    with np.errstate(over="ignore", invalid="ignore"):
        squares = (fine - full.astype(np.float64)) ** 2
        squares = squares.reshape(len(full), -1)
        if full.dtype.kind != "f":
            return np.sqrt(squares.mean(axis=1))
        known = np.isfinite(squares)
        squares[~known] = 0.0
        return np.sqrt(squares.sum(axis=1) / np.maximum(known.sum(axis=1), 1))


def _reach(
    data: np.ndarray, grid: BlockGrid, first: tuple, last: tuple
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """reach_low, reach_high, holes of ``BlockStatistics``."""
    edge = grid.edge
    box = tuple(
        slice(max(a * edge - 1, 0), min(b * edge + 1, n)) for a, b, n in zip(first, last, data.shape)
    )
    voxels = data[box]
    if data.dtype.kind == "f":
        finite = np.isfinite(voxels)
        low = np.where(finite, voxels, np.inf).astype(np.float64)
        high = np.where(finite, voxels, -np.inf).astype(np.float64)
        holes = ~finite
    else:
        low = high = voxels
        holes = np.zeros((1, 1, 1), bool)
    for axis, (a, b, part) in enumerate(zip(first, last, box)):
        n = data.shape[axis]
        spans = [
            (max(k * edge - 1, 0) - part.start, min((k + 1) * edge + 1, n) - part.start)
            for k in range(a, b)
        ]
        low = _over(low, axis, spans, np.minimum)
        high = _over(high, axis, spans, np.maximum)
        if data.dtype.kind == "f":
            holes = _over(holes, axis, spans, np.logical_or)
    holes = np.broadcast_to(holes, low.shape)
    return low.ravel().astype(np.float64), high.ravel().astype(np.float64), holes.ravel().copy()


def _over(values: np.ndarray, axis: int, spans: list, over: np.ufunc) -> np.ndarray:
    moved = np.moveaxis(values, axis, 0)
    found = np.stack([over.reduce(moved[a:b], axis=0) for a, b in spans])
    return np.moveaxis(found, 0, axis)
