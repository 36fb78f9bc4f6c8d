"""Training of one codebook: principal-axis splits, then Lloyd's iterations, in exact integers.

Splits as in Wu, "Color quantization by dynamic programming and principal analysis" (1992): the cell with the largest
error is cut across its principal axis at the mean. Iterations as in Linde, Buzo and Gray (1980), with codewords rounded
to what is stored. All sums are integers below 2^53, also where a matrix product in double precision computes them, so
the result does not depend on the machine.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable

import numpy as np

from clvol.store.codecs.coded_blocks import ENTRIES, LARGEST_SHIFT

_SPLIT_ROWS = 1 << 14  # that splits look at
_FEW_ROWS = 1 << 14  # that the first iterations look at
_SPLIT_BITS = 9  # of their samples
_POWER_STEPS = 6

Nearest = Callable[[np.ndarray, np.ndarray, int], np.ndarray]
"""Codes uint8 [n] of the codewords (int8 [ENTRIES, samples], shift) nearest to residuals int32 [n, samples]."""


def trained_codebook(
    rows: np.ndarray, nearest: Nearest, iterations: tuple[int, int] = (12, 4)
) -> tuple[np.ndarray, int]:
    """Entries int8 [ENTRIES, samples] and their shift for residuals ``rows`` (int32 [n, samples]). ``iterations``: on a
    few of the rows, and then on all."""
    if not len(rows):
        return np.zeros((ENTRIES, rows.shape[1]), np.int8), 0
    centres = principal_splits(rows, ENTRIES)
    shift = shift_for(centres)
    entries = rounded(centres, shift)
    few = evenly(rows, _FEW_ROWS)
    if len(few) < len(rows):
        entries, shift = iterated(few, entries, shift, nearest, iterations[0])
        return iterated(rows, entries, shift, nearest, iterations[1])
    return iterated(rows, entries, shift, nearest, sum(iterations))


def evenly(rows: np.ndarray, most: int) -> np.ndarray:
    """At most ``most`` of ``rows``, evenly spaced."""
    return rows if len(rows) <= most else rows[np.arange(most) * len(rows) // most]


def iterated(
    rows: np.ndarray, entries: np.ndarray, shift: int, nearest: Nearest, iterations: int
) -> tuple[np.ndarray, int]:
    """``entries`` and their shift after Lloyd's ``iterations`` on ``rows``."""
    before = np.zeros(len(rows), np.uint8)
    sums, counts = cell_sums(rows, before)
    for _ in range(iterations):
        codes = nearest(rows, entries, shift)
        moved = np.flatnonzero(codes != before)  # few of them, after the first iterations
        for side, sign in ((before, -1), (codes, 1)):
            more, number = cell_sums(rows[moved], side[moved])
            sums += sign * more
            counts += sign * number
        before = codes
        used = counts > 0
        wide = entries.astype(np.int64) << shift
        wide[used] = divided(sums[used], counts[used, None])
        empty = np.flatnonzero(~used)
        if len(empty):
            wide[empty] = farthest(rows, entries, codes, shift, len(empty))
        shift = shift_for(wide)
        changed = rounded(wide, shift)
        if np.array_equal(changed, entries):
            break
        entries = changed
    return entries, shift


