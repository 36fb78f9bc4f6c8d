"""Selection of the level of each block: the least error within a number of bytes.

This is a multiple-choice knapsack (Sinha and Zoltners, Operations Research 27, 1979): one level is chosen
per block. Upgrades along a block's lower convex hull of (bytes, error) save less and less error
per byte, so taking the upgrades of all blocks in order of error per byte equals the greedy algorithm with a heap. It
stops at the optimum of the relaxed problem, in which blocks may be held in part, so no selection
has less error than ``Selection.bound``. Nothing is sorted: only the slope at which the
bytes run out is found, by two histograms of the slopes' bits (a radix selection), so eight
million blocks take seconds. The bytes that are left, less than one block takes, are then filled through a
heap with the upgrades that still fit. If the error is not close to the bound yet, which happens with few blocks,
pairs of blocks are exchanged, one made finer and one coarser, while that helps.

Error of the result / least possible error: 216 blocks of engine, tooth and vismale, three transfer
functions, 1 % to 50 % of the bytes: mean 1.001, worst 1.007; up to 60 random blocks: mean 1.02,
worst 1.8.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clvol.errors import SceneError
from clvol.integrators.multiresolution.view_weight import view_weights, visibility
from clvol.integrators.multiresolution.visible_error import (
    ShownColors,
    block_transmittances,
    estimated_errors,
    transparent,
)
from clvol.scene.camera import Camera
from clvol.scene.glow import Glow
from clvol.scene.image import ImageSettings
from clvol.scene.sizes import format_size
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED, BlockSource
from clvol.transfer import TransferFunction

# Delta-E times pixels below which nobody sees an error: less than a tenth of a step of 8 bits in
# one pixel.
NEGLIGIBLE = 1e-2
_PIECE = 1 << 18  # blocks processed together
# Blocks are exchanged until the error is this close to the bound, and at most this many times.
_CLOSE = 1e-3
_ROUNDS = 64


@dataclass(frozen=True, eq=False)
class Selection:
    """``levels`` [n] uint8: DROPPED for blocks that take no memory; 0 is full resolution.
    ``bytes``: bytes of their samples. ``error``: the sum of the blocks' errors. ``bound``: no
    levels within the bytes have less error than this, so ``error - bound`` is at most their distance from
    the optimum."""

    levels: np.ndarray
    bytes: int
    error: float
    bound: float


@dataclass(frozen=True, eq=False)
class SourceErrors:
    """Errors of all blocks, independent of the view: ``errors`` float32 [levels, n] (``block_errors``, 0 where
    dropped), ``dropped`` bool [n], ``transmittances`` float32 [n] along a path of a block's edge, as
    ``visibility`` needs them."""

    errors: np.ndarray
    dropped: np.ndarray
    transmittances: np.ndarray


def source_errors(
    source: BlockSource, function: TransferFunction, background: np.ndarray, glow: Glow | None = None
) -> SourceErrors:
    """The errors from ``source``'s statistics, one part after the other; ``background`` linear [3], ``glow``: light
    beside that of ``function``. The path is a block's edge times the smallest voxel edge."""
    blocks = source.blocks
    path = blocks.edge * source.grid.smallest_edge
    shown = ShownColors(function, path, background, glow)
    errors = np.zeros((blocks.levels, blocks.count), np.float32)
    dropped = np.zeros(blocks.count, bool)
    transmittances = np.ones(blocks.count, np.float32)
    for part in source.statistics():
        piece = slice(part.first, part.first + len(part.reach_low))
        dropped[piece] = transparent(part, function, glow)
        errors[:, piece] = estimated_errors(part, shown, ~dropped[piece])
        transmittances[piece] = block_transmittances(part, shown)
    transmittances[dropped] = 1.0  # exactly, whatever the table's nearest entry says
    return SourceErrors(errors, dropped, transmittances)


