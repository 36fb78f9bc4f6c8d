"""Rate control: how many stages are worth their codebooks, and the multiplier that meets a target."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from clvol.encoding.block_encoder import CodeEncoder
from clvol.encoding.draws import DrawnBlocks
from clvol.encoding.policy import LARGEST_LAMBDA, Goal
from clvol.encoding.stages import Stages, Survey
from clvol.store.codecs.coded_blocks import ENTRIES, Codebooks, CodedBlocks

INDEX_BITS = 32  # of each block, where its bytes are
CODEBOOK_BITS = 8 * (ENTRIES * 64 + 4)  # of a stage of 4^3 samples
_STEPS = 32  # of the multiplier, per factor of two
_MOST = _STEPS * 40

Decode = Callable[[CodedBlocks, int, Codebooks], np.ndarray]


def multiplier(step: int) -> int:
    """The Lagrangian multiplier 2^(step / 32)."""
    return min(LARGEST_LAMBDA, max(1, round(2 ** (step / _STEPS))))


def step_of(lagrangian: int) -> int:
    return round(_STEPS * math.log2(max(1, lagrangian)))


@dataclass(frozen=True)
class Chosen:
    """The number of stages, and a first guess at the multiplier."""

    stages: int
    lagrangian: int


def stages_worth(stages: Stages, found: Survey, goal: Goal, raw_bits: int, share: float) -> Chosen:
    """The number of stages with the fewest bits, codebooks counted, at ``goal`` (or the least error, where the bits are
    given). ``raw_bits``: per voxel; ``share``: of the volume's voxels that were drawn."""
    number = stages.squares.shape[1]
    book = CODEBOOK_BITS * share
    if goal.bound is not None:
        costs = [
            _bits_within(stages, goal.bound, count, raw_bits) * stages.stands_for + count * book
            for count in range(number)
        ]
        return Chosen(int(np.argmin(costs)), 1)
    pool = stages.squares.shape[0] * stages.stands_for
    rest = max(0.0, float(found.apart[:, :, 0].sum()) - float(stages.squares[:, 0].sum()) * stages.stands_for)
    best = (math.inf, 0, 1)
    for count in range(number):
        points = []
        for step in range(0, _MOST, 8):
            lagrangian = multiplier(step)
            depth = np.arange(count + 1)
            choice = (256 * stages.squares[:, : count + 1] + lagrangian * 8 * depth).argmin(axis=1)
            error = stages.squares[np.arange(len(choice)), choice].sum() * stages.stands_for + rest
            bits = 8 * choice.sum() * stages.stands_for + 12 * pool + count * book
            points.append((float(error), float(bits), lagrangian))
            if not choice.any():
                break
        errors, rates, multipliers = (np.array(column) for column in zip(*points))
        at = _meeting(errors, rates, goal, found.voxels)
        if at is None:
            continue
        cost = rates[at] if goal.squares is not None else errors[at]
        if cost < best[0]:
            best = (float(cost), count, int(multipliers[at]))
    if math.isinf(best[0]):  # out of reach: all there is, or nothing
        return Chosen(number - 1, 1) if goal.squares is not None else Chosen(0, multiplier(_MOST // 2))
    return Chosen(best[1], best[2])


def _meeting(errors: np.ndarray, rates: np.ndarray, goal: Goal, voxels: int) -> int | None:
    """The last point with a small enough error, or the first with few enough bits; None if there is none."""
    if goal.squares is not None:
        good = np.flatnonzero(errors <= goal.squares * voxels)
        return int(good[-1]) if len(good) else None
    assert goal.bits is not None
    good = np.flatnonzero(rates <= goal.bits * voxels)
    return int(good[0]) if len(good) else None


def _bits_within(stages: Stages, bound: int, count: int, raw_bits: int) -> float:
    """Bits of the pool's sub-blocks within ``bound`` by up to ``count`` stages, or packed residuals, or raw."""
    largest = stages.largest[:, : count + 1]
    depth = np.arange(count + 1)
    steps = (largest + max(bound, 0)) // (2 * max(bound, 0) + 1)
    width = np.where(steps > 0, np.ceil(np.log2(steps + 1)) + 1, 0)
    bits = np.where(width <= 8, 8 + 8 * depth + 64 * width, 8 + 64 * raw_bits)
    bits = np.where(largest <= bound, 8 * depth, bits)
    return float(np.minimum(bits.min(axis=1), 8 + 64 * raw_bits).sum())


@dataclass(frozen=True)
class Measured:
    """Of blocks as encoded: mean squared error in the encoder's unit and bits per voxel of the volume's own voxels,
    codebooks left out; ``voxels``: how many they are."""

    squares: float
    bits: float
    voxels: int


def measure(encoder: CodeEncoder, blocks: Iterable[DrawnBlocks], decode: Decode) -> Measured:
    """What ``encoder`` makes of ``blocks``; blocks that are padded are decoded, so that padding does not count."""
    squares, bits, voxels = 0.0, 0, 0
    for part in blocks:
        own = part.own
        padded = np.zeros(len(part.voxels), bool) if own is None else ~own.all(axis=(1, 2, 3))
        found = encoder.outcome(part.voxels)
        bits += int(found.bits.sum()) + INDEX_BITS * len(part.voxels)
        squares += float(found.squares[~padded].sum())
        voxels += part.voxels.size if own is None else int(own.sum())
        if own is not None:
            border = part.voxels[padded]
            decoded = decode(encoder.encode(border), border.shape[1], encoder.codebooks)
            squares += squared_steps(encoder, border, decoded, own[padded])
    return Measured(squares / voxels, bits / voxels, voxels)


def squared_steps(encoder: CodeEncoder, voxels: np.ndarray, decoded: np.ndarray, own: np.ndarray) -> float:
    """The sum of squared differences in the encoder's unit, of finite voxels that are ``own``."""
    counted = own & np.isfinite(voxels)
    off = (decoded[counted].astype(np.float64) - voxels[counted]) / encoder.codebooks.values.scale
    return float((off * off).sum())


def meets(found: Measured, goal: Goal, books: Codebooks, total: int) -> bool:
    """Whether blocks like those measured, in a volume of ``total`` voxels, meet ``goal``."""
    if goal.squares is not None:
        return found.squares <= goal.squares
    assert goal.bits is not None
    return found.bits + 8 * books.nbytes / total <= goal.bits


def found_step(at: Callable[[int], bool], start: int, falls: bool, width: int = 32) -> int:
    """The last step (``falls``: the first one) for which ``at(step)`` is true, where it is true up to some step (from
    some step on). Searched from ``start``, first ``width`` steps wide; the end of the range if it is true nowhere."""
    sign = -1 if falls else 1
    good, bad = None, None
    step = min(max(start, 0), _MOST)
    while good is None or bad is None:
        if at(step):
            good = step
            if step in (0, _MOST) and step == (_MOST if sign > 0 else 0):
                return step
            step = min(max(step + sign * width, 0), _MOST)
        else:
            bad = step
            if step == (0 if sign > 0 else _MOST):
                return step
            step = min(max(step - sign * width, 0), _MOST)
        width *= 2
    while abs(good - bad) > 1:
        middle = (good + bad) // 2
        if at(middle):
            good = middle
        else:
            bad = middle
    return good