def divided(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The nearest integers to sums / counts; halves down."""
    return -((counts - 2 * sums) // (2 * counts))


def rounded(values: np.ndarray, shift: int) -> np.ndarray:
    """Entries int8 of ``values`` (integers): halves down, a codeword of zeros first, unused ones after all others."""
    entries = eight_bits(values, shift)
    entries = np.concatenate([entries, np.zeros((ENTRIES - len(entries), entries.shape[1]), np.int8)])
    is_zero = ~entries[: len(values)].any(axis=1)
    if is_zero.any():
        entries[[0, int(np.argmax(is_zero))]] = entries[[int(np.argmax(is_zero)), 0]]
    return entries


def eight_bits(values: np.ndarray, shift: int) -> np.ndarray:
    """int8: ``values`` in steps of 1 << shift; halves down."""
    half = (1 << shift >> 1) - 1 if shift else 0
    return np.clip((values.astype(np.int64) + half) >> shift, -128, 127).astype(np.int8)


def shift_for(values: np.ndarray) -> int:
    """The least shift with which ``values`` fit in eight bits, or the largest that there is."""
    most = int(np.abs(values).max(initial=0))
    return min(LARGEST_SHIFT, max(0, (most // 128).bit_length()))


def cell_sums(rows: np.ndarray, codes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums int64 [ENTRIES, samples] and counts int64 [ENTRIES] of the ``rows`` of each code."""
    counts = np.bincount(codes, minlength=ENTRIES)
    order = np.argsort(codes, kind="stable")
    sums = np.zeros((ENTRIES, rows.shape[1]), np.int64)
    used = np.flatnonzero(counts)
    starts = (np.cumsum(counts) - counts)[used]
    if len(used):
        sums[used] = np.add.reduceat(rows[order].astype(np.int64), starts, axis=0)
    return sums, counts


def farthest(rows: np.ndarray, entries: np.ndarray, codes: np.ndarray, shift: int, count: int) -> np.ndarray:
    """int64 [count, samples]: rows that are far from their codewords, one for each of the cells with the most error,
    and more of the same cells where there are fewer."""
    left = rows.astype(np.int64) - (entries[codes].astype(np.int64) << shift)
    squares = (left * left).sum(axis=1)
    errors = np.zeros(ENTRIES, np.int64)
    np.add.at(errors, codes, squares)
    by_distance = np.argsort(-squares, kind="stable")
    first = np.full(ENTRIES, -1)
    cells, places = np.unique(codes[by_distance], return_index=True)
    first[cells] = by_distance[places]
    cells = np.argsort(-errors, kind="stable")[:count]
    worst = [int(first[cell]) for cell in cells if errors[cell]]
    more = by_distance[: count - len(worst)]
    chosen = np.concatenate([np.array(worst, np.int64), more])
    return rows[np.resize(chosen, count)].astype(np.int64)


def principal_splits(rows: np.ndarray, cells: int) -> np.ndarray:
    """int64 [at most cells, samples]: the means of cells into which ``rows`` are split."""
    rows = evenly(rows, _SPLIT_ROWS)
    # Differences of 10 bits and a direction of 8: products of 64 terms over 2^14 rows stay below 2^53.
    drop = max(0, int(np.abs(rows).max(initial=0)).bit_length() - _SPLIT_BITS)
    small = (rows >> drop).astype(np.float64)
    heap: list[tuple[float, int, np.ndarray]] = []
    final: list[np.ndarray] = []
    number = 0

    def add(members: np.ndarray) -> None:
        nonlocal number
        own = small[members]
        spread = len(members) * (own * own).sum() - (own.sum(axis=0) ** 2).sum()  # n times the squared error
        heapq.heappush(heap, (-(spread // len(members)), number, members))
        number += 1

    add(np.arange(len(rows)))
    while heap and len(heap) + len(final) < cells:
        error, _, members = heapq.heappop(heap)
        side = _upper_side(small[members]) if error < 0 else None
        if side is None:
            final.append(members)
            continue
        add(members[side])
        add(members[~side])
    cells_members = final + [members for _, _, members in sorted(heap, key=lambda cell: cell[1])]
    means = [divided(rows[m].sum(axis=0, dtype=np.int64), np.int64(len(m))) for m in cells_members]
    return np.array(means)


def _upper_side(own: np.ndarray) -> np.ndarray | None:
    """bool [n]: which of ``own`` lie above the mean along the principal axis; None if all are alike."""
    centred = own - np.floor(own.sum(axis=0) / len(own))
    matrix = centred.T @ centred
    axis = matrix[int(np.argmax(matrix.diagonal()))]
    for _ in range(_POWER_STEPS):
        largest = np.abs(axis).max()
        if not largest:
            return None
        axis = matrix @ np.rint(axis / largest * 128)
    largest = np.abs(axis).max()
    if not largest:
        return None
    along = centred @ np.rint(axis / largest * 128)
    side = along * len(along) > along.sum()
    return side if side.any() and not side.all() else None
