"""Coarser resolutions of an array, and statistics of its blocks, piece by piece.

Coarser samples are means of the voxels themselves (not of rounded means), rounded to the voxels' type, halves to
even. A sample is NaN if fewer than half of its voxels are finite. Sums of integers are exact; the sums of a level are
computed from those of the level before.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from clvol.store.geometry import BlockGrid
from clvol.store.source import QUANTILES, BlockStatistics

_PIECE = 1 << 22  # voxels that array_statistics examines together
_CACHED = 1 << 20  # voxels that describe_region examines together, so that temporaries stay in the cache
_LARGE = 1e150  # squares of larger values overflow


def block_samples(data: np.ndarray, grid: BlockGrid, level: int, blocks: np.ndarray) -> np.ndarray:
    """The samples of ``blocks`` at ``level``, [k, s, s, s] of ``data``'s dtype; the last ones repeat beyond the
    array.
    """
    s = grid.samples(level)
    out = np.empty((len(blocks), s, s, s), data.dtype)
    for k, place in enumerate(grid.places(blocks)):
        out[k] = region_level(data, grid, level, tuple(place), tuple(place + 1))
    return out


def region_level(
    data: np.ndarray, grid: BlockGrid, level: int, first: tuple, last: tuple
) -> np.ndarray:
    """The samples [z, y, x] of the blocks ``first`` <= (bz, by, bx) < ``last`` at ``level``; the last ones repeat
    beyond the array.
    """
    box = _box(data.shape, grid.edge, first, last)
    return whole_blocks(reduced(data[box], level), grid.samples(level))


def reduced(box: np.ndarray, level: int) -> np.ndarray:
    """``box`` at ``level``: means over 2^level voxels along each axis, fewer at the upper faces."""
    return resolutions(box, level + 1)[level]


def whole_blocks(samples: np.ndarray, s: int) -> np.ndarray:
    """``samples`` [z, y, x] with the last ones repeated until every axis is a multiple of ``s``."""
    missing = [(0, -n % s) for n in samples.shape]
    return np.pad(samples, missing, mode="edge") if any(m for _, m in missing) else samples


# ---- levels --------------------------------------------------------------------------------------


def resolutions(box: np.ndarray, levels: int) -> list[np.ndarray]:
    """``box`` [z, y, x] at levels 0 ... ``levels`` - 1; level 0 is ``box`` itself. Sample i along an axis is the mean
    of the voxels 2^l i ... 2^l (i + 1) - 1 inside the box.
    """
    found = [box]
    if levels == 1:
        return found
    cut_short = any(n % (1 << levels - 1) for n in box.shape)
    if box.dtype.kind == "f":
        return found + _means_of_floats(box, levels, cut_short)
    for level, sums in enumerate(_sums(_filled_up(box, levels, 0), levels), 1):
        if cut_short:
            shape, counts = _counts(box.shape, level)
            sums = sums[tuple(map(slice, shape))]
            found.append(np.rint(sums / counts).astype(box.dtype))
        else:  # sum / 2^shift, halves to even
            shift = 3 * level
            odd = (sums >> shift) & 1
            found.append(((sums + odd + ((1 << shift - 1) - 1)) >> shift).astype(box.dtype))
    return found


def majorities(box: np.ndarray, levels: int) -> list[np.ndarray]:
    """As ``resolutions`` for labels: a sample is the label that most of its voxels have, the one with the smallest bits
    of several.
    """
    bits = box.view(f"u{box.dtype.itemsize}")
    distinct, numbers = np.unique(bits, return_inverse=True) if bits.dtype.itemsize > 2 else (None, bits)
    outside = 1 << 16 if distinct is None else len(distinct)  # beyond the array
    padded = _filled_up(numbers.reshape(box.shape).astype(np.int32), levels, outside)
    found = [box]
    for level in range(1, levels):
        edge = 1 << level
        shape = tuple(-(-n // edge) for n in box.shape)
        whole = tuple(slice(0, n * edge) for n in shape)
        cells = split(padded[whole], edge).reshape(-1, edge**3)
        common = cells[:, 0].copy()
        mixed = np.flatnonzero((cells != cells[:, :1]).any(axis=1))
        for rows in np.array_split(mixed, max(len(mixed) * edge**3 // _CACHED, 1)):
            common[rows] = _most_frequent(cells[rows], outside)
        labels = common.astype(bits.dtype) if distinct is None else distinct[common]
        found.append(labels.view(box.dtype).reshape(shape))
    return found


def _most_frequent(rows: np.ndarray, outside: int) -> np.ndarray:
    """The most frequent number of each row [k, n], the smallest of several; ``outside`` counts as none."""
    ordered = np.sort(rows, axis=1)
    place = np.arange(rows.shape[1])
    begins = np.ones(ordered.shape, bool)
    begins[:, 1:] = ordered[:, 1:] != ordered[:, :-1]
    length = place - np.maximum.accumulate(np.where(begins, place, 0), axis=1)
    length[ordered == outside] = -1
    return np.take_along_axis(ordered, length.argmax(axis=1)[:, None], axis=1)[:, 0]


def _means_of_floats(box: np.ndarray, levels: int, cut_short: bool) -> list[np.ndarray]:
    finite = np.isfinite(box)
    holes = not finite.all()
    values = np.where(finite, box, 0.0) if holes else box
    found = []
    scale = 1.0
    if box.dtype.itemsize == 8 and np.abs(values).max() > 1e290:
        scale = 2.0**-32  # the sum of a block's voxels might overflow
        values = values * scale
    known = _sums(_filled_up(finite.astype(np.uint8), levels, 0), levels) if holes else None
    for level, sums in enumerate(_sums(_filled_up(values, levels, 0.0), levels), 1):
        shape, counts = _counts(box.shape, level) if cut_short else (sums.shape, float(8**level))
        here = tuple(map(slice, shape))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if known is None:
                means = sums[here] / counts / scale
            else:
                some = next(known)[here]
                means = sums[here] / some / scale
                means[2 * some < counts] = np.nan
            found.append(means.astype(box.dtype))
    return found


def _filled_up(box: np.ndarray, levels: int, value: float) -> np.ndarray:
    """``box`` padded with ``value`` until the coarsest level has whole samples."""
    missing = [(0, -n % (1 << levels - 1)) for n in box.shape]
    return np.pad(box, missing, constant_values=value) if any(m for _, m in missing) else box


def _sums(box: np.ndarray, levels: int) -> Iterator[np.ndarray]:
    """Sums over 2^l voxels per axis at levels 1 ... ``levels`` - 1. They are exact if the box holds integers of at
    most 16 bits and a sample of the coarsest level has at most 32 voxels per axis.
    """
    eight_bits = box.dtype.itemsize == 1
    for level in range(1, levels):
        kind = (
            np.float64
            if box.dtype.kind == "f"
            else np.int16
            if eight_bits and level < 3
            else np.int32
        )
        box = np.add(box[::2], box[1::2], dtype=kind)
        box = box[:, ::2] + box[:, 1::2]
        box = box[:, :, ::2] + box[:, :, 1::2]
        yield box


def _counts(shape: tuple, level: int) -> tuple[tuple, np.ndarray]:
    """The number of samples (z, y, x) of an array of ``shape`` at ``level``, and the number of voxels in each."""
    edge = 1 << level
    along = [np.minimum(n - np.arange(0, n, edge), edge).astype(np.float64) for n in shape]
    z, y, x = along
    return tuple(map(len, along)), z[:, None, None] * y[:, None] * x


# ---- statistics ----------------------------------------------------------------------------------


def array_statistics(data: np.ndarray, grid: BlockGrid) -> Iterator[BlockStatistics]:
    """The statistics of all blocks of ``data`` in order, with as many rows of blocks at a time as fit a piece."""
    nz, ny, nx = grid.counts
    rows = int(np.clip(_PIECE // (grid.edge**3 * nx), 1, ny))
    for z in range(nz):
        for y in range(0, ny, rows):
            first, last = (z, y, 0), (z + 1, min(y + rows, ny), nx)
            yield region_statistics(data, grid, first, last)


def region_statistics(
    data: np.ndarray, grid: BlockGrid, first: tuple, last: tuple
) -> BlockStatistics:
    """The statistics of the blocks ``first`` <= (bz, by, bx) < ``last``, in C order. ``first`` of the result is the
    number of the first block; the caller chooses blocks with consecutive numbers.
    """
    box = _box(data.shape, grid.edge, first, last)
    around, inner = with_neighbours(data.shape, box)
    found = describe_region(data[around], inner, grid.edge)[1]
    return replace(found, first=int(np.ravel_multi_index(first, grid.counts)))


def with_neighbours(shape: tuple, box: tuple) -> tuple[tuple, tuple]:
    """The slices ``box`` of an array of ``shape`` extended by one voxel where there is one, and the position of
    ``box`` inside them.
    """
    around = tuple(slice(max(s.start - 1, 0), min(s.stop + 1, n)) for s, n in zip(box, shape))
    inner = tuple(slice(s.start - a.start, s.stop - a.start) for s, a in zip(box, around))
    return around, inner


def describe_region(
    around: np.ndarray,
    inner: tuple[slice, slice, slice],
    edge: int,
    given: list[np.ndarray] | None = None,
) -> tuple[list[np.ndarray], BlockStatistics]:
    """The region ``around[inner]`` at all levels, and the statistics of its blocks in C order
    (their ``first`` is 0).

    The region starts where a block does, and ends where one does or the array ends. ``around``
    holds one voxel more on each side, where the array has one. ``given``: the region at all levels, if they are not
    means of these voxels.
    """
    start, stop = inner[0].start, inner[0].stop
    plane = max((inner[1].stop - inner[1].start) * (inner[2].stop - inner[2].start), 1)
    depth = max(_CACHED // (plane * edge), 1) * edge
    levels, statistics = [], []
    for z in range(start, stop, depth):
        end = min(z + depth, stop)
        low, high = max(z - 1, 0), min(end + 1, len(around))
        piece = around[low:high]
        within = (slice(z - low, end - low), *inner[1:])
        own = None if given is None else [
            samples[z - start >> k : -(-(end - start) // (1 << k))] for k, samples in enumerate(given)
        ]
        made, found = _describe(piece, within, edge, own)
        levels.append(made)
        statistics.append(found)
    if len(levels) == 1:
        return levels[0], statistics[0]
    joined = [np.concatenate(parts) for parts in zip(*(made[1:] for made in levels))]
    return [around[inner], *joined], join_statistics(statistics)


def join_statistics(parts: list[BlockStatistics]) -> BlockStatistics:
    """The statistics ``parts`` of consecutive blocks, joined."""
    names = [field.name for field in fields(BlockStatistics)][1:]
    axis = {"reach_low": 0, "reach_high": 0, "holes": 0}
    joined = (
        np.concatenate([getattr(p, name) for p in parts], axis.get(name, 1)) for name in names
    )
    return BlockStatistics(parts[0].first, *joined)


def finite_range(voxels: np.ndarray) -> tuple[float, float]:
    """The smallest and largest finite voxel; inf, -inf if there is none."""
    with np.errstate(invalid="ignore"):
        low, high = float(voxels.min()), float(voxels.max())
    if math.isfinite(low) and math.isfinite(high):
        return low, high
    finite = voxels[np.isfinite(voxels)]
    return float(finite.min(initial=np.inf)), float(finite.max(initial=-np.inf))


def extended_reach(region: np.ndarray, edge: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a region adds to the reach of its blocks and of those around it: smallest and largest finite voxel of the
    region (inf, -inf if there is none) and whether there are other voxels, within one voxel of each block. Arrays
    [z, y, x] of the region's blocks and one more on each side.
    """
    low = high = region
    holes = np.zeros(region.shape, bool) if region.dtype.kind != "f" else ~np.isfinite(region)
    if holes.any():
        low, high = np.where(holes, np.inf, region), np.where(holes, -np.inf, region)

    def extended(values: np.ndarray, over: np.ufunc) -> np.ndarray:
        for axis in range(3):
            found = _over(values, axis, slice(0, values.shape[axis]), edge, over)
            ends = (values.take([k], axis) for k in (0, -1))
            values = np.concatenate([next(ends), found, next(ends)], axis)
        return values

    return extended(low, np.minimum), extended(high, np.maximum), extended(holes, np.logical_or)


