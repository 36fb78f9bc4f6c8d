"""The opacity of a step through one value, as a polynomial in the opacity that the transfer function states.

A value of opacity a over the unit has 1 - (1 - a)^u over u units. Kernels would need a logarithm and an exponential
for that power; but u is the same in a whole frame, so it is a function of a alone, analytic up to a = 1. The
polynomial holds up to a limit below that, as far as single precision can tell no difference.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

TERMS = 8  # of View in cl/view.h
_LIMITS = (1.0, 0.8, 0.65, 0.5, 0.45, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15, 0.1, 0.05, 0.025)
_ERROR = 1.5e-7  # relative, of what single precision makes of it


@lru_cache(maxsize=64)
def step_opacity(units: float) -> tuple[tuple[float, ...], float]:
    """(coefficients, limit) of the opacity of ``units`` opacity units: a (c[0] + c[1] a + ... + c[7] a^7) for opacities
    a of 0 to ``limit``, to single precision. The limit is 0 where no such polynomial is found.
    """
    if units == 1.0:
        return (1.0,) + (0.0,) * (TERMS - 1), 1.0
    for limit in _LIMITS:
        coefficients = _interpolated(units, limit)
        a = np.linspace(0.0, limit, 513)[1:]
        found, exact = np.zeros(a.size, np.float32), _share(a, units)
        for c in coefficients[::-1]:
            found = found * a.astype(np.float32) + c
        with np.errstate(invalid="ignore"):
            if np.all(np.abs(found - exact) <= _ERROR * exact):
                return tuple(map(float, coefficients)), limit
    return (0.0,) * TERMS, 0.0


def _share(a: np.ndarray, units: float) -> np.ndarray:
    """(1 - (1 - a)^units) / a for a > 0."""
    with np.errstate(divide="ignore"):
        return -np.expm1(units * np.log1p(-a)) / a


def _interpolated(units: float, limit: float) -> np.ndarray:
    """float32 [TERMS]: coefficients of the polynomial through the share at Chebyshev's points of 0 ... ``limit``."""
    points = 0.5 * limit * (1.0 - np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS))
    with np.errstate(over="ignore", under="ignore"):
        scaled = np.linalg.solve(np.vander(points / limit, increasing=True), _share(points, units))
        return (scaled / limit ** np.arange(TERMS)).astype(np.float32)
