"""The measures of difference: known values, symmetries, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clvol.accuracy.metrics import compare, delta_e, max_abs, psnr, rmse, ssim
from clvol.errors import UsageError
from clvol.transfer.color import srgb_to_linear


def picture(seed: int = 0, size: tuple[int, int] = (20, 30)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rgba = rng.random((*size, 4))
    rgba[..., :3] *= rgba[..., 3:]
    return rgba


def flat(red: float, green: float, blue: float, size: tuple[int, int] = (16, 16)) -> np.ndarray:
    """An opaque picture of one sRGB-encoded colour."""
    return np.broadcast_to([*srgb_to_linear([red, green, blue]), 1.0], (*size, 4))


def test_equal_pictures_have_no_difference():
    a = picture()
    assert compare(a, a.copy()) == {
        "rmse": 0.0, "max_abs": 0.0, "psnr": math.inf, "ssim": 1.0,
        "delta_e_mean": 0.0, "delta_e_max": 0.0,
    }


def test_one_differing_channel_counts_as_one_of_all():
    a = picture()
    b = a.copy()
    b[3, 4, 2] += 0.25
    assert max_abs(a, b) == 0.25
    assert rmse(a, b) == pytest.approx(0.25 / math.sqrt(a.size), rel=1e-14)


def test_alpha_counts_in_linear_light():
    a = np.zeros((4, 4, 4))
    b = a.copy()
    b[..., 3] = 0.5
    assert rmse(a, b) == 0.25 and max_abs(a, b) == 0.5
    assert psnr(a, b) == math.inf, "over black both display as black"
    assert psnr(a, b, background=(1.0, 1.0, 1.0)) < 20.0, "over white they do not"


def test_psnr_of_a_known_difference():
    assert psnr(flat(0.5, 0.5, 0.5), flat(0.6, 0.6, 0.6)) == pytest.approx(20.0, abs=1e-9)


def test_ssim_is_one_minus_nothing_for_equal_and_less_for_noise():
    a = picture(1)
    assert ssim(a, a) == 1.0
    noise = np.random.default_rng(2).normal(size=a.shape) * [0.05, 0.05, 0.05, 0.0]
    assert ssim(a, np.clip(a + 4 * noise, 0, 1)) < ssim(a, np.clip(a + noise, 0, 1)) < 1.0


def test_ciede2000_of_black_and_white_is_100():
    difference = delta_e(flat(0.0, 0.0, 0.0), flat(1.0, 1.0, 1.0))
    np.testing.assert_allclose(difference, 100.0, atol=0.01)


def test_ciede2000_of_greys_follows_the_formula():
    # Neutral colours differ in lightness alone: dE = dL / (1 + 0.015 (L-50)^2 / sqrt(20+(L-50)^2)).
    def lightness(grey):
        return 116.0 * np.cbrt(srgb_to_linear(grey)) - 16.0

    low, high = lightness(0.5), lightness(0.6)
    square = ((low + high) / 2 - 50.0) ** 2
    expected = (high - low) / (1 + 0.015 * square / math.sqrt(20 + square))
    difference = delta_e(flat(0.5, 0.5, 0.5), flat(0.6, 0.6, 0.6))
    np.testing.assert_allclose(difference, expected, rtol=1e-3)


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (3, 5), (300, 2)])
def test_any_size_can_be_compared(size):
    measured = compare(picture(1, size), picture(2, size))
    assert all(math.isfinite(value) for value in measured.values())


def test_comparison_is_symmetric():
    a, b = picture(1), picture(2)
    forth, back = compare(a, b), compare(b, a)
    assert forth == pytest.approx(back, rel=1e-9)


def test_a_broken_pixel_shows_in_the_linear_measures():
    a = picture()
    b = a.copy()
    b[0, 0, 0] = math.nan
    assert math.isnan(rmse(a, b)) and math.isnan(max_abs(a, b))
    assert math.isfinite(psnr(a, b)) and math.isfinite(ssim(a, b))


def test_sizes_must_match():
    with pytest.raises(UsageError, match="30 x 20 pixels"):
        compare(picture(), picture(size=(20, 31)))


@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 3), (0, 30, 4)])
def test_only_rgba_pictures_are_taken(shape):
    with pytest.raises(UsageError, match="height, width, 4"):
        compare(np.zeros(shape), np.zeros(shape))
