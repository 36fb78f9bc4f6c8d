"""sRGB to linear light and back: the piecewise curve of IEC 61966-2-1, in float64.

The standard's rounded constants leave a gap of 1e-8 where the pieces meet. The curve is therefore
cut at the encoded value 0.04045 in both directions, which makes each function the other's inverse.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

_CUT_ENCODED = 0.04045
_CUT_LINEAR = _CUT_ENCODED / 12.92


def srgb_to_linear(encoded: ArrayLike) -> np.ndarray:
    """Decode sRGB-encoded values (any shape, black 0, white 1) to linear light, float64."""
    v = np.asarray(encoded, dtype=np.float64)
    curve = ((np.maximum(v, _CUT_ENCODED) + 0.055) / 1.055) ** 2.4
    return np.where(v <= _CUT_ENCODED, v / 12.92, curve)


def linear_to_srgb(linear: ArrayLike) -> np.ndarray:
    """Encode linear light (any shape, black 0, white 1) as sRGB values, float64; no clipping."""
    v = np.asarray(linear, dtype=np.float64)
    curve = 1.055 * np.maximum(v, _CUT_LINEAR) ** (1.0 / 2.4) - 0.055
    return np.where(v <= _CUT_LINEAR, v * 12.92, curve)


_BINS = 4096  # of light: narrower than any level of 8 bits, so that none holds two bounds of levels
_NEAR = 1e-9  # light as near to a bound is encoded by the curve itself


def srgb_levels(linear: np.ndarray) -> np.ndarray:
    """uint8: floor(255 ``linear_to_srgb(linear)`` + 1/2) of float64 light from 0 to 1 (any shape), without powers: by
    the bound between two levels, if there is one, in the light's bin."""
    levels, bounds = _levels_by_bin()
    at = (linear * _BINS).astype(np.intp)
    bound = bounds.take(at)
    out: np.ndarray = levels.take(at) + (linear >= bound)
    bound -= linear
    if np.abs(bound, out=bound).min(initial=1.0) < _NEAR:
        near = bound < _NEAR
        out[near] = _rounded(linear[near])
    return out


def _rounded(linear: np.ndarray) -> np.ndarray:
    return np.floor(255.0 * linear_to_srgb(linear) + 0.5).astype(np.uint8)


@cache
def _levels_by_bin() -> tuple[np.ndarray, np.ndarray]:
    """uint8, float64 [_BINS + 1]: the level at the beginning of each bin of light, and the light from which on it is
    the next one; 2 where it is not."""
    bounds = srgb_to_linear((np.arange(1, 256) - 0.5) / 255.0)
    levels = np.searchsorted(bounds, np.arange(_BINS + 1) / _BINS, side="right").astype(np.uint8)
    of_bins = np.full(_BINS + 1, 2.0)
    of_bins[(bounds * _BINS).astype(int)] = bounds
    return levels, of_bins
