"""Levels and statistics are what their definitions say, however they are computed."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import slow_blocks

from clvol.store import resolutions
from clvol.store.geometry import BlockGrid

INTEGERS = ("uint8", "int8", "uint16", "int16")
FLOATS = ("float32", "float64")
SHAPES = ((1, 17, 33), (5, 1, 40), (32, 16, 48), (35, 47, 20), (1, 1, 1))
NAMES = ("minimum", "maximum", "mean", "quantiles", "deviation", "reach_low", "reach_high", "holes")


def integers(shape, dtype) -> np.ndarray:
    """The whole range, and a part at its upper end."""
    span = np.iinfo(dtype)
    voxels = np.random.default_rng(5).integers(span.min, span.max + 1, shape).astype(dtype)
    voxels[..., 5:9] = span.max
    return voxels


def floats(shape, dtype, holes: bool) -> np.ndarray:
    """Small steps on a large value; with holes, some and one whole block of them."""
    rng = np.random.default_rng(6)
    voxels = (1e4 + rng.normal(0, 1, shape).cumsum(2)).astype(dtype)
    if holes:
        voxels[rng.random(shape) < 0.2] = np.nan
        voxels[rng.random(shape) < 0.01] = -np.inf
        voxels[:16, :16, :16] = np.nan
    return voxels


def same_statistics(voxels: np.ndarray, edge: int, **tolerance) -> None:
    grid = BlockGrid(voxels.shape, edge)
    found = list(resolutions.array_statistics(voxels, grid))
    wanted = list(slow_blocks.array_statistics(voxels, grid))
    assert [part.first for part in found] == [part.first for part in wanted]
    for part, other in zip(found, wanted):
        for name in NAMES:
            mine, twin = getattr(part, name), getattr(other, name)
            assert mine.dtype == twin.dtype, name
            np.testing.assert_allclose(mine, twin, **tolerance, err_msg=name)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("edge", (4, 16, 32))
@pytest.mark.parametrize("dtype", INTEGERS)
def test_integers_as_the_twin_to_the_last_bit(dtype, edge, shape):
    voxels = integers(shape, dtype)
    for level in range(edge.bit_length()):
        np.testing.assert_array_equal(
            resolutions.reduced(voxels, level), slow_blocks.reduced(voxels, level)
        )
    same_statistics(voxels, edge, rtol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("holes", (False, True))
@pytest.mark.parametrize("dtype", FLOATS)
def test_floats_as_the_twin_but_for_the_order_of_sums(dtype, holes, shape):
    voxels = floats(shape, dtype, holes)
    one_step = 1.2e-7 if dtype == "float32" else 1e-12  # a mean may round to the neighbouring float
    for level in range(5):
        found, wanted = resolutions.reduced(voxels, level), slow_blocks.reduced(voxels, level)
        assert found.dtype == wanted.dtype
        np.testing.assert_allclose(found, wanted, rtol=one_step)
    same_statistics(voxels, 16, rtol=2 * one_step, atol=1e4 * one_step)


def test_pieces_of_a_region_are_the_region(monkeypatch):
    voxels = floats((70, 40, 33), "float32", True)
    grid = BlockGrid(voxels.shape, 16)
    whole = resolutions.region_statistics(voxels, grid, (0, 0, 0), grid.counts)
    monkeypatch.setattr(resolutions, "_CACHED", 1)
    pieces = resolutions.region_statistics(voxels, grid, (0, 0, 0), grid.counts)
    for name in NAMES:
        np.testing.assert_array_equal(getattr(whole, name), getattr(pieces, name))


def test_means_of_the_largest_doubles_stay_finite():
    voxels = np.full((16, 16, 16), np.finfo(np.float64).max)
    assert (resolutions.reduced(voxels, 4) == np.finfo(np.float64).max).all()


def test_a_deviation_without_cancellation():
    """Voxels that are constant in cubes of 2^3, on a value a billion times their differences."""
    cubes = np.random.default_rng(1).normal(0, 1, (8, 8, 8))
    voxels = np.kron(1e9 + cubes, np.ones((2, 2, 2)))
    found = resolutions.region_statistics(voxels, BlockGrid(voxels.shape), (0, 0, 0), (1, 1, 1))
    assert found.deviation[1, 0] == 0.0
    assert found.deviation[4, 0] == pytest.approx(voxels.std(), rel=1e-6)
