"""Rays, bases and default views."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clvol import Camera, Volume
from clvol.errors import SceneError
from clvol.scene import ImageSettings

FRONT = Camera(position=(0, 0, 5), target=(0, 0, 0), up=(0, 1, 0), fov_degrees=90)
FLAT = FRONT.model_copy(update={"projection": "orthographic", "height": 4})


def grid_of(shape, **keys):
    return Volume(np.zeros(shape, dtype=np.uint8), **keys).grid


GRIDS = {
    "cube": grid_of((16, 16, 16)),
    "flat": grid_of((1, 64, 64)),
    "voxel": grid_of((1, 1, 1)),
    "needle": grid_of((2, 2, 500), spacing=(0.5, 2, 1), origin=(-1000, 3, 7)),
    "tiny": grid_of((9, 8, 7), spacing=(1e-9, 1e-9, 2e-9)),
    "flipped": grid_of((20, 10, 5), direction=np.diag([-1.0, 1.0, -1.0])),
}


def test_basis_is_right_handed_and_orthonormal():
    camera = Camera(position=(3, -2, 7), target=(1, 4, -2), up=(0.3, 1, 0.2))
    forward, right, up = camera.basis()
    axes = np.stack([right, up, -forward])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1.0, abs=1e-15)
    assert up @ [0.3, 1, 0.2] > 0


def test_looking_down_minus_z_right_is_x():
    forward, right, up = FRONT.basis()
    np.testing.assert_array_equal([forward, right, up], [[0, 0, -1], [1, 0, 0], [0, 1, 0]])


def test_row_0_is_on_top_and_column_0_on_the_left():
    origins, directions = FRONT.world_rays(4, 2)
    assert directions.shape == origins.shape == (2, 4, 3)
    assert directions[0, 0, 1] > 0 > directions[1, 0, 1]
    assert directions[0, 0, 0] < 0 < directions[0, 3, 0]
    assert (origins == [0, 0, 5]).all()


def test_rays_go_through_pixel_centres_of_square_pixels():
    _, directions = FRONT.world_rays(6, 2)
    # At depth 1 the picture is 2 high (90 degrees) and 6 wide, pixels are 1 x 1.
    on_plane = directions / -directions[..., 2:]
    np.testing.assert_allclose(on_plane[0, :, 0], [-2.5, -1.5, -0.5, 0.5, 1.5, 2.5], atol=1e-15)
    np.testing.assert_allclose(on_plane[:, 0, 1], [0.5, -0.5], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-15)


def test_one_pixel_looks_straight_ahead():
    _, directions = FRONT.world_rays(1, 1)
    np.testing.assert_array_equal(directions[0, 0], [0, 0, -1])


def test_orthographic_rays_start_on_the_plane_through_the_eye():
    origins, directions = FLAT.world_rays(2, 2)
    np.testing.assert_array_equal(origins[..., 2], 5)
    np.testing.assert_array_equal(origins[:, 0, 1], [1, -1])  # 4 high, pixels 2 x 2
    np.testing.assert_array_equal(origins[0, :, 0], [-1, 1])
    assert (directions == [0, 0, -1]).all()


def inside_fraction(camera: Camera, grid, image: ImageSettings) -> np.ndarray:
    """Where the volume's corners fall in the picture: 1 is the border, [8, 2]."""
    forward, right, up = camera.basis()
    relative = grid.world_corners() - np.array(camera.position)
    ahead = relative @ forward
    assert (ahead > 0).all(), "a corner lies behind the eye"
    half = np.array([image.width / image.height, 1.0])
    if camera.projection == "perspective":
        half = half * math.tan(math.radians(camera.fov_degrees) / 2) * ahead[:, None]
    else:
        half = half * camera.height / 2
    return np.abs(np.stack([relative @ right, relative @ up], axis=1)) / half


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize("size", [(64, 64), (200, 10), (10, 200), (1, 1)])
@pytest.mark.parametrize(
    "asked",
    [
        {},
        {"projection": "orthographic"},
        {"fov_degrees": 1},
        {"fov_degrees": 170},
        {"up": (0, 0, 1)},
    ],
)
def test_the_default_view_shows_the_whole_volume_large(name, size, asked):
    grid, image = GRIDS[name], ImageSettings(width=size[0], height=size[1])
    camera = Camera(**asked).complete(grid, image)
    reach = inside_fraction(camera, grid, image)
    assert reach.max() < 1
    if camera.fov_degrees < 90:
        assert reach.max() > 0.8  # not a dot in the distance either


def test_the_default_is_a_perspective_of_30_degrees():
    camera = Camera.default(GRIDS["cube"], ImageSettings())
    assert camera.projection == "perspective" and camera.fov_degrees == 30
    np.testing.assert_allclose(camera.target, [7.5, 7.5, 7.5])


def test_an_orthographic_height_that_is_left_out_shows_the_whole_volume():
    asked = Camera(projection="orthographic", position=(100, 40, -30), target=(7, 7, 7))
    for image in (ImageSettings(), ImageSettings(width=10, height=100)):
        camera = asked.complete(GRIDS["cube"], image)
        assert 0.8 < inside_fraction(camera, GRIDS["cube"], image).max() < 1


def test_up_that_is_left_out_fits_every_view():
    for position in np.vstack([np.eye(3), -np.eye(3)]) * 50 + 7.5:
        camera = Camera(position=tuple(position)).complete(GRIDS["cube"], ImageSettings())
        assert np.isfinite(camera.basis()).all()


def test_what_was_asked_for_is_kept():
    completed = FRONT.complete(GRIDS["cube"], ImageSettings())
    assert completed.position == (0, 0, 5) and completed.target == (0, 0, 0)
    assert completed.fov_degrees == 90 and completed.height is None


def test_distances_near_the_ends_of_double_precision_do_not_break_the_basis():
    for scale in (1e-300, 1e30):
        camera = Camera(position=(0, 0, scale), target=(0, 0, 0), up=(0, scale, 0))
        np.testing.assert_array_equal(camera.basis()[0], [0, 0, -1])


def test_an_incomplete_camera_says_what_is_missing():
    with pytest.raises(SceneError, match="camera.position: missing"):
        Camera().basis()
    with pytest.raises(SceneError, match="camera.height: missing"):
        Camera(projection="orthographic", position=(1, 0, 0), target=(0, 0, 0), up=(0, 1, 0)
               ).world_rays(2, 2)


def test_errors_from_python_name_the_key():
    with pytest.raises(SceneError) as caught:
        Camera(fov_degrees=-1)
    assert caught.value.where == "scene: camera.fov_degrees"
