"""Projections (cl/project.h): bounds of the scores that cells can have, and other numbers that they need."""

from __future__ import annotations

import numpy as np

from clvol.device.empty_space import cell_bounds
from clvol.device.memory import UNPERTURBED, Perturbation
from clvol.device.volume import ResidentVolume
from clvol.scene.resolve import ResolvedScene

LEVELS, LEVEL_SHIFT = 3, 2  # BOUND_... of cl/project.h
NO_SCORE = np.float32(-3e38)
# Of values, as a share of the largest, and of attenuated scores: several times float32's rounding.
_ROUNDING, _SCORE_ROUNDING = 4e-6, 1e-5


def sample_bounds(
    volume: ResidentVolume,
    resolved: ResolvedScene,
    perturbation: Perturbation = UNPERTURBED,
) -> tuple[np.float32, np.float32]:
    """The lowest and the highest value that a sample can have, in the values that kernels compute
    with, which clamp to it: rounding alone leads beyond."""
    lowest, highest = cell_bounds(volume, resolved.integration.filter, perturbation)
    there = lowest <= highest
    if not there.any():
        return np.float32(0.0), np.float32(0.0)
    return np.float32(lowest[there].min()), np.float32(highest[there].max())


def score_bounds(
    volume: ResidentVolume,
    resolved: ResolvedScene,
    perturbation: Perturbation = UNPERTURBED,
) -> np.ndarray:
    """float32 [n]: for each cell, then for cells 4 and 16 times as long, a bound of the score of any sample in
    it; ``NO_SCORE`` where no voxel is finite."""
    mode = resolved.integration.compositing
    lowest, highest = cell_bounds(volume, resolved.integration.filter, perturbation)
    first, last = sample_bounds(volume, resolved, perturbation)
    there = lowest <= highest
    lowest, highest = np.where(there, lowest, 0.0), np.where(there, highest, 0.0)
    margin = _ROUNDING * np.maximum(np.abs(lowest), np.abs(highest))
    margin = np.where(lowest == highest, 0.0, margin)  # a constant cell gives just its value
    if mode == "minimum":
        scores = -np.maximum(_rounded(lowest - margin, -1), first)
    else:
        scores = np.minimum(_rounded(highest + margin, 1), last)
    if mode == "attenuated-maximum":
        low, per_value = normalisation(volume, resolved)
        share = np.maximum((scores - low) * per_value, 0.0)
        scores = share * np.float32(1.0 + _SCORE_ROUNDING)
    level = np.where(there, scores, NO_SCORE).astype(np.float32)
    levels = [level]
    for _ in range(LEVELS - 1):
        levels.append(_coarser(levels[-1]))
    return np.concatenate([level.ravel() for level in levels])


def hidden_score(mode: str, gate: tuple[float, float]) -> float:
    """The score up to which nothing is visible; ``gate``: values between which something is."""
    low, high = gate
    if mode == "maximum" and np.isfinite(low):
        return float(low)
    if mode == "minimum" and np.isfinite(high):
        return -float(high)
    return float(NO_SCORE)


def normalisation(volume: ResidentVolume, resolved: ResolvedScene) -> tuple[np.float32, np.float32]:
    """(lowest value, 1 / range) of the volume, in the values that kernels compute with."""
    low, high = (float(v) for v in volume.values(resolved.data_range))
    return np.float32(low), np.float32(1.0 / (high - low) if high > low else 0.0)


def attenuation_a_step(resolved: ResolvedScene) -> float:
    """The exponent's increase by one step at the highest value."""
    grid = resolved.volume.grid
    lower, upper = grid.index_bounds()
    longest = ((np.asarray(upper) - lower) * np.asarray(grid.spacing)).max()
    step = resolved.integration.step * grid.smallest_edge
    return float(resolved.integration.attenuation * step / longest)


def _rounded(values: np.ndarray, direction: int) -> np.ndarray:
    """float32 ``values``, those that it does not hold rounded up (1) or down (-1)."""
    near = values.astype(np.float32)
    wrong = near < values if direction > 0 else near > values
    return np.where(wrong, np.nextafter(near, np.float32(direction * np.inf)), near)


def _coarser(level: np.ndarray) -> np.ndarray:
    """The maxima of groups of 4^3 cells."""
    for axis in range(3):
        starts = np.arange(0, level.shape[axis], 1 << LEVEL_SHIFT)
        level = np.maximum.reduceat(level, starts, axis=axis)
    return level