def select_blocks(
    source: BlockSource,
    function: TransferFunction,
    background: np.ndarray,
    camera: Camera | None,
    image: ImageSettings,
    memory_bytes: int,
    overhead_bytes: int = 0,
    occlusion: bool = False,
    known: SourceErrors | None = None,
    least_share: float = 0.0,
) -> Selection:
    """The levels of ``source``'s blocks with the least visible error within ``memory_bytes``, of which
    ``overhead_bytes`` are taken.

    ``camera`` (complete): errors are weighted by the pixels that a block covers in its picture of the size of
    ``image``, and with ``occlusion`` by the light that reaches the eye, too; None: all blocks count
    alike. ``least_share``: what is not seen counts for at least this share of what is seen best, since it casts shadows
    on it, for example. ``known``: ``source_errors`` of the same source, function and background, which need not be
    computed again for a new view.

    SceneError if not even one sample per block fits.
    """
    cost = level_costs(source.blocks, source.dtype)
    found = source_errors(source, function, background) if known is None else known
    needed = overhead_bytes + minimum_bytes(cost, found.dropped)
    if memory_bytes < needed:
        expected = f"at least {format_size(needed)} for the coarsest resolution of {source.name}"
        got = f"got {format_size(memory_bytes)}"
        raise SceneError("scene: multiresolution.memory", got, expected)
    for everything in all_resolutions(found, cost):
        if everything.bytes <= memory_bytes - overhead_bytes:
            return everything
    errors = found.errors
    if camera is not None:
        errors = errors if known is None else errors.copy()
        grid, blocks = source.grid, source.blocks
        weights = view_weights(camera, grid, blocks, image.width, image.height)
        weights.with_least(least_share).apply(errors)
        if occlusion:
            errors *= np.maximum(visibility(camera, grid, blocks, found.transmittances), np.float32(least_share))
    return select_levels(errors, cost, found.dropped, memory_bytes - overhead_bytes)


def all_resolutions(found: SourceErrors, cost: np.ndarray) -> Iterator[Selection]:
    """Full resolution for all blocks that show anything, so that rays see only voxels. Where that is too
    much, for all except those whose single sample is estimated to be as good."""
    for least in (-1.0, 0.0):
        levels = np.where(found.errors[-1] > least, 0, len(cost) - 1).astype(np.uint8)
        levels[found.dropped] = DROPPED
        yield Selection(levels, _bytes(levels, cost), 0.0, 0.0)


def level_costs(blocks: BlockGrid, dtype: np.dtype) -> np.ndarray:
    """int64 [levels]: bytes of a block's samples on the device. A single sample is kept in the index, so
    it costs nothing; float64 volumes are held as float32."""
    size = min(np.dtype(dtype).itemsize, 4)
    samples = np.array([blocks.samples(level) for level in range(blocks.levels)], np.int64)
    return np.where(samples > 1, samples**3 * size, 0)


def minimum_bytes(cost: np.ndarray, dropped: np.ndarray) -> int:
    """Bytes of the coarsest level everywhere, the least possible budget."""
    return int(cost[-1]) * int(np.count_nonzero(~np.asarray(dropped, bool)))


def select_levels(
    errors: np.ndarray,
    cost: np.ndarray,
    dropped: np.ndarray,
    budget: int,
    negligible: float = NEGLIGIBLE,
) -> Selection:
    """The levels of n blocks that make the best use of ``budget`` bytes.

    ``errors`` [levels, n] float32, finite, >= 0, weighted; ``cost`` [levels] bytes of a block,
    falling with the level; ``dropped`` [n] bool. Errors up to ``negligible`` count as 0; once all
    are 0 no more bytes are spent. Among equal upgrades the lower numbered block goes first. Takes
    about four bytes per block and level in addition to ``errors``.

    ValueError if ``budget`` is less than ``minimum_bytes(cost, dropped)``, or the costs do not
    fall.
    """
    cost = np.asarray(cost, np.int64)
    dropped = np.asarray(dropped, bool)
    if np.any(cost[1:] >= cost[:-1]) or cost[-1] < 0:
        raise ValueError(f"costs {cost.tolist()}, expected bytes that fall with the level")
    spare = int(budget) - minimum_bytes(cost, dropped)
    if spare < 0:
        raise ValueError(f"a budget of {budget} bytes, expected at least {int(budget) - spare}")
    slopes = hull_slopes(errors, cost, dropped, negligible)
    threshold = _threshold(slopes, cost, spare)
    levels = _levels_at(slopes, threshold, dropped)
    spare -= _bytes(levels, cost) - minimum_bytes(cost, dropped)
    if threshold > 0:
        spare = _take_equal(slopes, cost, levels, threshold, spare)
    error = total_error(errors, levels, negligible)
    relaxed = max(error - spare * float(threshold), 0.0)
    if spare and threshold > 0:
        spare = _fill(errors, cost, levels, spare, negligible)
        for _ in range(_ROUNDS):
            error = total_error(errors, levels, negligible)
            if error - relaxed <= _CLOSE * error:
                break
            exchanged = _exchange(errors, cost, levels, spare, negligible)
            if exchanged is None:
                break
            spare = _fill(errors, cost, levels, exchanged, negligible)
    return Selection(levels, _bytes(levels, cost), error, min(relaxed, error))


