"""The sRGB curve against its definition (IEC 61966-2-1) and its own inverse."""

from __future__ import annotations

import numpy as np

from clvol.transfer import linear_to_srgb, srgb_to_linear
from clvol.transfer.color import srgb_levels


def test_known_values():
    assert srgb_to_linear(0.0) == 0.0
    assert srgb_to_linear(1.0) == 1.0
    # Mid grey 128/255, and the last value of the linear part, computed with 30 digits.
    np.testing.assert_allclose(srgb_to_linear(128 / 255), 0.215860500113899, rtol=1e-14)
    np.testing.assert_allclose(srgb_to_linear(0.04), 0.04 / 12.92, rtol=1e-15)
    np.testing.assert_allclose(linear_to_srgb(0.5), 0.735356983052449, rtol=1e-14)


def test_encoding_inverts_decoding_at_every_16_bit_level():
    levels = np.arange(65536) / 65535
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(levels)), levels, rtol=0, atol=1e-15)


def test_both_directions_rise_strictly():
    fine = np.linspace(0, 1, 200_001)
    assert (np.diff(srgb_to_linear(fine)) > 0).all()
    assert (np.diff(linear_to_srgb(fine)) > 0).all()


def test_shape_is_kept_and_type_is_double():
    decoded = srgb_to_linear(np.zeros((2, 5, 3), dtype=np.float32))
    assert decoded.shape == (2, 5, 3) and decoded.dtype == np.float64


def test_levels_of_8_bits_are_those_of_the_curve():
    rng = np.random.default_rng(0)
    bounds = srgb_to_linear((np.arange(1, 256) - 0.5) / 255)
    ends = np.arange(4097) / 4096
    near = [np.clip(bounds + error, 0, 1) for error in np.linspace(-3e-9, 3e-9, 101)]
    beside = np.nextafter(ends, 2)[:-1], np.nextafter(ends, -1)[1:]
    light = np.concatenate([[0.0, 1.0], ends, *beside, bounds, *near, rng.random(200_000) ** 3])
    levels = srgb_levels(light)
    assert levels.dtype == np.uint8
    np.testing.assert_array_equal(levels, np.floor(255 * linear_to_srgb(light) + 0.5))
