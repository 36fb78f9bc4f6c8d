"""CIELUV: what others compute, and stable at black."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.color import rgb2luv

from clvol.integrators.multiresolution.luv import delta_e_luv, linear_to_luv
from clvol.transfer import linear_to_srgb

COLORS = np.random.default_rng(0).random((500, 3))


@pytest.fixture(autouse=True)
def _no_warnings():
    with np.errstate(all="raise"):
        yield


def test_agrees_with_scikit_image_away_from_black():
    colors = COLORS[COLORS.max(axis=1) > 0.02]
    np.testing.assert_allclose(linear_to_luv(colors), rgb2luv(linear_to_srgb(colors)), atol=0.02)


def test_white_is_100_and_grey_has_no_chroma():
    grey = np.linspace(0, 1, 101)[:, None] * np.ones(3)
    luv = linear_to_luv(grey)
    assert luv[-1, 0] == pytest.approx(100.0, abs=1e-9)
    assert np.abs(luv[:, 1:]).max() < 1e-9


def test_lightness_rises_with_every_channel():
    base = linear_to_luv(COLORS)[:, 0]
    for channel in range(3):
        assert (linear_to_luv(COLORS + 0.01 * np.eye(3)[channel])[:, 0] > base).all()


def test_all_colors_go_to_black_continuously():
    scales = 10.0 ** -np.arange(1, 300, 7.0)
    luv = linear_to_luv(scales[:, None, None] * COLORS)
    size = np.abs(luv).sum(axis=-1)
    assert np.isfinite(luv).all()
    # kappa = 903.3 times the luminance, and a bounded chromaticity times it.
    assert (size[3:] <= 1e5 * scales[3:, None]).all()
    assert (np.diff(size, axis=0) < 0).all()


def test_the_linear_part_meets_the_curve():
    y = 216.0 / 24389.0
    below, above = (linear_to_luv(np.full(3, y * t))[0] for t in (1 - 1e-12, 1 + 1e-12))
    assert above - below < 1e-9 and above == pytest.approx(8.0)


def test_black_and_below_are_nothing():
    assert (linear_to_luv(np.zeros((2, 3))) == 0).all()
    assert (linear_to_luv([-1.0, -0.5, 0.0]) == 0).all()
    with np.errstate(under="ignore"):
        assert np.isfinite(linear_to_luv([5e-324, 0, 0])).all()


def test_difference_is_a_distance():
    luv = linear_to_luv(COLORS)
    a, b, c = luv[:-2], luv[1:-1], luv[2:]
    assert (delta_e_luv(a, a) == 0).all()
    np.testing.assert_array_equal(delta_e_luv(a, b), delta_e_luv(b, a))
    assert (delta_e_luv(a, c) <= delta_e_luv(a, b) + delta_e_luv(b, c) + 1e-9).all()
    assert delta_e_luv(linear_to_luv(np.ones(3)), linear_to_luv(np.zeros(3))) == pytest.approx(100)