def total_error(errors: np.ndarray, levels: np.ndarray, negligible: float = NEGLIGIBLE) -> float:
    """Sum of the errors of the blocks at ``levels``; DROPPED blocks have none."""
    total = 0.0
    for piece in _pieces(len(levels)):
        part, chosen = errors[:, piece], levels[piece].astype(np.intp)
        blocks = np.flatnonzero(chosen != DROPPED)
        found = part[chosen[blocks], blocks].astype(np.float64)
        total += float(found[found > negligible].sum())
    return total


def hull_slopes(
    errors: np.ndarray, cost: np.ndarray, dropped: np.ndarray, negligible: float = NEGLIGIBLE
) -> np.ndarray:
    """float32 [levels - 1, n]: error saved per byte by the upgrade that ends at a level; 0
    where no upgrade of the lower convex hull ends. In each block the slopes fall from the coarsest
    level to the finest."""
    count = errors.shape[1]
    out = np.zeros((len(cost) - 1, count), np.float32)
    for piece in _pieces(count):
        _hull_piece(_counted(errors[:, piece], negligible), cost, dropped[piece], out[:, piece])
    return out


def _hull_piece(
    errors: np.ndarray, cost: np.ndarray, dropped: np.ndarray, out: np.ndarray
) -> None:
    """Fills ``out`` [levels - 1, k], which is zero, from float64 ``errors`` [levels, k]: starting at the coarsest level
    the next corner of the hull is the level of the steepest slope, the finest of equal ones."""
    last = len(cost) - 1
    blocks = np.flatnonzero(~dropped & (errors[last] > 0))
    here = np.full(len(blocks), last)
    for _ in range(last):
        # The following levels have cost differences <= 0 and are no upgrades.
        bytes_more = cost[:-1, None] - cost[here][None, :]
        saved = errors[here, blocks][None, :] - errors[:-1, blocks]
        slopes = np.where(bytes_more > 0, saved / np.maximum(bytes_more, 1), 0.0)
        best = slopes.argmax(axis=0)
        steepest = np.take_along_axis(slopes, best[None, :], axis=0)[0].astype(np.float32)
        more = steepest > 0
        blocks, here = blocks[more], best[more]
        if not len(blocks):
            return
        out[here, blocks] = steepest[more]


def _counted(errors: np.ndarray, negligible: float) -> np.ndarray:
    found = np.asarray(errors, np.float64)
    return np.where(found > negligible, found, 0.0)


def _pieces(count: int):
    return (slice(first, first + _PIECE) for first in range(0, count, _PIECE))


def _threshold(slopes: np.ndarray, cost: np.ndarray, spare: int) -> np.float32:
    """The slope of the first upgrades, in order of slope, that do not all fit into ``spare`` bytes;
    0 if all fit.

    Floats >= 0 are ordered like their bits: the upper half of the bits is found first, then the
    lower one.
    """
    upper = np.zeros(1 << 16)
    for bits, spent in _steps(slopes, cost):
        upper += np.bincount(bits >> 16, spent, 1 << 16)
    high, before = _overflow(upper, spare)
    if high < 0:
        return np.float32(0)
    lower = np.zeros(1 << 16)
    for bits, spent in _steps(slopes, cost):
        inside = bits >> 16 == high
        lower += np.bincount(bits[inside] & 0xFFFF, spent[inside], 1 << 16)
    low, _ = _overflow(lower, spare - before)
    return np.array([high << 16 | low], np.uint32).view(np.float32)[0]


