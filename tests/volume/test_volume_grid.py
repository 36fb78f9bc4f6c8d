"""The grid's geometry: index to world and back, the domain, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.errors import VolumeError
from clvol.volume import Grid

OBLIQUE = np.linalg.qr(np.array([[1.0, 2.0, 0.5], [-1.0, 1.0, 2.0], [0.3, -1.0, 1.0]]))[0]
SHEARED = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.6], [0.0, 0.0, 0.8]])
FLIPPED = np.diag([-1.0, 1.0, -1.0])


@pytest.mark.parametrize("direction", [None, FLIPPED, OBLIQUE, SHEARED])
def test_index_to_world_is_origin_plus_direction_times_scaled_index(direction) -> None:
    grid = Grid((4, 5, 6), (0.5, 2.0, 3.0), (10.0, -20.0, 30.0), direction)
    index = np.array([3.25, 1.5, 2.0])
    axes = np.eye(3) if direction is None else direction
    expected = np.array([10.0, -20.0, 30.0]) + axes @ (np.array([0.5, 2.0, 3.0]) * index)
    world = grid.index_to_world() @ [*index, 1.0]
    np.testing.assert_allclose(world[:3], expected, rtol=0, atol=1e-12)
    assert world[3] == 1.0


@pytest.mark.parametrize("direction", [None, FLIPPED, OBLIQUE, SHEARED])
def test_world_to_index_is_the_inverse(direction) -> None:
    grid = Grid((4, 5, 6), (0.5, 2.0, 3.0), (10.0, -20.0, 30.0), direction)
    product = grid.world_to_index() @ grid.index_to_world()
    np.testing.assert_allclose(product, np.eye(4), rtol=0, atol=1e-12)


def test_identity_grid_maps_without_rounding() -> None:
    grid = Grid((4, 5, 6))
    assert np.array_equal(grid.index_to_world(), np.eye(4))
    assert np.array_equal(grid.world_to_index(), np.eye(4))


def test_size_is_x_first_and_shape_z_first() -> None:
    grid = Grid((4, 5, 6), (3.0, 2.0, 0.5))
    assert grid.size == (6, 5, 4)
    assert grid.smallest_edge == 0.5


def test_domain_is_the_hull_of_voxel_centres() -> None:
    assert Grid((4, 5, 6)).index_bounds().tolist() == [[0, 0, 0], [5, 4, 3]]


def test_an_axis_with_one_voxel_is_one_voxel_thick() -> None:
    bounds = Grid((1, 5, 1)).index_bounds()
    assert bounds.tolist() == [[-0.5, 0, -0.5], [0.5, 4, 0.5]]


def test_corners_run_x_fastest_in_world_space() -> None:
    corners = Grid((3, 2, 4), (1.0, 10.0, 100.0), (0.5, 0.0, 0.0)).world_corners()
    assert corners.shape == (8, 3)
    assert corners[0].tolist() == [0.5, 0, 0]
    assert corners[1].tolist() == [3.5, 0, 0]
    assert corners[2].tolist() == [0.5, 10, 0]
    assert corners[7].tolist() == [3.5, 10, 200]


def test_steps_become_spacing_and_unit_directions() -> None:
    grid = Grid.from_steps((2, 2, 2), np.diag([-0.5, 2.0, 3.0]))
    assert grid.spacing == (0.5, 2.0, 3.0)
    assert grid.direction.tolist() == [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]


def test_directions_with_six_digits_are_made_unit() -> None:
    c = 0.707107
    grid = Grid((2, 2, 2), direction=[[c, -c, 0], [c, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(np.linalg.norm(grid.direction, axis=0), 1.0, atol=1e-15)


def test_equal_grids_are_equal_and_immutable() -> None:
    one, other = Grid((2, 3, 4), direction=FLIPPED), Grid((2, 3, 4), direction=FLIPPED)
    assert one == other and hash(one) == hash(other)
    assert one != Grid((2, 3, 4))
    with pytest.raises(ValueError):
        one.direction[0, 0] = 2.0


@pytest.mark.parametrize(
    "arguments, word",
    [
        (dict(shape=(0, 2, 2)), "shape"),
        (dict(shape=(2, 2)), "shape"),
        (dict(shape=(2, 2, 2.5)), "shape"),
        (dict(spacing=(0, 1, 1)), "spacing"),
        (dict(spacing=(-1, 1, 1)), "spacing"),
        (dict(spacing=(float("nan"), 1, 1)), "spacing"),
        (dict(spacing=(float("inf"), 1, 1)), "spacing"),
        (dict(spacing=(1, 1)), "spacing"),
        (dict(spacing=("a", 1, 1)), "spacing"),
        (dict(spacing=(1e308, 1, 1)), "infinity"),
        (dict(origin=(float("nan"), 0, 0)), "origin"),
        (dict(direction=np.zeros((3, 3))), "direction"),
        (dict(direction=[[1, 1, 0], [0, 0, 0], [0, 0, 1]]), "singular"),
        (dict(direction=np.full((3, 3), np.nan)), "direction"),
        (dict(direction=np.eye(3) * 2), "length"),
        (dict(direction=np.eye(2)), "direction"),
    ],
)
def test_an_impossible_grid_is_refused(arguments, word) -> None:
    with pytest.raises(VolumeError, match=word):
        Grid(**{"shape": (20, 20, 20), **arguments})
