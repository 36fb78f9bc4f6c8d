"""The difference picture: its numbers, its scale, and what it shows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clvol.accuracy.difference import (
    NOT_FINITE,
    Scale,
    difference_picture,
    linear_scale,
    logarithmic_scale,
    magnitude,
    palette,
    signed_difference,
)
from clvol.accuracy.metrics import max_abs
from clvol.errors import UsageError


def picture(seed: int, size: tuple[int, int] = (300, 600)) -> np.ndarray:
    return np.random.default_rng(seed).random((*size, 4)).astype(np.float32)


def lightness(colors: np.ndarray) -> np.ndarray:
    from skimage.color import rgb2lab

    return rgb2lab(colors / 255.0)[..., 0]


def test_the_difference_is_signed_and_linear():
    a, b = picture(1), picture(2)
    difference = signed_difference(a, b)
    assert difference.dtype == np.float32 and difference.shape == a.shape
    np.testing.assert_allclose(difference, a.astype(float) - b, atol=1e-7)
    np.testing.assert_array_equal(signed_difference(b, a), -difference)


def test_the_largest_magnitude_is_the_measure_of_the_same_name():
    a, b = picture(1), picture(2)
    assert magnitude(signed_difference(a, b)).max() == np.float32(max_abs(a, b))


@pytest.mark.parametrize("largest", [1e-30, 1.234e-5, 0.2, 0.5, 1.0, 3.0, 7e8])
def test_a_linear_scale_ends_at_a_round_number_not_far_above(largest):
    scale = linear_scale(np.linspace(0, largest, 5))
    assert largest * 0.998 <= scale.full <= 2.001 * largest
    digit = scale.full / 10 ** math.floor(math.log10(scale.full) + 1e-9)
    assert round(digit, 9) in (1, 2, 3, 5)


def test_a_few_outliers_do_not_darken_the_rest():
    values = np.full(100_000, 0.01)
    values[:50] = 1.0
    assert linear_scale(values).full == 0.01


def test_a_difference_in_few_pixels_alone_still_shows():
    values = np.zeros((100, 100))
    values[0, 0] = 1e-4
    scale = linear_scale(values)
    assert scale.indices(values)[0, 0] > 100


@pytest.mark.parametrize("values", [np.zeros((4, 4)), np.full((4, 4), np.nan)])
def test_no_finite_difference_makes_a_scale_all_the_same(values):
    assert linear_scale(values) == Scale(1.0)
    assert logarithmic_scale([values]).low is not None


def test_a_shared_scale_shows_the_largest_and_the_least_picture():
    large, small = np.full((8, 8), 0.03), np.full((8, 8), 2e-6)
    scale = logarithmic_scale([large, small])
    assert scale.full == 0.1 and scale.low == pytest.approx(1e-7)
    assert 0 < scale.indices(small).min() < scale.indices(large).min() < 255


def test_equal_ratios_are_equal_steps_of_a_logarithmic_scale():
    steps = np.diff(Scale(1.0, 1e-4).share([1e-4, 1e-3, 1e-2, 1e-1, 1.0]))
    np.testing.assert_allclose(steps, 0.25)
    assert Scale(1.0, 1e-4).share([0.0, 1e-9, 5.0]).tolist() == [0.0, 0.0, 1.0]


def test_more_difference_is_a_lighter_colour():
    shown = lightness(palette()[Scale(1.0).indices(np.linspace(0, 1, 64))])
    assert np.all(np.diff(shown) > 0) and shown[0] < 1 and shown[-1] > 90


def test_what_is_not_finite_has_a_colour_of_its_own():
    colors = palette()[Scale(1.0).indices(np.array([0.5, np.nan, np.inf]))]
    assert colors[1].tolist() == colors[2].tolist() == list(NOT_FINITE)
    assert list(NOT_FINITE) not in palette()[:-1].tolist()


def test_the_picture_shows_where_the_difference_is():
    a = np.zeros((400, 600, 4), np.float32)
    b = a.copy()
    b[100:200, 300:400] = 0.25
    shown = difference_picture(a, b)
    assert shown.dtype == np.uint8 and shown.shape[1:] == (600, 3) and shown.shape[0] > 400
    assert lightness(shown[100:200, 300:400]).min() > 60
    assert shown[:100, :].max() < 5
    footer = shown[400:]
    assert footer.max() > 200, "the scale and its text"


def test_a_small_picture_is_enlarged_by_a_whole_factor():
    a = np.zeros((2, 3, 4), np.float32)
    b = a.copy()
    b[0, 1] = 1.0
    shown = difference_picture(a, b)
    light = lightness(shown[:170]) > 60
    rows, columns = np.flatnonzero(light.any(axis=1)), np.flatnonzero(light.any(axis=0))
    assert rows.tolist() == list(range(85)) and len(columns) == 85
    assert light[np.ix_(rows, columns)].all()


@pytest.mark.parametrize("size", [(1, 1), (1, 700), (900, 1), (3, 5)])
def test_any_size_can_be_shown(size):
    assert difference_picture(picture(1, size), picture(2, size)).std() > 1


def test_broken_pixels_are_shown_and_break_nothing():
    a, b = picture(1), picture(1)
    a[0, 0, 0] = np.nan
    a[0, 1, 0] = b[0, 1, 0] = np.inf
    shown = difference_picture(a, b)
    assert shown[0, 0].tolist() == shown[0, 1].tolist() == list(NOT_FINITE)
    assert shown[1, 0].max() < 5


def test_sizes_must_match():
    with pytest.raises(UsageError, match="600 x 300 pixels"):
        difference_picture(picture(1), picture(1, (300, 601)))
