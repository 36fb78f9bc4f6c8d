"""CIELUV coordinates of linear sRGB colours.

CIE 15:2018 sec. 8.2.2; the linear part of L* is written with the exact fractions (CIE 15 rounds
them, which leaves a gap where the parts meet). The matrix is IEC 61966-2-1's to seven digits; the
white is the sum of its columns, so grey has u* = v* = 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
_EPSILON, _KAPPA = 216.0 / 24389.0, 24389.0 / 27.0


def _chromaticity_sums(xyz: np.ndarray) -> np.ndarray:
    return xyz[..., 0] + 15.0 * xyz[..., 1] + 3.0 * xyz[..., 2]


_WHITE = _XYZ.sum(axis=1)
_WHITE_UV = np.array([4.0, 9.0]) * _WHITE[:2] / _chromaticity_sums(_WHITE)


def linear_to_luv(linear: ArrayLike) -> np.ndarray:
    """L*, u*, v* [..., 3] float64 of linear sRGB [..., 3]; white (1, 1, 1) has L* = 100.

    Negative components count as 0. Towards black L* falls to 0 linearly with the luminance while
    the chromaticity stays bounded, so u* and v* fall to 0 with it; black has the chromaticity
    of white.
    """
    xyz = np.maximum(np.asarray(linear, np.float64), 0.0) @ _XYZ.T
    y = xyz[..., 1] / _WHITE[1]
    lightness = np.where(y > _EPSILON, 116.0 * np.cbrt(y) - 16.0, _KAPPA * y)
    sums = _chromaticity_sums(xyz)
    seen = (sums > 0)[..., None]
    divisors = np.where(seen, sums[..., None], 1.0)
    uv = np.where(seen, np.array([4.0, 9.0]) * xyz[..., :2] / divisors, _WHITE_UV)
    return np.concatenate(
        [lightness[..., None], 13.0 * lightness[..., None] * (uv - _WHITE_UV)], axis=-1
    )


def delta_e_luv(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Delta-E (CIE 1976 L*u*v*) [...] of L*, u*, v* [..., 3]: about 1 is just noticed."""
    difference = np.asarray(a) - np.asarray(b)
    return np.sqrt((difference * difference).sum(axis=-1))