def _overflow(spent: np.ndarray, spare: float) -> tuple[int, float]:
    """The first bin, counted from the end, at which the sum of ``spent`` exceeds ``spare``, and the sum
    before it; -1 if there is none."""
    sums = np.cumsum(spent[::-1])
    at = int(np.searchsorted(sums, spare, side="right"))
    if at == len(sums):
        return -1, float(sums[-1])
    return len(sums) - 1 - at, float(sums[at - 1]) if at else 0.0


def _steps(slopes: np.ndarray, cost: np.ndarray):
    """(bits of the slopes uint32, bytes float64) of all upgrades, in pieces of one level."""
    for piece in _pieces(slopes.shape[1]):
        part = slopes[:, piece]
        held = np.full(part.shape[1], cost[-1])
        for level in range(len(part) - 1, -1, -1):
            blocks = np.flatnonzero(part[level] > 0)
            if len(blocks):
                spent = (cost[level] - held[blocks]).astype(np.float64)
                yield part[level, blocks].view(np.uint32), spent
                held[blocks] = cost[level]


def _levels_at(slopes: np.ndarray, threshold: np.float32, dropped: np.ndarray) -> np.ndarray:
    """uint8 [n]: the finest level whose upgrade is steeper than ``threshold``."""
    levels = np.full(slopes.shape[1], len(slopes), np.uint8)
    for level in range(len(slopes) - 1, -1, -1):
        levels[slopes[level] > threshold] = level
    levels[dropped] = DROPPED
    return levels


def _bytes(levels: np.ndarray, cost: np.ndarray) -> int:
    counts = np.bincount(levels, minlength=256)[: len(cost)]
    return int((counts * cost).sum())


def _take_equal(
    slopes: np.ndarray, cost: np.ndarray, levels: np.ndarray, threshold: np.float32, spare: int
) -> int:
    """Makes upgrades of exactly ``threshold``, block by block, until one does not fit; returns the bytes left.
    Changes ``levels``."""
    equal = np.flatnonzero((slopes == threshold).any(axis=0))
    for start in range(0, len(equal), _PIECE):
        blocks = equal[start : start + _PIECE]
        # A block's upgrades of one slope are consecutive, and are made together.
        target = (slopes[:, blocks] == threshold).argmax(axis=0)
        spent = np.cumsum(cost[target] - cost[levels[blocks]])
        fits = int(np.searchsorted(spent, spare, side="right"))
        levels[blocks[:fits]] = target[:fits]
        spare -= int(spent[fits - 1]) if fits else 0
        if fits < len(blocks):
            break
    return spare


def _fill(
    errors: np.ndarray, cost: np.ndarray, levels: np.ndarray, spare: int, negligible: float
) -> int:
    """Makes upgrades that fit into ``spare`` bytes, those with the most error per byte first, in ``levels``; returns
    the bytes left.

    ``spare`` is less than the bytes of one upgrade, so few blocks can be upgraded from a level, each at least to the
    next finer one: the heap starts with that many of the best for each pair of levels.
    """
    heap: list[tuple[float, int, int, int]] = []

    def push(block: int, here: int, to: int) -> None:
        """Adds an upgrade; it is stale if the block's level is no longer ``here`` when it is taken from the heap."""
        before, after = _counted(errors[[here, to], block], negligible)
        if before > after:
            heapq.heappush(heap, ((after - before) / float(cost[to] - cost[here]), block, to, here))

    for here in range(1, len(cost)):
        blocks = np.flatnonzero(levels == here)
        most = spare // int(cost[here - 1] - cost[here])
        for to in range(here):
            for block in _most_saved(errors, blocks, here, to, most, negligible):
                push(int(block), here, to)
    while heap:
        _, block, to, here = heapq.heappop(heap)
        if levels[block] != here or cost[to] - cost[here] > spare:
            continue
        spare -= int(cost[to] - cost[here])
        levels[block] = to
        for finer in range(to):
            push(block, to, finer)
    return spare


