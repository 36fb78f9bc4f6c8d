"""The pre-integrated segment against the integral of its definition, at 30 digits."""

from __future__ import annotations

import numpy as np
import pytest
from mpmath import mp, mpf

from clvol.transfer import TransferFunction
from clvol.transfer.preintegration import preintegrate

RED, GREEN, GREY = [1.0, 0.0, 0.0], [0.0, 0.8, 0.1], [0.3, 0.4, 0.5]
BELOW_ONE = np.nextafter(1.0, 0.0)


def exact(tf, s_front, s_back, length):
    """C = int c tau exp(-D) and A = 1 - exp(-D) by tanh-sinh quadrature, piece by piece."""
    with mp.workdps(30):
        s_f, s_b, unit = mpf(float(s_front)), mpf(float(s_back)), mpf(tf.opacity_unit)
        values = [mpf(float(v)) for v in tf.values]
        cuts = {mpf(0), mpf(1)}
        if s_f != s_b:
            cuts |= {w for w in ((v - s_f) / (s_b - s_f) for v in values) if 0 < w < 1}
        cuts = sorted(cuts)
        color, depth = [mpf(0)] * 3, mpf(0)

        def region_of(s):
            return sum(1 for v in values if v <= s)

        for a, b in zip(cuts, cuts[1:]):
            r = region_of(s_f + (a + b) / 2 * (s_b - s_f))
            near, far = max(r - 1, 0), min(r, len(values) - 1)
            gap = values[far] - values[near]

            def place(x):
                s = s_f + (a + x * (b - a)) * (s_b - s_f)
                return (s - values[near]) / gap if gap > 0 else mpf(0)

            def along(table, x):
                low, high = mpf(float(table[near])), mpf(float(table[far]))
                return low + place(x) * (high - low)

            amount = mpf(float(length)) / unit * (b - a)
            q = lambda x: 1 - along(tf.opacities, x)  # noqa: E731
            q_a, q_b = q(mpf(0)), q(mpf(1))
            if abs(q_a) < mpf(10) ** -25 and abs(q_b) < mpf(10) ** -25:
                for k in range(3):
                    color[k] += mp.exp(-depth) * along(tf.colors[:, k], mpf(0))
                return np.array([float(c) for c in color] + [1.0])

            def antiderivative(y):
                return y - y * mp.log(y) if y > mpf(10) ** -29 else mpf(0)

            def passed(x):
                y = q(x)
                if abs(y - q_a) <= mpf(10) ** -12 * q_a:
                    mean = max((y + q_a) / 2, mpf(10) ** -29)
                    spread = (y - q_a) / (2 * mean)
                    return amount * x * (spread**2 / 6 - mp.log(mean))
                return amount * x * (antiderivative(y) - antiderivative(q_a)) / (y - q_a)

            # Dense cuts where a deep piece has all its light.
            deep = [mpf(10) ** -k for k in range(14, 0, -1)] if amount > 20 else []
            xs = [mpf(0), *deep, mpf(1) / 2, mpf(1)]
            for k in range(3):
                light = lambda x: (  # noqa: E731
                    along(tf.colors[:, k], x) * -amount * mp.log(max(q(x), mpf(10) ** -29))
                    * mp.exp(-passed(x))
                )
                if tf.colors[near, k] or tf.colors[far, k]:
                    color[k] += mp.exp(-depth) * mp.quad(light, xs, maxdegree=7)
            depth += passed(mpf(1))
        return np.array([float(c) for c in color] + [float(-mp.expm1(-depth))])


SMOOTH = TransferFunction([0.0, 40.0, 100.0], [0.0, 0.3, 0.8], [GREY, RED, GREEN], 0.7)
TO_ONE = TransferFunction([0.0, 10.0], [0.0, 1.0], [RED, GREEN])
FROM_ONE_WITHIN = TransferFunction([0.0, 1.0, 10.0], [1.0, 1.0, 0.2], [RED, GREY, GREEN])
ALMOST_ONE = TransferFunction([0.0, 10.0], [0.2, 1.0 - 1e-7], [RED, GREEN])
ALL_ALMOST_ONE = TransferFunction([0.0, 10.0], [1.0 - 1e-7, BELOW_ONE], [RED, GREEN])
ALMOST_ZERO = TransferFunction([0.0, 10.0], [1e-7, 3e-9], [RED, GREEN])
STEP = TransferFunction([0.0, 5.0, 5.0, 10.0], [0.1, 0.2, 0.9, 0.4], [RED, GREY, GREEN, RED])
STEP_TO_ONE = TransferFunction([0.0, 5.0, 5.0, 10.0], [0.1, 0.2, 1.0, 1.0], [RED, GREY, GREEN, RED])
PEAK = TransferFunction([4.999, 5.0, 5.001], [0.0, 0.99, 0.0], [RED, GREEN, GREY])
CLOSE_POINTS = TransferFunction([0.0, 1e-30, 2.0], [0.0, 0.5, 0.9], [RED, GREEN, GREY])

