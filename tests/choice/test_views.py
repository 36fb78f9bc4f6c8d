"""What is up, which side is the front, and named views."""

from __future__ import annotations

import numpy as np
import pytest

import clvol
from clvol.choice.view import axes_of, is_view, named_view
from clvol.errors import SceneError

TURNED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
N = 40


def bust(down: tuple[int, bool], frame: str = "LPS", **grid) -> clvol.Volume:
    """A head on a neck that the face of the volume ``down`` (axis of [z, y, x], at its end) cuts off."""
    axes = list(np.mgrid[:N, :N, :N].astype(np.float32) - (N - 1) / 2)
    along = axes[down[0]] * (1 if down[1] else -1)
    across = [axis for k, axis in enumerate(axes) if k != down[0]]
    head = along**2 + across[0] ** 2 * 1.4 + across[1] ** 2 < 12.0**2
    neck = (along > 0) & (across[0] ** 2 + across[1] ** 2 < 6.0**2)
    grey = 200 * (head | neck) + (head & (axes[0] > 0))  # of three values, so that it is no mask
    return clvol.Volume(grey.astype(np.uint8), frame=frame, **grid)


def camera_of(volume: clvol.Volume, **camera) -> clvol.Camera:
    return clvol.Scene(volume=volume, camera=camera or None).completed().camera


@pytest.mark.parametrize(("frame", "left", "front"), [("LPS", (1, 0, 0), (0, -1, 0)), ("RAS", (-1, 0, 0), (0, 1, 0))])
def test_a_frame_of_a_patient_decides_what_is_up_and_where_the_front_is(frame, left, front):
    # An origin says that the header was written with care; the shape then decides nothing.
    camera = camera_of(bust((1, True), frame, origin=(3.0, 4.0, 5.0)))
    forward, right, up = camera.basis()
    assert camera.up == (0.0, 0.0, 1.0)
    assert -forward @ np.array(front) > 0.5 and -forward @ np.array(left) > 0.2 and -forward[2] > 0


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("end", [False, True])
def test_a_header_that_says_no_more_than_a_default_does_not_lay_heads_down(axis, end):
    up = np.array(camera_of(bust((axis, end))).up)
    expected = np.zeros(3)
    expected[2 - axis] = -1.0 if end else 1.0
    assert up.tolist() == expected.tolist()


def test_slices_stand_as_on_a_screen_and_arrays_have_y_up():
    ball = np.zeros((24, 24, 24), np.uint8)
    ball[8:16, 8:16, 8:16] = 100
    assert camera_of(clvol.Volume(ball, frame="image")).up == (0.0, -1.0, 0.0)
    assert camera_of(clvol.Volume(ball)).up == (0.0, 1.0, 0.0)


@pytest.mark.parametrize("name", ["front", "back", "left", "right", "top", "bottom", "front-left", "top-back-right"])
@pytest.mark.parametrize("frame", ["LPS", "RAS", "index", "image"])
def test_named_views_look_from_the_side_that_they_name(name, frame):
    axes = axes_of(frame)
    towards_eye, up = named_view(name, axes)
    sides = {"left": axes[0], "right": -axes[0], "front": axes[1], "back": -axes[1], "top": axes[2], "bottom": -axes[2]}
    assert all(towards_eye @ sides[word] > 0.5 for word in name.split("-"))
    assert np.linalg.norm(towards_eye) == pytest.approx(1) and abs(towards_eye @ up) < 0.95
    # The axes are of one hand: seen from the front, the object's left is on the right.
    assert np.cross(axes[2], axes[1]).tolist() == axes[0].tolist() or frame == "LAS"


def test_a_named_view_shows_the_whole_volume_beside_a_stated_function(tmp_path):
    volume = bust((0, False), origin=(1.0, 2.0, 3.0), spacing=(1.0, 2.0, 1.5))
    scene = clvol.Scene(volume=volume, camera={"view": "left"}, transfer_function={"preset": "grayscale"})
    camera = scene.resolve().camera
    forward, right, up = camera.basis()
    assert forward == pytest.approx([-1, 0, 0]) and up == pytest.approx([0, 0, 1])
    away = volume.grid.world_corners() - np.asarray(camera.position)
    half = np.tan(np.radians(15.0)) * (away @ forward)
    assert max(np.max(np.abs(away @ up) / half), np.max(np.abs(away @ right) / half)) <= 1.0
    with clvol.Renderer(scene) as renderer:  # another camera by name
        moved = renderer.render(camera=clvol.Camera(view="front"))
    assert moved.rgba[..., 3].max() > 0


def test_the_object_fills_the_picture_not_its_box():
    array = np.zeros((60, 60, 60), np.uint8)
    array[10:16, 12:18, 40:46] = 200
    camera = camera_of(clvol.Volume(array))
    assert np.linalg.norm(np.subtract(camera.target, [42.5, 14.5, 12.5])) < 1.0
    assert np.linalg.norm(np.subtract(camera.target, camera.position)) < 45


def test_what_a_camera_states_is_kept():
    volume = bust((0, False), origin=(1.0, 2.0, 3.0))
    assert camera_of(volume, up=(0.0, 1.0, 0.5)).up == (0.0, 1.0, 0.5)
    assert camera_of(volume, target=(1.0, 2.0, 3.0), fov_degrees=50.0).target == (1.0, 2.0, 3.0)
    flat = camera_of(volume, projection="orthographic", view="back")
    assert flat.height > 10 and flat.basis()[0] == pytest.approx([0, -1, 0])


@pytest.mark.parametrize("view", ["front-back", "above", "left-left", "", "front-", "front-left-right"])
def test_a_view_that_is_none_is_refused(view):
    assert not is_view(view)
    with pytest.raises(SceneError, match="camera.view: got .*expected 'front'"):
        clvol.Camera(view=view)


def test_a_view_and_a_position_are_one_too_many():
    with pytest.raises(SceneError, match="either a view or a position"):
        clvol.Camera(view="front", position=(1.0, 2.0, 3.0))
