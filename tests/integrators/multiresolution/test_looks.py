"""Errors of blocks that may look in several ways: bounds that hold for each of them."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import TransferFunction, Volume
from clvol.integrators.multiresolution.looks import Looks
from clvol.integrators.multiresolution.luv import linear_to_luv
from clvol.integrators.multiresolution.selection import source_errors
from clvol.integrators.multiresolution.visible_error import ShownColors, transparent
from clvol.scene.glow import Glow
from clvol.store.volume_blocks import VolumeBlocks

BLACK, WHITE = np.zeros(3), [[1.0, 1.0, 1.0]]
PATH = 16.0
RAMP = TransferFunction([0.0, 255.0], [0.0, 0.1], [[0.1, 0.2, 0.3], [1.0, 0.9, 0.4]])
CLEAR = TransferFunction([0.0, 255.0], [0.0, 0.0], np.zeros((2, 3)))
LAMP = Glow(np.array([0.0, 100.0, 140.0, 200.0]), np.array([[0.0] * 3, [0.0] * 3, [0.02, 0.01, 0.0], [0.0] * 3]))


def source():
    """Four blocks along x: dark and constant, dark and varied, bright and constant, bright and varied."""
    rng = np.random.default_rng(5)
    data = np.full((16, 16, 64), 20, np.uint8)
    data[:, :, 16:32] = rng.integers(0, 90, (16, 16, 16))
    data[:, :, 32:48] = 150
    data[:, :, 48:] = rng.integers(110, 240, (16, 16, 16))
    return VolumeBlocks(Volume(data), 16)


def test_light_is_not_transparent():
    parts = list(source().statistics())
    found = np.concatenate([transparent(part, CLEAR, LAMP) for part in parts])
    assert np.concatenate([transparent(part, CLEAR) for part in parts]).all()
    assert found.tolist() == [True, False, False, False]  # a block's values reach into the next


@pytest.mark.parametrize("opacity", [0.0, 0.05, 0.999])
def test_shown_colours_have_the_light_that_leaves_the_path(opacity):
    """A medium that emits L a length and absorbs evenly: L (1 - exp(-tau x)) / tau is what leaves a path x."""
    function = TransferFunction([0.0], [opacity], WHITE)
    tau = -np.log1p(-opacity)
    values = np.array([20.0, 120.0, 140.0, 170.0])
    light = np.stack([np.interp(values, LAMP.values, LAMP.light[:, k]) for k in range(3)], axis=1)
    length = -np.expm1(-tau * PATH) / tau if tau else PATH
    expected = linear_to_luv(light * length - np.expm1(-tau * PATH))
    shown = ShownColors(function, PATH, BLACK, LAMP)
    np.testing.assert_allclose(np.transpose(shown.luv(shown.places(values))), expected, atol=0.02)
    mixed = np.transpose(shown.mixture(np.repeat(shown.places(values)[:, None], 16, axis=1)))
    part = PATH / 16.0
    length = -np.expm1(-tau * part) / tau if tau else part
    np.testing.assert_allclose(mixed, linear_to_luv(light * length - np.expm1(-tau * part)), atol=0.02)
    nothing = np.transpose(shown.luv(shown.places(np.array([np.nan]))))
    np.testing.assert_allclose(nothing, 0.0, atol=1e-6)


def test_no_light_and_one_look_change_no_bit():
    plain = source_errors(source(), RAMP, BLACK)
    found = Looks().errors(source(), RAMP, BLACK)
    for one, other in zip(vars(plain).values(), vars(found).values()):
        np.testing.assert_array_equal(one, other)


def test_errors_of_light_are_those_of_what_varies():
    found = Looks(glow=LAMP).errors(source(), CLEAR, BLACK)
    assert not found.errors[:, [0, 2]].any() and (found.errors[1:, 3] > 0.1).all()
    assert (np.diff(found.errors, axis=0) >= 0).all() and (found.transmittances == 1).all()
    brighter = Looks(glow=Glow(LAMP.values, 10.0 * LAMP.light)).errors(source(), CLEAR, BLACK)
    assert (brighter.errors[1:, 3] > 2.0 * found.errors[1:, 3]).all()


def test_the_least_of_factors_counts_as_none():
    """Nothing is as weak as what such a share leaves of an opacity: its unit would be infinite."""
    none, least = (
        Looks(least_factor=factor, by_gradient=True).errors(source(), RAMP, BLACK) for factor in (0.0, 1e-310)
    )
    np.testing.assert_array_equal(least.errors, none.errors)
    np.testing.assert_array_equal(least.transmittances, none.transmittances)


@pytest.mark.parametrize("least", [0.0, 0.3])
def test_a_block_hides_no_more_than_its_weakest_look(least):
    """Of T, what the weakest factor leaves: the mean of T^factor, by each value."""
    plain = source_errors(source(), RAMP, BLACK)
    found = Looks(least_factor=least, by_gradient=True).errors(source(), RAMP, BLACK)
    np.testing.assert_array_equal(found.dropped, plain.dropped)
    assert (found.transmittances >= plain.transmittances - 1e-6).all()
    np.testing.assert_allclose(found.transmittances[2], plain.transmittances[2] ** least, rtol=1e-4)
    assert (found.errors >= plain.errors).all() and not found.errors[0].any()


def test_what_only_gradients_show_has_errors():
    """An even opacity and colour, of which a factor shows the boundaries: coarse blocks lose them."""
    even = TransferFunction([0.0], [0.2], WHITE)
    found = Looks(least_factor=0.0, by_gradient=True).errors(source(), even, BLACK)
    assert not source_errors(source(), even, BLACK).errors.any()
    assert not found.errors[:, [0, 2]].any() and (found.errors[1:, [1, 3]] > 0.1).all()
    assert (np.diff(found.errors, axis=0) >= 0).all() and np.isfinite(found.errors).all()


def test_blocks_that_any_layer_shows_are_held():
    low = TransferFunction([0.0, 60.0, 100.0], [0.5, 0.5, 0.0], np.ones((3, 3)))
    high = TransferFunction([120.0, 200.0], [0.0, 0.7], np.ones((2, 3)))
    single = [source_errors(source(), each, BLACK) for each in (low, high)]
    found = Looks((high,)).errors(source(), low, BLACK)
    assert single[0].dropped.any() and single[1].dropped.any() and not found.dropped.any()
    for each in single:
        assert (found.errors >= each.errors).all() and (found.transmittances >= each.transmittances).all()


def test_values_that_are_not_finite_have_finite_errors():
    data = np.random.default_rng(2).normal(120.0, 60.0, (16, 16, 48)).astype(np.float32)
    data[:, :, :32] = np.nan
    data[3, 4, 40] = np.inf
    looks = Looks((RAMP,), 0.2, True, LAMP)
    found = looks.errors(VolumeBlocks(Volume(data), 16), RAMP, BLACK)
    assert np.isfinite(found.errors).all() and np.isfinite(found.transmittances).all()
    assert found.dropped[0] and not found.dropped[2]