def _exchange(
    errors: np.ndarray, cost: np.ndarray, levels: np.ndarray, spare: int, negligible: float
) -> int | None:
    """Makes one block finer and another coarser in ``levels``, where that saves the most error; returns the bytes left,
    or None if no such pair saves any error.

    For each pair of levels only the two blocks matter that gain most, or lose least: two, since
    the best of both may be the same block.
    """
    finer: list[tuple[float, int, int, int]] = []  # error saved, block, level, bytes
    coarser: list[tuple[float, int, int, int]] = []  # error added, block, level, bytes
    for here in range(len(cost)):
        blocks = np.flatnonzero(levels == here)
        for to in range(len(cost)):
            found, sign = (finer, 1) if to < here else (coarser, -1)
            for block in _most_saved(errors, blocks, here, to, 2 if to != here else 0, negligible):
                before, after = _counted(errors[[here, to], block], negligible)
                moved = sign * int(cost[to] - cost[here])
                found.append((sign * float(before - after), int(block), to, moved))
    best = max(
        ((up, down) for up in finer for down in coarser
         if up[1] != down[1] and up[3] <= spare + down[3]),
        key=lambda pair: pair[0][0] - pair[1][0], default=None,
    )  # fmt: skip
    if best is None or best[0][0] <= best[1][0]:
        return None
    for _, block, to, _ in best:
        levels[block] = to
    return spare - best[0][3] + best[1][3]


def _most_saved(
    errors: np.ndarray, blocks: np.ndarray, here: int, to: int, most: int, negligible: float
) -> np.ndarray:
    """The ``most`` of ``blocks`` for which ``to`` in place of ``here`` saves the most error."""
    if most < 1 or not len(blocks):
        return blocks[:0]
    kept, found = blocks[:0], np.empty(0)
    for start in range(0, len(blocks), _PIECE):
        part = blocks[start : start + _PIECE]
        saved = _counted(errors[here, part], negligible) - _counted(errors[to, part], negligible)
        kept, found = np.append(kept, part), np.append(found, saved)
        if len(kept) > most:
            order = np.argsort(-found, kind="stable")[:most]
            order.sort()
            kept, found = kept[order], found[order]
    return kept


def exact_levels(
    errors: np.ndarray, cost: np.ndarray, dropped: np.ndarray, budget: int
) -> Selection:
    """The best levels, by dynamic programming over blocks and bytes: for small cases, which tests
    compare with.

    Time and memory go with n * budget / (greatest common divisor of the costs).
    """
    cost = np.asarray(cost, np.int64)
    kept = np.flatnonzero(~np.asarray(dropped, bool))
    spare = int(budget) - minimum_bytes(cost, dropped)
    if spare < 0:
        raise ValueError(f"a budget of {budget} bytes, expected at least {int(budget) - spare}")
    extra = cost - cost[-1]
    unit = max(int(np.gcd.reduce(extra)), 1)
    units, room = extra // unit, min(spare // unit, int(extra[0] // unit) * len(kept))
    best = np.zeros(room + 1)
    choice = np.empty((len(kept), room + 1), np.uint8)
    for k, block in enumerate(kept):
        options = np.full((len(cost), room + 1), np.inf)
        for level, taken in enumerate(units):
            if taken <= room:
                options[level, taken:] = best[: room + 1 - taken] + float(errors[level, block])
        # Of equal ones the coarsest.
        choice[k] = len(cost) - 1 - options[::-1].argmin(axis=0)
        best = options.min(axis=0)
    levels = np.full(errors.shape[1], DROPPED, np.uint8)
    left = room
    for k in range(len(kept) - 1, -1, -1):
        levels[kept[k]] = choice[k, left]
        left -= int(units[choice[k, left]])
    error = total_error(errors, levels, 0.0)
    return Selection(levels, _bytes(levels, cost), error, error)
