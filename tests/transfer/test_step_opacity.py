"""The opacity of a step through one value as a polynomial (clvol/transfer/step_opacity.py)."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.transfer.step_opacity import TERMS, step_opacity


def opacity_of(a, units):
    """float64 [n]: by the coefficients, in single precision as kernels compute."""
    coefficients, limit = step_opacity(units)
    assert len(coefficients) == TERMS and a.max() <= limit
    p = np.zeros(a.size, np.float32)
    for c in coefficients[::-1]:
        p = p * a.astype(np.float32) + np.float32(c)
    return (p * a.astype(np.float32)).astype(np.float64)


@pytest.mark.parametrize("units", [1e-30, 1e-6, 0.03125, 0.25, 0.7, 0.9958, 1.0, 1.01, 2.0, 3.5, 8.0, 20.0, 50.0])
def test_the_polynomial_is_the_opacity_to_single_precision(units):
    limit = step_opacity(units)[1]
    assert limit >= 0.025
    rng = np.random.default_rng(2)
    a = np.concatenate([limit * rng.random(4000), limit * 10.0 ** -rng.uniform(0, 20, 1000)])
    a = np.minimum(a, np.float32(limit)).astype(np.float32).astype(np.float64)
    exact = -np.expm1(units * np.log1p(-np.minimum(a, 1.0)))
    np.testing.assert_allclose(opacity_of(a, units), exact, rtol=4e-7, atol=1e-38)


def test_one_unit_is_the_opacity_itself_up_to_opaque():
    assert step_opacity(1.0) == ((1.0, *[0.0] * (TERMS - 1)), 1.0)


@pytest.mark.parametrize("units", [200.0, 1e6, 1e30])
def test_many_units_have_no_polynomial(units):
    assert step_opacity(units)[1] == 0.0
