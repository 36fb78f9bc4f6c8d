"""What tiles are thought to be wrong by, and which are refined next."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.tile_pictures import rays_only
from reference.tiles import JoinTwin

from clvol.integrators.tiles.geometry import Resolution, TileGrid
from clvol.integrators.tiles.refine import TileErrors, estimated_errors
from clvol.integrators.tiles.work import ray_work


def estimates_and_errors(image: np.ndarray, size: int, tau: int):
    """Estimated and true mean squares of each tile's pixels without a ray; tiles all alike."""
    height, width = image.shape[:2]
    grid = TileGrid(width, height, size)
    resolution = Resolution(np.full(grid.count, tau), np.full(grid.count, -1))
    work = ray_work(grid, resolution, np.arange(grid.count))
    resolution.halvings[:] = 0
    twin = JoinTwin(grid, resolution)
    shown, _ = twin.join(rays_only(grid, resolution, image), np.zeros((height, width)))
    wrong = np.mean((shown - image) ** 2, axis=2)
    sums = [wrong[top : top + size, left : left + size].sum() for left, top in grid.origins]
    return estimated_errors(shown, grid, resolution, work), np.array(sums) / (size**2 - tau**2)


def colored(values: np.ndarray) -> np.ndarray:
    return np.repeat(values[..., None], 4, axis=2)


def test_no_error_is_expected_of_constant_and_linear_pictures_inside():
    y, x = np.mgrid[:64, :64] / 64.0
    assert not estimates_and_errors(colored(np.full((64, 64), 0.3)), 16, 4)[0].any()
    estimated, _ = estimates_and_errors(colored(0.4 * x + 0.2 * y), 16, 4)
    inside = estimated.reshape(4, 4)[1:-1, 1:-1]
    assert inside.max() < 1e-10 < estimated.max()  # at the picture's edge it is not linear


@pytest.mark.slow
def test_estimates_are_within_a_factor_of_four_for_waves_and_edges():
    """Root mean squares: between what is right where a picture is smooth and where it jumps."""
    y, x = np.mgrid[:96, :96]
    waves = np.sin(0.12 * x) * np.cos(0.1 * y)
    disc = ((x - 47) ** 2 + (y - 40) ** 2 < 700).astype(float)
    for image in (waves, disc):
        estimated, true = estimates_and_errors(colored(image), 16, 4)
        ratio = np.sqrt(estimated.sum() / true.sum())
        assert 0.25 < ratio < 4, ratio


def test_the_tiles_that_are_most_wrong_are_told_from_the_others():
    y, x = np.mgrid[:96, :96] / 95.0
    fade = (16 * x * (1 - x) * y * (1 - y)) ** 2
    image = fade * np.sin(27.0 * x * y)  # the faster the further
    estimated, true = estimates_and_errors(colored(image), 16, 4)
    worst = set(np.argsort(-true)[:9])
    assert len(worst & set(np.argsort(-estimated)[:9])) >= 6


def test_measured_errors_correct_the_estimates_of_tiles_not_refined():
    errors = TileErrors(np.array([1.0, 2.0, 3.0, 4.0]))
    errors.refined(np.array([2, 3]), np.array([9.0, 12.0]))
    assert errors.correction == 3.0
    np.testing.assert_allclose(errors.mean_squares, [3.0, 6.0, 9.0 * 0.25, 12.0 * 0.25])


def test_how_errors_fall_is_measured_where_tiles_were_refined_twice():
    errors = TileErrors(np.ones(3))
    errors.refined(np.array([0, 1, 2]), np.array([8.0, 8.0, 4.0]))
    errors.refined(np.array([0, 1]), np.array([1.0, 1.0]))
    assert errors.fall == pytest.approx(1 / 8)
    np.testing.assert_allclose(errors.mean_squares, [1 / 8, 1 / 8, 4 / 8])
    errors.refined(np.array([2]), np.array([400.0]))  # found something: not less than before
    assert errors.fall == 1.0 and errors.mean_squares[2] == 400.0


def test_the_worst_error_for_a_ray_comes_first_and_no_budget_is_passed():
    errors = TileErrors(np.array([1.0, 5.0, 3.0, 0.0, 9.0]))
    unknown = np.array([10, 10, 10, 10, 0])
    costs = np.array([4, 40, 4, 4, 0])  # the last one is complete
    assert list(errors.choose(unknown, costs, 8, 100)) == [0, 2]  # 50 / 40 is less than 10 / 4
    assert list(errors.choose(unknown, costs, 1, 100)) == [2]  # at least one
    assert list(errors.choose(unknown, costs, 1000, 47)) == [0, 2]
    assert list(errors.choose(unknown, costs, 1000, 52)) == [0, 1, 2, 3]
    assert list(errors.choose(unknown, costs, 1000, 3)) == []
    assert list(errors.choose(unknown, np.zeros(5, int), 1000, 1000)) == []


def test_the_error_of_the_picture_is_that_of_the_pixels_without_rays():
    errors = TileErrors(np.array([4.0, 16.0]))
    assert errors.rmse(np.array([100, 0]), 200) == pytest.approx(np.sqrt(2.0))
    assert errors.rmse(np.array([0, 0]), 200) == 0.0
