"""The observed order of accuracy: what it accepts and, above all, what it does not."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.accuracy.convergence import FLOOR_MARGIN, Convergence
from clvol.errors import UsageError

H = tuple(2.0**-k for k in range(6))


def power(order, factor=0.3, h=H):
    return tuple(factor * step**order for step in h)


@pytest.mark.parametrize("order", [0.0, 0.5, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("ratio", [2.0, 1.5])
def test_a_power_law_shows_its_order(order, ratio):
    h = tuple(ratio**-k for k in range(6))
    found = Convergence(h, power(order, h=h))
    assert found.order == pytest.approx(order, abs=1e-12)
    np.testing.assert_allclose(found.local_orders, order, atol=1e-12)
    assert found.departure(order, 0.2) is None


@pytest.mark.parametrize("wrong", [0.0, 1.0, 1.7, 2.3, 3.0, 4.0])
def test_an_order_too_low_and_one_too_high_both_depart(wrong):
    assert "expected 2 within 0.2" in Convergence(H, power(wrong)).departure(2.0, 0.2)


def test_a_term_of_the_next_order_is_within_the_band():
    errors = tuple(h**2 * (1 + 0.3 * h) for h in H)
    assert Convergence(H, errors).departure(2.0, 0.2) is None


@pytest.mark.parametrize("plateau", [1e-3, 3e-4])
def test_errors_that_stop_falling_depart(plateau):
    errors = tuple(e + plateau for e in power(2.0))
    assert Convergence(H, errors).departure(2.0, 0.2)


def test_levels_that_cancel_in_the_fit_depart():
    h = H[:5]
    errors = np.array(power(2.0, h=h))
    errors[2] *= 3.0  # in the middle: the slope of the fit stays as it was
    found = Convergence(h, errors)
    assert found.order == pytest.approx(2.0)
    assert "from h = 0.5 to 0.25" in found.departure(2.0, 0.2)


def test_errors_have_to_stand_clear_of_the_floor():
    least = power(2.0)[-1]
    assert Convergence(H, power(2.0), 0.99 * least / FLOOR_MARGIN).departure(2.0, 0.2) is None
    departure = Convergence(H, power(2.0), 1.01 * least / FLOOR_MARGIN).departure(2.0, 0.2)
    assert "does not stand clear of the floor" in departure


@pytest.mark.parametrize(
    ("h", "errors", "floor", "where"),
    [
        (H, power(2.0)[:-1], 0.0, "h, errors"),
        (H[:3], power(2.0)[:3], 0.0, "h, errors"),
        (H[::-1], power(2.0), 0.0, "h"),
        (H, (0.0, *power(2.0)[1:]), 0.0, "errors"),
        (H, (np.nan, *power(2.0)[1:]), 0.0, "errors"),
        ((np.inf, *H[1:]), power(2.0), 0.0, "h"),
        (H, power(2.0), -1.0, "floor"),
        (H, power(2.0), np.nan, "floor"),
    ],
)
def test_what_is_no_convergence_is_refused(h, errors, floor, where):
    with pytest.raises(UsageError, match=f"^{where}:"):
        Convergence(h, errors, floor)
