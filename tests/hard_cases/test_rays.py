"""Rays: directions, eyes, views and planes where arithmetic is degenerate."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import axis_camera, exact, make_scene, picture, waves

from clvol import Camera, Scene, TransferFunction, Volume
from clvol.errors import SceneError
from clvol.features import called_for
from clvol.integrators.reference.picture import integrate_world_rays
from clvol.integrators.registry import check_scene

CLASSIFICATIONS = ("pre", "post", "preintegrated")
GREY = [[0.3, 0.5, 0.7]]
CONSTANT = TransferFunction([0], [0.2], GREY)
CENTRED = {"origin": (-8.0, -8.0, -8.0)}  # of 17^3 voxels


def agree(device, context, scene, atol=3e-4):
    rgba, reference = picture(context, scene).rgba, exact(device, scene)
    assert np.isfinite(rgba).all() and reference[..., 3].max() > 0.05
    np.testing.assert_allclose(rgba, reference, atol=atol)
    return rgba


# --- directions ------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("filter_name", ["linear", "nearest"])
def test_an_orthographic_view_along_an_axis_has_no_seam(
    device, context, axis, sign, filter_name
):
    # 17 pixels over 17 voxel lengths: every ray goes through voxel centres, along edges of lattice
    # cells, the outer ones along faces and edges of the volume. All coordinates are exact.
    camera = axis_camera([8, 8, 8], axis, 17.0, sign=sign)
    scene = make_scene(
        waves((17, 17, 17)), camera=camera, width=17, height=17, step=0.125, filter=filter_name
    )
    # A voxel's own cell ends between two samples: that is seen to first order of the step.
    rgba = agree(device, context, scene, 6e-3 if filter_name == "nearest" else 2e-4)
    assert (rgba[..., 3] > 0).sum() == (exact(device, scene)[..., 3] > 0).sum()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("filter_name", ["linear", "nearest"])
def test_rays_along_faces_and_edges_of_the_volume_are_inside(context, axis, sign, filter_name):
    camera = axis_camera([8, 8, 8], axis, 17.0, sign=sign)
    scene = make_scene(
        np.ones((17, 17, 17), np.uint8), CONSTANT, camera=camera, width=17, height=17,
        filter=filter_name,
    )  # fmt: skip
    alpha = picture(context, scene).rgba[..., 3]
    np.testing.assert_allclose(alpha, np.full((17, 17), 1 - 0.8**16), rtol=1e-6)


@pytest.mark.parametrize("tiny", [0.0, -0.0, 5e-324, 1e-310, 1e-41, -1e-39, 1e-30, 1e-21, -1e-19])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_direction_components_of_zero_or_next_to_it_change_nothing(device, context, axis, tiny):
    pictures = []
    for offset in (0.0, tiny):
        camera = axis_camera([0, 0, 0], axis, 17.0, distance=1.0)
        target = [offset] * 3
        target[axis] = 0.0
        camera["target"] = target
        scene = make_scene(
            waves((17, 17, 17)), camera=camera, grid=CENTRED, width=17, height=17, step=0.25
        )
        pictures.append((picture(context, scene).rgba, exact(device, scene)))
    assert pictures[0][0][..., 3].min() > 0
    # Rays on the upper faces may leave the volume at once: they are compared where they are inside.
    for plain, other in zip(*pictures):
        np.testing.assert_allclose(other[1:-1, 1:-1], plain[1:-1, 1:-1], atol=1e-6)
        assert np.isfinite(other).all()


@pytest.mark.parametrize("towards", [(1, 1, 0), (1, -1, 0), (0, 1, 1), (1, 1, 1), (-1, 1, -1)])
@pytest.mark.parametrize("filter_name", ["linear", "nearest"])
def test_rays_through_edges_and_corners_of_cells_see_what_their_neighbours_see(
    device, context, towards, filter_name
):
    camera = {
        "projection": "orthographic", "position": (-20.0 * np.array(towards)).tolist(),
        "target": [0, 0, 0], "up": [0.3, 0.5, 0.9], "height": 1e-7,
    }  # fmt: skip
    scene = make_scene(
        waves((17, 17, 17)), camera=camera, grid=CENTRED, width=5, height=5, step=0.05,
        filter=filter_name,
    )  # fmt: skip
    rgba = picture(context, scene).rgba
    assert np.ptp(rgba, axis=(0, 1)).max() < (2e-3 if filter_name == "nearest" else 1e-5)
    if filter_name == "linear":
        np.testing.assert_allclose(rgba, exact(device, scene), atol=2e-4)


@pytest.mark.parametrize("towards", [(1, -1, 0), (1, 0, -1), (0, -1, 1), (1, 1, -2), (-2, 1, 1)])
def test_a_ray_that_touches_the_volume_in_one_point_sees_nothing(device, context, towards):
    """Through the corner at the origin, in a plane that has all of the volume on one side."""
    towards = np.array(towards, float)
    eye = -20.0 * towards
    camera = {
        "projection": "orthographic", "position": eye.tolist(), "target": [0, 0, 0],
        "up": [0.2, 0.3, 0.9], "height": 1.0,
    }  # fmt: skip
    opaque = TransferFunction([0], [0.9], GREY)
    scene = make_scene(np.ones((9, 9, 9), np.uint8), opaque, camera=camera, width=1, height=1)
    # In float32 the corner is known to 1e-6 of a voxel; so long a path absorbs 1e-5.
    assert picture(context, scene).rgba[0, 0, 3] < 1e-5
    direction = towards / np.linalg.norm(towards)
    rgba, _, _ = integrate_world_rays(
        scene.volume, opaque, eye[None], direction[None], device
    )
    assert rgba[0, 3] < 1e-12


# --- eyes ------------------------------------------------------------------------------------------

EYES = {
    "inside": (11.0, 8.0, 9.0),
    "inside, at a voxel": (5.0, 4.0, 3.0),
    "on a face": (0.0, 8.0, 9.0),
    "on an edge": (0.0, 0.0, 9.0),
    "at a corner": (0.0, 0.0, 0.0),
    "just outside a face": (-1e-6, 8.0, 9.0),
    "just inside a face": (1e-6, 8.0, 9.0),
}


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_the_eye_may_be_inside_or_on_the_boundary(
    device, context, eye, classification, projection
):
    camera = {
        "projection": projection, "position": EYES[eye], "target": [12.3, 9.1, 11.0],
        "up": [0, 1, 0], "fov_degrees": 100.0, "height": 9.0,
    }  # fmt: skip
    scene = make_scene(
        waves((19, 17, 23)), camera=camera, step=0.125, classification=classification
    )
    agree(device, context, scene, 1e-3)


def test_looking_away_from_the_volume_shows_nothing(device, context):
    camera = {"position": [-3, 8, 8], "target": [-10, 8, 8], "up": [0, 1, 0], "fov_degrees": 90.0}
    scene = make_scene(waves((17, 17, 17)), camera=camera)
    assert not picture(context, scene).rgba.any() and not exact(device, scene).any()


@pytest.mark.parametrize("sizes", [1e3, 1e6, 1e9])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_an_eye_a_million_volume_sizes_away_sees_the_same(device, context, sizes, projection):
    centre = np.array([8.0, 8.0, 8.0])
    towards = np.array([3.0, 2.0, 6.0]) / 7.0
    distance = 16.0 * sizes
    camera = {
        "projection": projection, "position": (centre - distance * towards).tolist(),
        "target": centre.tolist(), "up": [0, 1, 0], "height": 20.0,
        "fov_degrees": float(np.degrees(2 * np.arctan(10.0 / distance))),
    }  # fmt: skip
    scene = make_scene(waves((17, 17, 17)), camera=camera, step=0.125)
    near = {**camera, "projection": "orthographic", "position": (centre - 30 * towards).tolist()}
    parallel = exact(device, make_scene(waves((17, 17, 17)), camera=near))
    rgba = picture(context, scene).rgba
    assert parallel[..., 3].max() > 0.2
    # Doubles hold the eye to 1e-16 of its distance; and a view from there is not quite parallel.
    slack = 40.0 / distance + 1e-15 * distance
    np.testing.assert_allclose(rgba, parallel, atol=2e-4 + slack)
    np.testing.assert_allclose(exact(device, scene), parallel, atol=1e-6 + slack)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_a_field_of_view_of_a_thousandth_of_a_degree(device, context, classification):
    half = np.tan(np.radians(0.0005))
    distance = 8.0 / half  # the picture spans 16 voxels at the centre
    camera = {
        "position": [8.1, 8.2, 8.0 - distance], "target": [8.1, 8.2, 8.0], "up": [0, 1, 0],
        "fov_degrees": 0.001,
    }  # fmt: skip
    scene = make_scene(
        waves((17, 17, 17)), camera=camera, step=0.125, classification=classification
    )
    agree(device, context, scene)


@pytest.mark.parametrize("position", [(8.0, 8.0, 8.0), (8.0, 8.0, -0.01), (30.0, 20.0, -40.0)])
def test_a_field_of_view_of_179_degrees(device, context, position):
    camera = {
        "position": position, "target": [8.3, 8.1, 9.0], "up": [0, 1, 0], "fov_degrees": 179.0,
    }  # fmt: skip
    scene = make_scene(
        waves((17, 17, 17)), camera=camera, step=0.125, width=65, height=65
    )
    far = position[0] > 20
    rgba, reference = picture(context, scene).rgba, exact(device, scene)
    assert far or (reference[..., 3] > 0.01).mean() > 0.4
    np.testing.assert_allclose(rgba, reference, atol=5e-4)


# --- clip planes -----------------------------------------------------------------------------------


def clipped(clips, grid=None):
    volume = Volume(waves((9, 10, 11), np.uint8), **(grid or {}))
    return Scene(
        volume=volume, image={"width": 16, "height": 16}, clip=clips, transfer_function={"preset": "grayscale"}
    )


TILTED = {
    "spacing": (0.1, 0.3, 0.7), "origin": (0.1, -0.7, 1e3),
    "direction": np.array([[np.cos(0.7), -np.sin(0.7), 0], [np.sin(0.7), np.cos(0.7), 0], [0, 0, 1]]),
}  # fmt: skip


@pytest.mark.parametrize("grid", [{}, TILTED, {"spacing": (1e-6,) * 3}, {"spacing": (1e6,) * 3}])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("upper", [False, True])
@pytest.mark.parametrize("length", [1.0, 1e20, 1e-20])
def test_a_clip_plane_in_a_face_that_keeps_the_volume_is_not_called_for(grid, axis, upper, length):
    volume = clipped((), grid).volume
    index = np.zeros(4)
    index[axis], index[3] = (volume.grid.size[axis] - 1 if upper else 0), 1
    point = (volume.grid.index_to_world() @ index)[:3]
    inwards = np.linalg.inv(volume.grid.direction)[axis] * (-length if upper else length)
    scene = clipped(({"point": point.tolist(), "normal": inwards.tolist()},), grid).resolve()
    check_scene(scene)
    assert called_for(scene) == ["emission-absorption"]
    outwards = scene.clips[0].model_copy(update={"normal": tuple(-inwards)})
    assert "clipping" in called_for(clipped((outwards,), grid).resolve())


def test_a_clip_plane_in_a_face_that_keeps_the_volume_changes_no_bit(context):
    planes = ({"point": [0, 0, 0], "normal": [0, 1, 0]}, {"point": [10, 9, 8], "normal": [-1, 0, 0]})
    one, other = (picture(context, clipped(clips).resolve()).rgba for clips in ((), planes))
    assert one[..., 3].max() > 0.2 and np.array_equal(one, other)


@pytest.mark.parametrize("x", [0.001, 5.0, 9.999])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_clip_plane_that_cuts_is_called_for(x, sign):
    scene = clipped(({"point": [x, 0, 0], "normal": [sign, 0, 0]},)).resolve()
    check_scene(scene)
    assert called_for(scene) == ["emission-absorption", "clipping"]


@pytest.mark.parametrize("point, normal", [([10.0, 0, 0], [1, 0, 0]), ([99.0, 0, 0], [1, 0, 0]),
                                           ([0, 0, -1e20], [0, 0, -1e20])])  # fmt: skip
def test_a_clip_plane_that_removes_everything_is_called_for(point, normal):
    """As any plane that takes something away."""
    scene = clipped(({"point": point, "normal": normal},)).resolve()
    assert called_for(scene) == ["emission-absorption", "clipping"]


def test_a_camera_without_a_direction_is_refused():
    with pytest.raises(SceneError, match="position"):
        Scene(volume=Volume(np.ones((4, 4, 4))), camera=Camera(position=(1.5, 1.5, 1.5))).resolve()
    for up in ((0.0, 0.0, 0.0), (1.0, 0.0, 1e-9)):
        with pytest.raises((SceneError, ValueError), match="up"):
            Camera(position=(0, 0, 0), target=(1, 0, 0), up=up)
