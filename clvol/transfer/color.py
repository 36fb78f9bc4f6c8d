"""sRGB to linear light and back: the piecewise curve of IEC 61966-2-1, in float64.

The standard's rounded constants leave a gap of 1e-8 where the pieces meet. The curve is therefore
cut at the encoded value 0.04045 in both directions, which makes each function the other's inverse.
"""

from __future__ import annotations

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