CASES = {
    "rising over a control point": (SMOOTH, 10.0, 90.0, 1.3),
    "falling over a control point": (SMOOTH, 90.0, 10.0, 1.3),
    "from below the first to above the last point": (SMOOTH, -50.0, 250.0, 2.0),
    "outside the points": (SMOOTH, 150.0, 130.0, 0.5),
    "one value": (SMOOTH, 33.0, 33.0, 0.9),
    "one ulp apart": (SMOOTH, 33.0, np.nextafter(33.0, 34.0), 0.9),
    "one ulp across a control point": (SMOOTH, np.nextafter(40.0, 0.0), 40.0, 0.9),
    "thin": (SMOOTH, 10.0, 90.0, 1e-12),
    "thick": (SMOOTH, 90.0, 10.0, 1e6),
    "very thick, from transparent": (SMOOTH, 0.0, 30.0, 1e12),
    "opacity rises to 1": (TO_ONE, 2.0, 10.0, 0.8),
    "opacity falls from 1": (TO_ONE, 10.0, 2.0, 0.8),
    "opacity falls from 1, thick": (TO_ONE, 10.0, 2.0, 30.0),
    "opacity rises through 1": (TO_ONE, 2.0, 14.0, 0.8),
    "opacity rises to 1, thick": (TO_ONE, 0.0, 10.0, 300.0),
    "ends just short of opacity 1": (TO_ONE, 2.0, np.nextafter(10.0, 0.0), 0.8),
    "enters a stretch of opacity 1": (FROM_ONE_WITHIN, 9.0, 0.5, 0.6),
    "starts in a stretch of opacity 1": (FROM_ONE_WITHIN, 0.25, 9.0, 0.6),
    "opacity to 1e-7 below 1": (ALMOST_ONE, 0.0, 10.0, 1.0),
    "opacity within 1e-7 of 1": (ALL_ALMOST_ONE, 0.0, 10.0, 0.01),
    "opacity within 1e-7 of 0": (ALMOST_ZERO, 0.0, 10.0, 1.0),
    "opacity within 1e-7 of 0, long": (ALMOST_ZERO, 10.0, 0.0, 1e8),
    "up a step": (STEP, 2.0, 8.0, 1.1),
    "down a step": (STEP, 8.0, 2.0, 1.1),
    "at exactly a step": (STEP, 5.0, 5.0, 1.1),
    "onto a step": (STEP, 2.0, 5.0, 1.1),
    "step to opacity 1": (STEP_TO_ONE, 2.0, 8.0, 1.1),
    "out of opacity 1 down a step": (STEP_TO_ONE, 8.0, 2.0, 1.1),
    "narrow peak": (PEAK, 0.0, 10.0, 100.0),
    "control points 1e-30 apart": (CLOSE_POINTS, -1.0, 1.0, 1.0),
}


@pytest.mark.parametrize("case", CASES)
def test_equals_the_integral(case):
    tf, s_front, s_back, length = CASES[case]
    got = preintegrate(tf, s_front, s_back, length)
    np.testing.assert_allclose(got, exact(tf, s_front, s_back, length), rtol=0, atol=1e-12)


def test_small_opacities_keep_their_digits():
    tf, s_front, s_back, length = ALMOST_ZERO, 1.0, 9.0, 1e-6
    got = preintegrate(tf, s_front, s_back, length)
    np.testing.assert_allclose(got, exact(tf, s_front, s_back, length), rtol=1e-8, atol=0)
    assert 0 < got[3] < 1e-12


def test_shapes_broadcast():
    s = np.linspace(-10.0, 110.0, 7)
    table = preintegrate(SMOOTH, s[:, None], s[None, :], 0.5)
    assert table.shape == (7, 7, 4)
    one = preintegrate(SMOOTH, s[1], s[5], 0.5)
    assert one.shape == (4,)
    np.testing.assert_allclose(table[1, 5], one, rtol=0, atol=1e-15)


def test_many_segments_equal_single_ones():
    rng = np.random.default_rng(5)
    s_front, s_back = rng.uniform(-2.0, 12.0, (2, 200))
    length = 10.0 ** rng.uniform(-6, 6, 200)
    together = preintegrate(STEP_TO_ONE, s_front, s_back, length)
    alone = [preintegrate(STEP_TO_ONE, *segment) for segment in zip(s_front, s_back, length)]
    np.testing.assert_allclose(together, alone, rtol=0, atol=1e-15)


def test_two_halves_composite_to_the_whole():
    rng = np.random.default_rng(6)
    for tf in (SMOOTH, TO_ONE, STEP, FROM_ONE_WITHIN, PEAK):
        s_front, s_back = rng.uniform(-2.0, 14.0, (2, 300))
        length = 10.0 ** rng.uniform(-3, 3, 300)
        share = rng.uniform(0.05, 0.95, 300)
        middle = s_front + share * (s_back - s_front)
        near = preintegrate(tf, s_front, middle, share * length)
        far = preintegrate(tf, middle, s_back, (1 - share) * length)
        whole = preintegrate(tf, s_front, s_back, length)
        np.testing.assert_allclose(near + (1 - near[:, 3:]) * far, whole, rtol=0, atol=1e-11)


def test_bounded_by_the_transfer_function():
    rng = np.random.default_rng(7)
    s_front, s_back = rng.uniform(-2.0, 12.0, (2, 2000))
    rgba = preintegrate(STEP_TO_ONE, s_front, s_back, 10.0 ** rng.uniform(-12, 12, 2000))
    assert np.isfinite(rgba).all()
    assert rgba.min() >= 0.0 and rgba.max() <= 1.0 + 1e-15
    assert np.all(rgba[:, :3] <= rgba[:, 3:] + 1e-14)


def test_nothing_is_seen_of_no_length_or_no_value():
    s_front, s_back = [10.0, np.nan, 3.0, np.inf], [10.0, 3.0, np.nan, 0.0]
    nothing = preintegrate(TO_ONE, s_front, s_back, [0, 1, 1, 1])
    assert np.array_equal(nothing, np.zeros((4, 4)))
