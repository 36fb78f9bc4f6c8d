"""Training of the stages of residual vector quantisation ("rvq"), each on the sub-blocks that need it.

As measured: where a stage is trained on sub-blocks that the target leaves something to do, each counting once, PSNR is
0.2 to 0.6 dB higher at the same rate than where they are drawn by their error; a joint optimisation of all stages
(Barnes and Frost, "Vector quantizers with direct sum codebooks", 1993) adds less than 0.05 dB to that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from clvol.encoding.block_encoder import ToWorking, first_residual
from clvol.encoding.codebook import eight_bits, shift_for, trained_codebook
from clvol.encoding.draws import DrawnBlocks, drawn
from clvol.encoding.kernels import EncoderKernels
from clvol.encoding.policy import Goal
from clvol.store.codecs.coded_blocks import ENTRIES, MOST_STAGES

ROWS = 60000  # sub-blocks that a stage is trained on
POOL = 1 << 18  # sub-blocks that they are drawn from
_FEWEST = 1024  # sub-blocks: where fewer need a stage, 16 KiB of codewords are not worth it
_STAGES_PER_HALVING = 2.4  # of a sub-block's squared error, of which a stage typically takes a quarter


@dataclass(frozen=True, eq=False)
class Survey:
    """Errors of the drawn volume where sub-blocks are their means: of sub-blocks uint64 [octants, 8, 2] (squares,
    largest), of octants uint64 [octants, 2]. ``samples``: how many they are, ``voxels``: how many of them are the
    volume's own."""

    apart: np.ndarray
    flat: np.ndarray
    samples: int
    voxels: int

    def lagrangian(self, goal: Goal) -> int:
        """A first guess at the multiplier that reaches ``goal``: sub-blocks are left with an error of theta each, or
        with less if they have less ("reverse water-filling"), and a stage takes a quarter of that at eight bits."""
        squares, flat = self.apart[:, :, 0].reshape(-1).astype(np.int64), self.flat[:, 0].astype(np.int64)
        best = 1
        for exponent in range(0, 41):
            lagrangian = 1 << exponent
            theta = max(1, lagrangian // 8)  # 8 lagrangian = 256 theta / 4
            if goal.squares is not None:
                if int(np.minimum(squares, theta).sum()) > goal.squares * self.samples:
                    break
            elif goal.bits is not None:
                stages = np.maximum(squares[squares > theta] // theta, 1)
                halvings = int((np.frexp(stages)[1] - 1).sum())
                bits = 8 * _STAGES_PER_HALVING * halvings + 96 * int((flat > theta).sum())
                if bits <= goal.bits * self.voxels:
                    return lagrangian
            best = lagrangian
        return best


def survey(kernels: EncoderKernels, blocks: Iterable[DrawnBlocks], to_working: ToWorking, levels: int) -> Survey:
    apart, flat, samples, voxels = [], [], 0, 0
    for part in blocks:
        cut = kernels.cut(to_working(part.voxels).work, levels)
        apart.append(cut.apart.copy())
        flat.append(cut.flat.copy())
        samples += part.voxels.size
        voxels += int(part.inside.prod(axis=1).sum())
    return Survey(np.concatenate(apart), np.concatenate(flat), samples, voxels)


@dataclass(frozen=True, eq=False)
class Stages:
    """Trained stages. ``distinct``: number of distinct residuals where that is no more than codes, else None."""

    entries: np.ndarray
    shifts: np.ndarray
    distinct: int | None


def needing(found: Survey, goal: Goal, lagrangian: int) -> np.ndarray:
    """Places (octant * 8 + sub-block) of the sub-blocks for which stages may be worth their bits."""
    squares, largest = (found.apart[:, :, i].astype(np.int64) for i in (0, 1))
    flat_squares, flat_largest = (found.flat[:, i].astype(np.int64) for i in (0, 1))
    if goal.bound is not None:
        return np.flatnonzero((largest > goal.bound) & (flat_largest > goal.bound)[:, None])
    worth = goal.needs(squares, largest, lagrangian)
    return np.flatnonzero(worth & (256 * flat_squares > 88 * lagrangian)[:, None])


def pool_of(
    kernels: EncoderKernels, blocks: Iterable[DrawnBlocks], to_working: ToWorking, levels: int, places: np.ndarray
) -> np.ndarray:
    """Working values uint16 [n, 64] of the sub-blocks at ``places`` (ascending); those with voxels that working values
    do not express are left out."""
    parts, before = [], 0
    for part in blocks:
        samples = to_working(part.voxels)
        number = part.voxels.size // 64
        first, last = np.searchsorted(places, (before, before + number))
        own = places[first:last] - before
        before += number
        if not len(own):
            continue
        cut = kernels.cut(samples.work, levels)
        rows = kernels.context.read(cut.work).reshape(-1, 64)[own]
        if samples.odd is not None:
            odd = kernels.cut(samples.odd.astype(np.uint16), 65536)
            rows = rows[~kernels.context.read(odd.work).reshape(-1, 64)[own].any(axis=1)]
        parts.append(rows)
    return np.concatenate(parts) if parts else np.empty((0, 64), np.uint16)


def trained_stages(
    kernels: EncoderKernels, pool: np.ndarray, levels: int, goal: Goal, lagrangian: int, seed: int, whole: bool,
    enough: Callable[[np.ndarray, np.ndarray], bool], progress: Callable[[int], None],
) -> Stages:  # fmt: skip
    """Stages for sub-blocks of working values ``pool`` (uint16 [n, 64]). ``whole``: no other sub-blocks need stages.
    ``enough(squares, largest)`` is called with the errors of the pool by depth, int64 [n, stages + 1], after each stage
    and before the first; if it is true, no further one is trained. ``progress(stage)`` reports."""
    context = kernels.context
    residual, _ = first_residual(pool, "rvq")
    entries, shifts = np.zeros((MOST_STAGES, ENTRIES, 64), np.int8), np.zeros(MOST_STAGES, np.int32)
    distinct = distinct_rows(residual, ENTRIES - 1) if whole else None
    exact = [] if distinct is None else _exact_stages(distinct)
    work = context.upload(pool if len(pool) else np.zeros((1, 64), np.uint16))
    left = context.upload(residual if len(pool) else np.zeros((1, 64), np.int32), writable=True)
    squares, largest = [], []
    stage = -1  # a codeword of zeros, that is the means alone
    zero = np.zeros((ENTRIES, 64), np.int8)
    while len(pool):
        found = kernels.advance(
            work, left, pool.shape, zero if stage < 0 else entries[stage], int(shifts[max(stage, 0)]), levels
        )
        squares.append(found[1].astype(np.int64))
        largest.append(found[2].astype(np.int64))
        stage += 1
        progress(stage)
        is_enough = enough(np.stack(squares, axis=1), np.stack(largest, axis=1))
        if stage < len(exact):
            entries[stage], shifts[stage] = exact[stage]
            continue
        if is_enough:
            break
        need = np.flatnonzero(goal.needs(squares[-1], largest[-1], lagrangian))
        if stage == MOST_STAGES or len(need) < _FEWEST:
            break
        residual = context.read(left)
        entries[stage], shifts[stage] = trained_codebook(
            residual[drawn(need, ROWS, seed + stage)], kernels.nearest
        )
    if not len(pool):
        enough(np.zeros((0, 1), np.int64), np.zeros((0, 1), np.int64))
    count = max(stage, 0)
    is_exact = distinct is not None and len(squares) > 0 and not squares[-1].any()
    return Stages(entries[:count], shifts[:count], len(distinct) if distinct is not None and is_exact else None)


def distinct_rows(rows: np.ndarray, most: int) -> np.ndarray | None:
    """The distinct ones of ``rows``, if there are no more than ``most``."""
    found = np.empty((0, rows.shape[1]), rows.dtype)
    for first in range(0, len(rows), 1024):
        found = np.unique(np.concatenate([found, rows[first : first + 1024]]), axis=0)
        if len(found) > most:
            return None
    return found


def _exact_stages(rows: np.ndarray) -> list[tuple[np.ndarray, int]]:
    """Entries and shifts of stages, each finer than the one before, that together give ``rows`` exactly."""
    stages: list[tuple[np.ndarray, int]] = []
    while rows.any() and len(stages) < MOST_STAGES:
        shift = shift_for(rows)
        coarse = eight_bits(rows, shift)
        words = np.unique(coarse, axis=0)
        words = words[words.any(axis=1)]
        entries = np.zeros((ENTRIES, rows.shape[1]), np.int8)  # code 0 is a codeword of zeros
        entries[1 : len(words) + 1] = words
        stages.append((entries, shift))
        rows = rows - (coarse.astype(np.int32) << shift)
    return stages
