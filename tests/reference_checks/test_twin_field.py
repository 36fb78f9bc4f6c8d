"""The twin's reconstruction and gradients."""

from __future__ import annotations

import numpy as np
import pytest
from reference.field import Field, spline_coefficients

from clvol import Volume

ANALYTIC = ("cubic", "catmull-rom")
TILTED = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])


def random_volume(shape=(7, 6, 8), **grid):
    return Volume(np.random.default_rng(1).uniform(size=shape), **grid)


def inner_points(volume, n=40, margin=2.0):
    """World positions, ``margin`` voxels inside the domain."""
    lower, upper = volume.grid.index_bounds()
    index = np.random.default_rng(2).uniform(lower + margin, upper - margin, (n, 3))
    matrix = volume.grid.index_to_world()
    return index @ matrix[:3, :3].T + matrix[:3, 3]


def sampled(function, **grid):
    """A volume of 12^3 voxels with the values of function(world)."""
    volume = Volume(np.zeros((12, 12, 12)), **grid)
    z, y, x = np.meshgrid(*(np.arange(12.0),) * 3, indexing="ij")
    index = np.stack([x, y, z, np.ones_like(x)], axis=-1)
    world = (index @ volume.grid.index_to_world().T)[..., :3]
    return Volume(function(world), **grid)


@pytest.mark.parametrize("filter", ["nearest", "linear", "catmull-rom"])
def test_interpolating_filters_meet_the_voxels(filter):
    volume = random_volume()
    world = np.stack(np.meshgrid(np.arange(8.0), np.arange(6.0), np.arange(7.0)), -1).reshape(-1, 3)
    x, y, z = world.astype(int).T
    assert np.allclose(Field(volume, filter).value(world), volume.data[z, y, x], atol=1e-14)


def test_a_prefiltered_spline_meets_the_voxels_and_another_does_not():
    volume = random_volume((5, 1, 8))
    world = np.array([[x, 0.0, z] for z in range(5) for x in range(8)], float)
    expected = volume.data[:, 0].ravel()
    found = Field(volume, "cubic", prefilter=True).value(world)
    assert np.allclose(found, expected, atol=1e-13)
    assert np.abs(Field(volume, "cubic").value(world) - expected).max() > 0.05


def test_spline_coefficients_of_a_constant_are_that_constant():
    assert np.allclose(spline_coefficients(np.full((3, 4, 5), 7.0)), 7.0)


def test_a_nan_voxel_counts_as_its_nearest_neighbour_in_the_prefilter():
    voxels = np.array([1.0, 5.0, np.nan, 2.0]).reshape(4, 1, 1)
    either = [spline_coefficients(np.where(np.isnan(voxels), v, voxels)) for v in (5.0, 2.0)]
    found = spline_coefficients(voxels)
    assert np.isnan(found[2, 0, 0])
    kept = [0, 1, 3]
    assert any(np.allclose(found[kept], c[kept]) for c in either)


@pytest.mark.parametrize("operator", ["central", "sobel"])
@pytest.mark.parametrize("filter", ["nearest", "linear", *ANALYTIC])
def test_the_gradient_of_a_ramp_is_its_slope_in_world_axes(filter, operator):
    slope = np.array([1.5, -0.5, 2.0])
    volume = sampled(lambda w: w @ slope, spacing=(0.5, 2.0, 1.0), direction=TILTED)
    field = Field(volume, filter, operator)
    assert np.allclose(field.gradient(inner_points(volume)), slope, atol=1e-12)


@pytest.mark.parametrize("filter", ANALYTIC)
def test_analytic_gradients_are_the_reconstructions_derivative(filter):
    volume = random_volume(spacing=(0.7, 1.3, 1.0), direction=TILTED)
    field, at, h = Field(volume, filter), inner_points(volume, margin=1.2), 1e-5
    for axis in range(3):
        step = h * np.eye(3)[axis]
        difference = (field.value(at + step) - field.value(at - step)) / (2 * h)
        assert np.allclose(field.gradient(at)[:, axis], difference, atol=1e-8)


def test_central_differences_are_one_sided_at_the_faces():
    volume = Volume(np.array([0.0, 1.0, 4.0, 9.0]).reshape(1, 1, 4))
    at = np.array([[x, 0.0, 0.0] for x in (0, 1, 2, 3, 1.5)], float)
    gradient = Field(volume, "linear").gradient(at)
    assert np.allclose(gradient[:, 0], [1, 2, 4, 5, 3])
    assert np.all(gradient[:, 1:] == 0)


def test_sobel_smooths_along_the_other_axes():
    array = np.zeros((3, 3, 3))
    array[1, 1, 2] = 16.0
    volume = Volume(array)
    assert np.allclose(Field(volume, "linear", "central").gradient(np.ones((1, 3))), [[8, 0, 0]])
    assert np.allclose(Field(volume, "linear", "sobel").gradient(np.ones((1, 3))), [[2, 0, 0]])
    corner = Field(volume, "linear", "sobel").gradient(np.array([[1.0, 0.0, 0.0]]))
    assert np.allclose(corner, [[0.5, 1.0, 1.0]])  # the smoothing repeats the outermost voxels


@pytest.mark.parametrize("filter, reach", [("linear", 1), ("cubic", 2), ("catmull-rom", 2)])
def test_a_nan_voxel_spoils_exactly_what_uses_it(filter, reach):
    array = np.ones((1, 1, 9))
    array[0, 0, 4] = np.nan
    x = np.array([4.0 - reach, 4.0 - reach + 0.01, 4.0 + reach - 0.01, 4.0 + reach])
    at = np.stack([x, 0 * x, 0 * x], axis=1)
    value = Field(Volume(array), filter).value(at)
    assert np.isnan(value).tolist() == [False, True, True, False]
    assert np.allclose(value[[0, 3]], 1.0)
