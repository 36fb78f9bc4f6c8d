"""Quadrature by cells: the exact integral's neighbour, and everything that the ray caster promises."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, make_scene, rms, waves

from clvol import TransferFunction
from clvol.errors import SceneError
from clvol.explanation import kernel_hash
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.frame_view import parts_of_cell
from clvol.integrators.reference.picture import render_reference
from clvol.integrators.registry import check_scene

KINDS = ("post", "preintegrated")
PEAKS = TransferFunction(
    [0, 95, 100, 105, 175, 180, 185, 255],
    [0, 0, 0.7, 0, 0, 0.9, 0, 0],
    [[1, 0, 0]] * 4 + [[0, 1, 0]] * 4,
)


def scene_of(array=None, function=SMOOTH, *, kind="post", step=0.25, **more):
    return make_scene(
        array, function, classification=kind, quadrature="cells", step=step, **more
    )


def picture(context, resolved, **how):
    caster = Raycaster(context, resolved, **how)
    return caster.render(resolved.camera, resolved.image.width, resolved.image.height)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("step", [0.1, 1.0])
def test_a_homogeneous_slab_absorbs_by_its_length(context, kind, step):
    function = TransferFunction([0.0], [0.35], [[0.3, 0.5, 0.7]], opacity_unit=1.7)
    camera = {
        "projection": "orthographic", "position": [0.0, 1.0, 7.0], "target": [11.5, 1.0, 7.0],
        "up": [0.0, 1.0, 0.0], "height": 6.0,
    }  # fmt: skip
    grid = {"spacing": (0.5, 2.0, 3.0), "origin": (10.0, -4.0, 1.0)}
    array = np.full((5, 6, 7), 42, np.float32)
    scene = scene_of(array, function, kind=kind, step=step, camera=camera, grid=grid)
    opacity = -np.expm1(3.0 / 1.7 * np.log1p(-0.35))
    np.testing.assert_allclose(picture(context, scene).rgba[..., 3], opacity, atol=2e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_small_opacities_of_thousands_of_cells_add_up(context, kind):
    n = 2000
    function = TransferFunction([0.0], [1e-4], [[0.3, 0.5, 0.7]])
    camera = {"projection": "orthographic", "position": [-5, 1, 1], "target": [5, 1, 1], "height": 1.5}
    scene = scene_of(np.zeros((3, 3, n), np.float32), function, kind=kind, camera=camera)
    opacity = -np.expm1((n - 1) * np.log1p(-1e-4))
    np.testing.assert_allclose(picture(context, scene).rgba[..., 3], opacity, rtol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_it_goes_to_the_exact_integral_faster_than_steps(device, context, kind):
    array = np.random.default_rng(3).uniform(0, 255, (12, 13, 14)).astype(np.float32)
    scenes = [scene_of(array, kind=kind, step=step, table_size=512) for step in (0.5, 0.25, 0.0625)]
    exact = render_reference(scenes[0], device)[0]
    errors = [rms(picture(context, scene).rgba, exact) for scene in scenes]
    assert errors[0] > 3 * errors[1] > 9 * errors[2] and errors[2] < 3e-5, errors
    steps = make_scene(array, classification=kind, step=0.5, table_size=512)
    assert errors[0] < 0.8 * rms(picture(context, steps).rgba, exact)


def test_narrow_peaks_in_data_with_kinks_are_more_exact_than_with_steps(device, context):
    noise = np.random.default_rng(4).uniform(-12, 12, (20, 21, 22))
    array = np.clip(waves((20, 21, 22)) + noise, 0, 255).astype(np.uint8)
    exact = render_reference(scene_of(array, PEAKS), device)[0]
    cells = picture(context, scene_of(array, PEAKS, kind="preintegrated", step=0.5))
    steps = make_scene(array, PEAKS, classification="preintegrated", step=0.5)
    assert rms(cells.rgba, exact) < 0.7 * rms(picture(context, steps).rgba, exact)


@pytest.mark.parametrize("kind", KINDS)
def test_leaping_tiles_and_lanes_change_nothing(context, kind):
    array = np.zeros((40, 44, 60), np.float32)
    array[10:20, 12:30, 15:22] = 120
    function = TransferFunction([0, 60, 140], [0, 0, 0.5], [[1, 0.5, 0.2]] * 3)
    scene = scene_of(array, function, kind=kind, step=0.5, width=37, height=29)
    plain = picture(context, scene, lanes=16, skip=False)
    leaping = picture(context, scene, lanes=16)
    assert leaping.samples < 0.5 * plain.samples
    np.testing.assert_allclose(leaping.rgba, plain.rgba, atol=2e-6)
    tiled = picture(context, scene, lanes=16, tile=(4, 12))
    assert np.array_equal(leaping.rgba, tiled.rgba) and np.array_equal(leaping.depth, tiled.depth)
    single = picture(context, scene, lanes=1)
    np.testing.assert_allclose(single.rgba, leaping.rgba, atol=2e-5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (1, 5, 6), (4, 1, 1), (2, 2, 2), (9, 1, 17)], ids=str
)
def test_thin_volumes_agree_with_the_exact_integral(device, context, kind, shape):
    array = np.random.default_rng(5).uniform(0, 255, shape).astype(np.float32)
    scene = scene_of(array, kind=kind, step=0.1, table_size=512)
    exact = render_reference(scene, device)[0]
    assert exact[..., 3].max() > 0.01
    assert rms(picture(context, scene).rgba, exact) < 1e-4  # of which the table makes most


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rays_along_an_axis_and_in_the_faces_between_cells(device, context, kind, axis):
    array = np.random.default_rng(6).uniform(0, 255, (9, 9, 9)).astype(np.float32)
    away, up = np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
    camera = {
        "projection": "orthographic", "position": (np.full(3, 4.0) - 20 * away).tolist(),
        "target": [4.0, 4.0, 4.0], "up": up.tolist(), "height": 9.0,
    }  # fmt: skip
    # Nine pixels of one unit: their rays run exactly in planes of voxel centres.
    scene = scene_of(array, kind=kind, step=0.1, table_size=512, camera=camera, width=9, height=9)
    exact = render_reference(scene, device)[0]
    assert rms(picture(context, scene).rgba, exact) < 1e-4


@pytest.mark.parametrize("kind", KINDS)
def test_a_voxel_that_is_not_a_number_hides_the_cells_that_use_it(device, context, kind):
    array = waves((11, 12, 13))
    array[5, 6, 6] = np.nan
    array[2, 3, 4] = np.inf
    scene = scene_of(array, kind=kind, step=0.125)
    data = picture(context, scene)
    assert np.isfinite(data.rgba).all()
    assert rms(data.rgba, render_reference(scene, device)[0]) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_opaque_data_stop_rays_and_have_a_depth(device, context, kind):
    z, y, x = np.mgrid[:33, :33, :33] - 16.0
    array = (100.0 - 5.0 * np.sqrt(x * x + y * y + z * z)).astype(np.float32)
    function = TransferFunction([0, 48, 52, 100], [0, 0, 1, 1], [[1, 0, 0]] * 4)
    camera = {"position": [16, 16, -60], "target": [16, 16, 16], "fov_degrees": 20.0}
    scene = scene_of(array, function, kind=kind, step=0.25, camera=camera, width=41, height=41)
    exact, depth, _ = render_reference(scene, device)
    data = picture(context, scene)
    seen = exact[..., 3] > 0.99
    assert seen.sum() > 100
    np.testing.assert_allclose(data.depth[seen], depth[seen], atol=0.3)


def test_early_termination_ends_rays_and_keeps_its_promise(context):
    array = np.full((20, 20, 20), 100, np.float32)
    function = TransferFunction([0], [0.3], [[1, 1, 1]])
    stopped, whole = (
        picture(context, scene_of(array, function, early_termination=t)) for t in (0.1, 0.0)
    )
    assert stopped.samples < 0.8 * whole.samples
    assert 0 < np.abs(stopped.rgba - whole.rgba).max() <= 0.1


def test_the_step_says_the_parts():
    assert [parts_of_cell(step) for step in (8.0, 1.0, 0.5, 0.25, 0.2, 0.125)] == [1, 1, 2, 4, 4, 8]


def test_what_it_cannot_do_is_refused_in_one_line():
    for wrong in ({"kind": "pre"}, {"filter": "nearest"}, {"filter": "cubic"}):
        with pytest.raises(SceneError, match="integration.quadrature.*cells"):
            check_scene(scene_of(**wrong))


def test_it_is_another_kernel():
    assert kernel_hash(scene_of()) != kernel_hash(make_scene(classification="post", step=0.25))
