"""Rate control: how many stages are worth their codebooks, and the multiplier that meets a target."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from clvol.encoding.block_encoder import CodeEncoder
from clvol.encoding.draws import DrawnBlocks
from clvol.encoding.policy import LARGEST_LAMBDA, Goal
from clvol.encoding.stages import Survey
from clvol.store.codecs.coded_blocks import ENTRIES, Codebooks, CodedBlocks

INDEX_BITS = 32  # of each block, where its bytes are
CODEBOOK_BITS = 8 * (ENTRIES * 64 + 4)  # of a stage of 4^3 samples
_STEPS = 128  # of the multiplier, per factor of two
LAST_STEP = _STEPS * 40
_ROWS = 1 << 15  # sub-blocks on which numbers of stages are compared

Decode = Callable[[CodedBlocks, int, Codebooks], np.ndarray]


def _powers() -> list[int]:
    """2^(k / 128) for k = 0 ... 127, in units of 2^-60, by integers alone."""
    root = 2 << 60
    for _ in range(7):
        root = math.isqrt(root << 60)
    powers = [1 << 60]
    while len(powers) < _STEPS:
        powers.append(powers[-1] * root >> 60)
    return powers


_POWERS = _powers()


def multiplier(step: int) -> int:
    """The Lagrangian multiplier 2^(step / 128), rounded down."""
    return min(LARGEST_LAMBDA, _POWERS[step % _STEPS] << step // _STEPS >> 60)


def step_of(lagrangian: int) -> int:
    """The first step whose multiplier is at least ``lagrangian``."""
    return next((step for step in range(LAST_STEP) if multiplier(step) >= lagrangian), LAST_STEP)


@dataclass(frozen=True)
class Chosen:
    """The number of stages, and a first guess at the multiplier."""

    stages: int
    lagrangian: int


class StageCosts:
    """What stages cost at ``goal``, codebooks counted, as they are trained: bits, or the error where bits are given.
    ``raw_bits``: per voxel; ``share``: of the volume's voxels that were drawn."""

    def __init__(self, found: Survey, goal: Goal, raw_bits: int, share: float) -> None:
        self._found, self._goal, self._raw_bits, self._book = found, goal, raw_bits, CODEBOOK_BITS * share
        self._costs: list[tuple[float, int]] = []  # of 0, 1, ... stages: the cost, and a step of the multiplier

    def add(self, squares: np.ndarray, largest: np.ndarray, stands_for: float) -> bool:
        """Takes the errors by depth, int64 [pool, stages + 1], with one stage more than before; whether further stages
        are unlikely to pay: two in turn have cost more than they saved."""
        thin, count = max(1, len(squares) // _ROWS), len(self._costs)
        tables = _Tables(squares[::thin], largest[::thin], stands_for * thin, self._found)
        if self._goal.bound is not None:
            cost = _bits_within(tables, self._goal.bound, count, self._raw_bits) + count * self._book
            self._costs.append((cost, 0))
        else:
            self._costs.append(tables.at_goal(self._goal, count, count * self._book))
        last = [cost for cost, _ in self._costs[-3:]]
        return len(last) == 3 and last[0] < last[1] < last[2] < math.inf

    def chosen(self) -> Chosen:
        """The number of stages of the least cost."""
        cost, step = min(self._costs, key=lambda each: each[0], default=(0.0, 0))
        if math.isinf(cost):  # out of reach: all there is, or of a rate, nothing
            return Chosen(len(self._costs) - 1, 1) if self._goal.squares is not None else Chosen(0, LARGEST_LAMBDA)
        stages = [cost for cost, _ in self._costs].index(cost) if self._costs else 0
        return Chosen(stages, multiplier(step))


@dataclass(frozen=True, eq=False)
class _Tables:
    """Errors by depth of some sub-blocks, each of which stands for ``stands_for``: squared and largest, int64
    [n, stages + 1]."""

    squares: np.ndarray
    largest: np.ndarray
    stands_for: float
    found: Survey

    def at_goal(self, goal: Goal, count: int, books: float) -> tuple[float, int]:
        """Bits (or the squared error, where the bits are given) at ``goal`` with ``count`` stages, whose codebooks have
        ``books`` bits; and a step of the multiplier near it. Infinite bits or error if the goal is out of reach."""
        rest = max(0.0, float(self.found.apart[:, :, 0].sum()) - int(self.squares[:, 0].sum()) * self.stands_for)
        rows, depth = np.arange(len(self.squares)), np.arange(count + 1)

        def point(step: int) -> tuple[float, float]:
            choice = (256 * self.squares[:, : count + 1] + multiplier(step) * 8 * depth).argmin(axis=1)
            error = int(self.squares[rows, choice].sum()) * self.stands_for + rest
            bits = (8 * int(choice.sum()) + 12 * len(rows)) * self.stands_for + books
            return error, bits

        # The error rises with the step, bits fall: one of them has a limit.
        limited, limit = (0, goal.squares * self.found.samples) if goal.squares is not None else (
            1, (goal.bits or 0.0) * self.found.voxels)  # fmt: skip
        good, bad = (0, LAST_STEP) if limited == 0 else (LAST_STEP, 0)
        if point(good)[limited] > limit:
            return math.inf, good
        if point(bad)[limited] <= limit:
            return point(bad)[1 - limited], bad
        while abs(good - bad) > 16:
            middle = (good + bad) // 2
            if point(middle)[limited] <= limit:
                good = middle
            else:
                bad = middle
        one, other = point(good), point(bad)
        reached = (limit - one[limited]) / max(other[limited] - one[limited], 1e-300)
        return one[1 - limited] + reached * (other[1 - limited] - one[1 - limited]), good


def _bits_within(tables: _Tables, bound: int, count: int, raw_bits: int) -> float:
    """Bits of sub-blocks within ``bound`` by up to ``count`` stages, or packed residuals, or raw."""
    largest = tables.largest[:, : count + 1]
    depth = np.arange(count + 1)
    steps = (largest + max(bound, 0)) // (2 * max(bound, 0) + 1)
    width = np.where(steps > 0, np.frexp(steps)[1] + 1, 0)
    bits = np.where(width <= 8, 8 + 8 * depth + 64 * width, 8 + 64 * raw_bits)
    bits = np.where(largest <= bound, 8 * depth, bits)
    return int(np.minimum(bits.min(axis=1), 8 + 64 * raw_bits).sum()) * tables.stands_for


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


def squared_steps(encoder: CodeEncoder, voxels: np.ndarray, decoded: np.ndarray, own: np.ndarray) -> int:
    """The sum of squared differences in the encoder's unit, of finite voxels that are ``own``."""
    counted = own & np.isfinite(voxels)
    one, other = decoded[counted], voxels[counted]
    values = encoder.codebooks.values
    if values.is_float:
        one, other = values.encoded(one), values.encoded(other)
    off = one.astype(np.int64) - other.astype(np.int64)
    return int((off * off).sum())


def excess(found: Measured, goal: Goal, books: Codebooks, total: int) -> float:
    """How far blocks like those measured, in a volume of ``total`` voxels, are from ``goal``: the ratio of errors or
    bits, 1 and less if they meet it."""
    if goal.squares is not None:
        return found.squares / goal.squares if goal.squares else (math.inf if found.squares else 0.0)
    assert goal.bits is not None
    left = goal.bits - 8 * books.nbytes / total
    return found.bits / left if left > 0 else math.inf


def found_step(ratio: Callable[[int], float], start: int, falls: bool, near: float) -> int:
    """A step for which ``ratio(step)`` is at most 1, and at least ``near`` where steps are that fine. The ratio rises
    with the step, or ``falls``. The end of the range where nothing is left but that.

    The secant's next step where it lies between the steps known to be good and bad, else the middle.
    """
    sign = -1 if falls else 1
    good, bad = (-1, LAST_STEP + 1) if sign > 0 else (LAST_STEP + 1, -1)
    step = min(max(start, 0), LAST_STEP)
    slope = sign * 0.6 / _STEPS  # of the ratio's logarithm to base 2
    while True:
        found = ratio(step)
        if found <= 1:
            good = step
            if found >= near:
                return step
        else:
            bad = step
        low, high = min(good, bad) + 1, max(good, bad) - 1
        if low > high:
            return min(max(good, 0), LAST_STEP)
        if 0 < found < math.inf:
            # A little to the good side, so that the next step meets the target.
            aim = math.log2(found) - math.log2((1 + near) / 2)
            step = round(step - aim / slope)
        else:
            step = (low + high) // 2
        if not low <= step <= high:
            step = low if step < low else high
            if high - low > 4 and bad not in (-1, LAST_STEP + 1) and good not in (-1, LAST_STEP + 1):
                step = (low + high) // 2
