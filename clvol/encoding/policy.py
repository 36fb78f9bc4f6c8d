"""How codes are chosen: the Lagrangian multiplier or the bound, as stored with a training."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from clvol.encoding.kernels import NO_BOUND
from clvol.store.codecs.coded_blocks import RateTarget
from clvol.store.codecs.working_values import LARGEST, WorkingValues

_LARGEST_PACKED = LARGEST // 2  # residual steps are 2 packed + 1
LARGEST_LAMBDA = 1 << 40
_ROUNDED = 0.25  # squared error of working values of floating-point voxels, at most
_EXACT_FLOAT = 2.0**-24  # relative rounding of a decoded voxel


@dataclass(frozen=True)
class Policy:
    """What is minimised for each sub-block, octant and block: 256 D + ``lagrangian`` R, or R alone where ``bound`` is
    given.

    D: sum of squared errors of decoded voxels, in steps of integer types or working values of floating-point types; R:
    bits. ``bound``: the largest error of any voxel in that unit; -1 if even the best working value may be further off
    (blocks are then raw, or constant). ``raw``: whether blocks may be raw where that is not smaller. ``beam``:
    sequences of codes that the search keeps, 1, 2 or 4.
    """

    lagrangian: int = 1
    bound: int | None = None
    raw: bool = True
    beam: int = 1

    @property
    def weight(self) -> int:
        """Of D, in the unit of the cost."""
        return 256 if self.bound is None else 0

    @property
    def packed(self) -> int:
        """The bound of packed residuals: 0 (exact) where errors are weighed, -1 if there are none."""
        return 0 if self.bound is None else min(self.bound, _LARGEST_PACKED)

    @property
    def residual_step(self) -> int:
        return 2 * max(self.packed, 0) + 1

    def per_block(self, weights: np.ndarray | None, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Multipliers int64 [count] and bounds int32 [count] of blocks whose errors count ``weights`` [count] times (1
        of all if None). A block of weight 0 may become anything."""
        if weights is None:
            bound = NO_BOUND if self.bound is None else max(self.bound, 0)
            return np.full(count, self.lagrangian, np.int64), np.full(count, bound, np.int32)
        weights = np.maximum(np.asarray(weights, np.float64), 1e-30)
        lambdas = np.full(count, self.lagrangian, np.int64)
        bounds = np.full(count, NO_BOUND, np.int32)
        if self.bound is None:
            lambdas = np.clip(np.rint(self.lagrangian / weights), 1, LARGEST_LAMBDA).astype(np.int64)
        else:
            bounds = np.minimum(np.floor(max(self.bound, 0) / np.sqrt(weights)), NO_BOUND).astype(np.int32)
        return lambdas, bounds

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, own: dict[str, Any]) -> Policy:
        bound = own["bound"]
        return cls(int(own["lagrangian"]), None if bound is None else int(bound), bool(own["raw"]), int(own["beam"]))


def bound_of(share: float, values: WorkingValues, value_range: tuple[float, float]) -> int:
    """The largest ``Policy.bound`` with which no voxel is further off than ``share`` of the range."""
    span = value_range[1] - value_range[0]
    if not values.is_float:
        return math.floor(share * span * (1 + 1e-12))
    # Half a step by which working values are rounded, and the rounding of float32.
    rounding = 0.5 + 1e-6 + _EXACT_FLOAT * max(abs(values.first), abs(values.first + LARGEST))
    return max(-1, math.floor(share * span / values.scale - rounding))


@dataclass(frozen=True)
class Goal:
    """A target in the encoder's units; one of the three, or none at all where only codebooks are wanted.

    ``bound``: as of ``Policy``. ``squares``: the mean squared error at most. ``bits``: per voxel at most, of blocks,
    index and codebooks.
    """

    bound: int | None = None
    squares: float | None = None
    bits: float | None = None

    def needs(self, squares: np.ndarray, largest: np.ndarray, lagrangian: int) -> np.ndarray:
        """bool [n]: for which sub-blocks of the given errors one more stage is likely to be worth its eight bits: it
        takes a quarter of the squared error."""
        if self.bound is not None:
            return largest > self.bound
        # The guess at the multiplier is rougher where bits are given.
        return 256 * squares > (32 if self.squares is not None else 16) * lagrangian


def goal_of(target: RateTarget, values: WorkingValues, value_range: tuple[float, float]) -> Goal:
    if target.max_voxel_error is not None:
        return Goal(bound=bound_of(target.max_voxel_error, values, value_range))
    if target.psnr is not None:
        peak = (value_range[1] - value_range[0]) / values.scale  # 1 of integers
        squares = peak**2 * 10 ** (-target.psnr / 10)
        if values.is_float:
            squares -= _ROUNDED  # which codes do not see
        return Goal(squares=squares) if squares >= 0 else Goal(bound=-1)
    return Goal(bits=target.bits_per_voxel)
