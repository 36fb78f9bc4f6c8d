"""Training of codecs whose sub-blocks all have the same stages: "vq", "vq-mean" and "hvq".

"vq" as in Ning and Hesselink (1992) and Engel and Ertl (2002, section 9); "hvq" as in Schneider and Westermann (2003):
means of 4^3 samples, codes of the means of 2^3 samples less that mean, codes of what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from clvol.encoding.block_encoder import ToWorking, cut_in_order, first_residual
from clvol.encoding.codebook import eight_bits, shift_for, trained_codebook
from clvol.encoding.draws import DrawnBlocks, drawn
from clvol.encoding.kernels import EncoderKernels
from clvol.encoding.stages import ROWS, distinct_rows
from clvol.store.codecs.coded_blocks import ENTRIES, SHAPES

_PER_PART = 1 << 12  # rows kept of a group of regions, at most: the pool's memory is bounded
_POOL = 1 << 18


def trained_fixed(
    kernels: EncoderKernels, blocks: Iterable[DrawnBlocks], to_working: ToWorking, codec: str, levels: int, seed: int,
    progress: Callable[[int], None],
) -> tuple[np.ndarray, np.ndarray, dict]:  # fmt: skip
    """Entries int8 [stages, ENTRIES, side^3] and shifts int32 [stages] for the sub-blocks of ``blocks``, and facts for
    the policy. ``progress(stage)`` is called after each stage."""
    side, stages, _ = SHAPES[codec]
    pool, few = _pool(blocks, to_working, side, seed)
    residual, _ = first_residual(pool, codec)
    entries, shifts = np.zeros((stages, ENTRIES, side**3), np.int8), np.zeros(stages, np.int32)
    exact = few
    for stage in range(stages):
        rows = residual[drawn(np.arange(len(residual)), ROWS, seed + stage)]
        if codec == "hvq" and stage == 0:
            rows = means_of_eighths(rows)
        distinct = distinct_rows(rows, ENTRIES) if few else None
        if distinct is not None:
            entries[stage], shifts[stage] = exact_entries(distinct)
        else:
            exact = False
            entries[stage], shifts[stage] = trained_codebook(rows, kernels.nearest)
        if codec == "hvq" and stage == 0:
            entries[stage] = means_of_eighths(entries[stage].astype(np.int32)).astype(np.int8)
        if stage + 1 < stages and len(residual):
            codes = kernels.nearest(residual, entries[stage], int(shifts[stage]))
            residual = residual - (entries[stage][codes].astype(np.int32) << int(shifts[stage]))
        progress(stage + 1)
    return entries, shifts, {"distinct_vectors": len(pool)} if exact else {}


def exact_entries(rows: np.ndarray) -> tuple[np.ndarray, int]:
    """Entries and shift for at most ENTRIES distinct ``rows``, one each, a row of zeros first."""
    shift = shift_for(rows)
    words = np.unique(eight_bits(rows, shift), axis=0)
    words = np.concatenate([words[~words.any(axis=1)], words[words.any(axis=1)]])
    entries = np.zeros((ENTRIES, rows.shape[1]), np.int8)
    entries[: len(words)] = words
    return entries, shift


def means_of_eighths(rows: np.ndarray) -> np.ndarray:
    """Rows [n, 64] with each of their 2^3 samples replaced by their mean (rounded down)."""
    eighths = rows.reshape(-1, 2, 2, 2, 2, 2, 2)
    means = eighths.sum(axis=(2, 4, 6), keepdims=True) >> 3
    return np.ascontiguousarray(np.broadcast_to(means, eighths.shape).reshape(rows.shape).astype(rows.dtype))


def _pool(
    blocks: Iterable[DrawnBlocks], to_working: ToWorking, side: int, seed: int
) -> tuple[np.ndarray, bool]:
    """Working values uint16 [n, side^3] of sub-blocks of all ``blocks``, without those whose voxels working values do
    not express; and whether they are all the distinct ones there are, each once, which are no more than codes."""
    parts: list[np.ndarray] = []
    distinct: np.ndarray | None = np.empty((0, side**3), np.uint16)
    number = 0
    for part in blocks:
        samples = to_working(part.voxels)
        rows = cut_in_order(samples.work, side)
        if samples.odd is not None:
            rows = rows[~cut_in_order(samples.odd, side).any(axis=1)]
        if distinct is not None:
            distinct = distinct_rows(np.concatenate([distinct, rows]), ENTRIES)
        number += 1
        parts.append(rows[drawn(np.arange(len(rows)), _PER_PART * 16, seed + number)])
        if sum(map(len, parts)) > 4 * _POOL:  # half of what there is, from now on with half the share
            parts = [p[::2] for p in parts]
    if distinct is not None:
        return distinct, True
    rows = np.concatenate(parts)
    return rows[drawn(np.arange(len(rows)), _POOL, seed)], False
