"""Bounds that always hold for the values and gradients that the reconstruction of a volume can take."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clvol.features.vocabulary import SLOPES, WEIGHTS, overshoot
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction

# A prefilter whose rows have absolute values that sum to L leaves the range of the voxels by at
# most (L - 1) / 2 of it on either side. Along an axis L is 3 or less: the B-spline's samples, of
# which the prefilter is the inverse, are (1, 4, 1) / 6 in each row, dominated by the diagonal.
_COEFFICIENTS = 3.0**3
_ROUNDING = 1.05  # for quantised gradients


def field_overshoot(scene: ResolvedScene) -> float:
    """The share of its range by which the field may exceed it on either side."""
    integration = scene.integration
    if integration.filter == "cubic" and integration.prefilter:
        return 0.5 * (_COEFFICIENTS - 1.0)
    return overshoot(integration.filter)


def reachable(scene: ResolvedScene) -> tuple[float, float]:
    """The range of values of all samples of the volume, including noise."""
    low, high = scene.volume.value_range
    largest = np.finfo(np.float64).max
    with np.errstate(over="ignore"):
        widen = field_overshoot(scene) * np.float64(high - low) + noise_reach(scene)
        return float(max(low - widen, -largest)), float(min(high + widen, largest))


def noise_reach(scene: ResolvedScene) -> float:
    """The largest change of a value by noise, whose tiles are within -1 and 1."""
    return sum(
        abs(noise.amplitude) * sum(noise.gain**k for k in range(noise.octaves))
        for noise in scene.noise
        if noise.target == "value"
    )


def shows(function: TransferFunction, low: ArrayLike, high: ArrayLike) -> np.ndarray:
    """bool [...]: whether any value from ``low`` to ``high`` [...] has opacity."""
    low, high = np.asarray(low), np.asarray(high)
    shown = function.values[function.opacities > 0]
    inside = np.searchsorted(shown, high, side="right") > np.searchsorted(shown, low, side="left")
    return np.asarray(inside | (function.opacity(low) > 0) | (function.opacity(high) > 0))


def steepest(scene: ResolvedScene) -> float:
    """An upper bound of the gradient magnitude, in value per world length; infinite with noise."""
    if scene.noise:
        return np.inf
    low, high = scene.volume.value_range
    # In ranges of the values an index: half of the absolute derivatives of the weights is what a range can give.
    share = 0.5 * SLOPES[scene.integration.filter] * WEIGHTS.get(scene.integration.filter, 1.0) ** 2
    if scene.integration.filter == "cubic" and scene.integration.prefilter:
        share *= _COEFFICIENTS
    to_index = scene.volume.grid.world_to_index()[:3, :3]
    with np.errstate(over="ignore"):
        return float(
            _ROUNDING * share * np.float64(high - low) * np.linalg.norm(to_index, axis=1).sum()
        )


def range_text(scene: ResolvedScene) -> str:
    low, high = scene.axis.span(scene.volume.value_range)
    return f"{low:g} to {high:g}"