def _describe(
    around: np.ndarray, inner: tuple, edge: int, given: list[np.ndarray] | None
) -> tuple[list[np.ndarray], BlockStatistics]:
    levels = resolutions(around[inner], edge.bit_length()) if given is None else given
    full = whole_blocks(levels[0], edge)
    by_block = [split(full, edge)]
    by_block += [
        split(whole_blocks(samples, edge >> level), edge >> level)
        for level, samples in enumerate(levels[1:], 1)
    ]
    summaries = [_summary(samples) for samples in by_block]
    deviation = _deviations(full, by_block)
    low, high, holes = _reach(around, inner, edge)
    real = np.float64 if around.dtype == np.float64 else np.float32

    def of_levels(name: str) -> np.ndarray:
        return np.stack([summary[name] for summary in summaries])

    found = BlockStatistics(
        0,
        of_levels("minimum"), of_levels("maximum"), of_levels("mean"),
        of_levels("quantiles").astype(real, copy=False),
        deviation, low, high, holes,
    )  # fmt: skip
    return levels, found


def split(box: np.ndarray, s: int) -> np.ndarray:
    """The blocks [blocks, s, s, s], in C order, of ``box`` [z, y, x], whose axes are multiples of ``s``."""
    z, y, x = (n // s for n in box.shape)
    return box.reshape(z, s, y, s, x, s).transpose(0, 2, 4, 1, 3, 5).reshape(-1, s, s, s)


def _box(shape: tuple, edge: int, first: tuple, last: tuple) -> tuple[slice, slice, slice]:
    z, y, x = (slice(int(a) * edge, min(int(b) * edge, n)) for a, b, n in zip(first, last, shape))
    return z, y, x


def _summary(samples: np.ndarray) -> dict[str, np.ndarray]:
    flat = samples.reshape(len(samples), -1)
    # numpy's stable sort of 8 and 16 bits is a radix sort.
    flat = np.sort(flat, axis=1, kind="stable" if flat.dtype.itemsize < 4 else None)
    if flat.dtype.kind == "f":
        return _summary_with_holes(flat)
    n = flat.shape[1]
    groups = min(QUANTILES, n)
    sums = flat.reshape(len(flat), groups, -1).sum(axis=2, dtype=np.int32)
    return {
        "minimum": flat[:, 0].astype(np.float64),
        "maximum": flat[:, -1].astype(np.float64),
        "mean": sums.sum(axis=1, dtype=np.int64) / n,
        "quantiles": np.repeat(sums / (n // groups), QUANTILES // groups, axis=1),
    }


def _summary_with_holes(flat: np.ndarray) -> dict[str, np.ndarray]:
    """The summary, blocks without holes together and the others one by one. ``flat`` [blocks, n] is sorted, NaN last.
    """
    whole = np.isfinite(flat[:, 0]) & np.isfinite(flat[:, -1])
    count = len(flat)
    out = {name: np.full(count, np.nan) for name in ("minimum", "maximum", "mean")}
    out["quantiles"] = np.full((count, QUANTILES), np.nan)
    n = flat.shape[1]
    groups = min(QUANTILES, n)
    values = (flat if whole.all() else flat[whole]).astype(np.float64)
    if len(values):
        out["minimum"][whole], out["maximum"][whole] = values[:, 0], values[:, -1]
        means = _mean(values.reshape(len(values), groups, -1))
        out["mean"][whole] = _mean(means)
        out["quantiles"][whole] = np.repeat(means, QUANTILES // groups, axis=1)
    at = (np.arange(QUANTILES) + 0.5) / QUANTILES
    for k in np.flatnonzero(~whole):
        values = flat[k][np.isfinite(flat[k])].astype(np.float64)
        if not values.size:
            continue
        out["minimum"][k], out["maximum"][k], out["mean"][k] = values[0], values[-1], _mean(values)
        out["quantiles"][k] = np.interp(at * values.size - 0.5, np.arange(values.size), values)
    return out


def _mean(values: np.ndarray) -> np.ndarray:
    """The mean over the last axis of values whose sum may overflow."""
    return (values / values.shape[-1]).sum(axis=-1)


def _deviations(full: np.ndarray, by_block: list[np.ndarray]) -> np.ndarray:
    """The root mean square, [levels, blocks], of each level's piecewise constant field minus the voxels ``full`` [z,
    y, x].
    """
    count, edge = len(by_block[0]), by_block[0].shape[1]
    out = np.zeros((len(by_block), count))
    if full.dtype.kind != "f":
        squares = _sums_of_squares(by_block[0].reshape(count, -1))
        for level, sums in enumerate(_sums(full, len(by_block)), 1):
            samples = by_block[level].reshape(count, -1).astype(np.int64)
            sums = split(sums, edge >> level).reshape(count, -1)
            out[level] = (
                squares - 2 * (samples * sums).sum(axis=1) + 8**level * (samples**2).sum(axis=1)
            )
        return np.sqrt(out / edge**3)
    blocks = by_block[0].reshape(count, -1)
    with np.errstate(invalid="ignore"):
        lower, upper = blocks.min(axis=1).astype(np.float64), blocks.max(axis=1).astype(np.float64)
        plain = np.maximum(np.abs(lower), np.abs(upper)) < _LARGE
    if plain.all():
        out[1:] = _deviations_of_floats(full, by_block)
        return out
    for level in range(1, len(by_block)):
        out[level, ~plain] = _deviation_with_holes(
            by_block[0][~plain], by_block[level][~plain], level
        )
    if plain.any():
        chosen = [samples[plain] for samples in by_block]
        out[1:, plain] = _deviations_of_floats(chosen[0].reshape(-1, edge, edge), chosen)
    return out


def _sums_of_squares(blocks: np.ndarray) -> np.ndarray:
    """Sums of squares, int64 [blocks], of integers [blocks, n]."""
    if blocks.dtype.itemsize == 1:
        wide = blocks.astype(np.int16).view(np.uint16)
        wide *= wide  # modulo 2^16, in which all squares of 8 bits are exact
        return wide.sum(axis=1, dtype=np.uint32).astype(np.int64)
    wide = blocks.astype(np.float64)  # their sums are below 2^53
    return np.einsum("ij,ij->i", wide, wide).astype(np.int64)


def _deviations_of_floats(full: np.ndarray, by_block: list[np.ndarray]) -> np.ndarray:
    """Deviations [levels - 1, blocks] without cancellation.

    The squares within a sample are those within its eight parts plus those of the means of the parts. ``full`` [z, y,
    x] may be blocks stacked along z.
    """
    count, edge = len(by_block[0]), by_block[0].shape[1]
    out = np.empty((len(by_block) - 1, count))
    means, within = full, np.zeros(())
    for level in range(1, len(by_block)):
        parts = [
            means[z::2, y::2, x::2].astype(np.float64)
            for z in (0, 1)
            for y in (0, 1)
            for x in (0, 1)
        ]
        if level > 1:
            within = next(_sums(within, 2))
        means = next(_sums(means, 2)) / 8  # in pairs: exact where all eight are the same
        squares = np.zeros(means.shape)
        for part in parts:
            part -= means
            part *= part
            squares += part
        within = within + 8 ** (level - 1) * squares
        s = edge >> level
        off = split(means, s).reshape(count, -1) - by_block[level].reshape(count, -1)
        rounding = 8**level * (off * off).sum(axis=1)
        out[level - 1] = split(within, s).reshape(count, -1).sum(axis=1) + rounding
    return np.sqrt(out / edge**3)


def _deviation_with_holes(full: np.ndarray, samples: np.ndarray, level: int) -> np.ndarray:
    fine = samples.astype(np.float64)
    for axis in (1, 2, 3):
        fine = np.repeat(fine, 1 << level, axis=axis)
    with np.errstate(over="ignore", invalid="ignore"):
        squares = (fine - full.astype(np.float64)) ** 2
        squares = squares.reshape(len(full), -1)
        known = np.isfinite(squares)
        squares[~known] = 0.0
        return np.sqrt(squares.sum(axis=1) / np.maximum(known.sum(axis=1), 1))


def _reach(
    around: np.ndarray, inner: tuple, edge: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """reach_low, reach_high, holes of ``BlockStatistics``."""
    low = high = around
    holes = None
    if around.dtype.kind == "f":
        finite = np.isfinite(around)
        if not finite.all():
            holes = ~finite
            low, high = np.where(finite, around, np.inf), np.where(finite, around, -np.inf)
    for axis in range(3):
        low = _over(low, axis, inner[axis], edge, np.minimum)
        high = _over(high, axis, inner[axis], edge, np.maximum)
        if holes is not None:
            holes = _over(holes, axis, inner[axis], edge, np.logical_or)
    found = np.zeros(low.size, bool) if holes is None else holes.ravel()
    return low.ravel().astype(np.float64), high.ravel().astype(np.float64), found


def _over(values: np.ndarray, axis: int, inner: slice, edge: int, over: np.ufunc) -> np.ndarray:
    """The extreme along ``axis`` over each block of ``inner`` and one value before and after it."""
    values = np.moveaxis(values, axis, 0)
    starts = np.arange(inner.start, inner.stop, edge)
    whole = (inner.stop - inner.start) // edge
    parts = []
    if whole:
        core = values[inner.start : inner.start + whole * edge]
        parts.append(over.reduce(core.reshape(whole, edge, *core.shape[1:]), axis=1))
    if whole < len(starts):
        parts.append(over.reduce(values[starts[-1] : inner.stop], axis=0)[None])
    found = np.concatenate(parts) if len(parts) > 1 else parts[0]
    stops = np.minimum(starts + edge, inner.stop)
    found = over(found, values[np.maximum(starts - 1, 0)])
    found = over(found, values[np.minimum(stops, len(values) - 1)])
    return np.moveaxis(found, 0, axis)
