"""How slices and rays lie to each other, and what maps take: arithmetic, without a device."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.pyramid_scenes import CAMERA, pyramid_scene
from helpers.small_scenes import axis_camera, waves

from clvol.integrators.pyramid.cells import decoded_distances, distance_codes, squared_gaps
from clvol.integrators.pyramid.layout import map_bytes, map_shape, map_shift, pyramid_bytes
from clvol.integrators.pyramid.slices import SlicePlan, slice_plan


def plan_of(**asked) -> SlicePlan:
    resolved = pyramid_scene(**asked)
    return slice_plan(resolved, resolved.camera, resolved.image.width, resolved.image.height)


def test_parallel_rays_stay_as_far_apart_as_they_are():
    plan = plan_of(camera=axis_camera((22.0, 18.0, 19.5), height=36.0), height=36, step=1.0)
    assert plan.growth == 0.0 and plan.spacing == pytest.approx(1.0) and plan.oversampling == 0


@pytest.mark.parametrize(
    ("step", "levels", "more"), [(1.0, 3, 0), (2.0, 3, 1), (4.1, 3, 2), (9.0, 3, 2), (9.0, 1, 3), (0.2, 3, 0)]
)
def test_rays_nearer_than_slices_get_levels_more(step, levels, more):
    """Of all there may be, five."""
    camera = axis_camera((22.0, 18.0, 19.5), height=36.0)
    plan = plan_of(camera=camera, height=36, step=step, levels=levels)
    assert (plan.levels, plan.oversampling) == (levels, more)


def test_rays_of_a_perspective_view_grow_apart(context):
    plan = plan_of(height=36, step=0.7)
    resolved = pyramid_scene(height=36)
    rays = resolved.camera.world_rays(40, 36)[1]
    middle = rays[18, 20], rays[18, 21]
    angle = np.arccos(np.clip(np.dot(*middle), -1, 1))
    assert plan.growth == pytest.approx(0.7 * angle, rel=0.02)
    eye = np.asarray(CAMERA["position"])
    away = np.linalg.norm(resolved.volume.grid.world_corners().mean(axis=0) - eye)
    assert plan.spacing < away * angle < plan.spacing + 200 * plan.growth


def test_bytes_of_distances_round_down():
    distances = np.array([0.0, 0.05, 0.5, 1.0, 1.03, 7.99, 64.0, 255.0])
    back = decoded_distances(distance_codes(distances))
    assert (back <= distances).all() and (back[2:] > distances[2:] * (1 - 1 / 16)).all()
    assert back[3] == 1.0 and back[6] == 64.0 and back[0] == 0.0
    assert (np.diff(decoded_distances(np.arange(256, dtype=np.uint8))) > 0).all()


def test_gaps_between_cells_are_rounded_down_and_end():
    gaps = squared_gaps(1.5, 4.0, 0.25)
    assert gaps[:4].tolist() == [0, 0, 36, 144] and len(gaps) == 5
    assert squared_gaps(100.0, 250.0, 0.25).max() == 65535


def test_maps_are_as_fine_as_voxels_while_they_are_small():
    assert map_shift((512, 512, 512)) == 0 and map_shift((2048, 2048, 2048)) == 1
    assert map_shape((41, 5, 2), 1) == (1, 2, 20)
    assert map_bytes((1, 2, 20)) == 5 * 64 + 4


def test_memory_counts_maps_and_tables():
    scene = pyramid_scene(waves((40, 37, 45)))
    assert pyramid_bytes(scene.volume, scene) > 7 * 39 * 36 * 44
