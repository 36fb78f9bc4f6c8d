"""Tiles that see something: none is missed, and kernels without it give the same bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.small_scenes import make_scene, waves

from clvol.device.local_space import LocalSpace
from clvol.device.tile_effects import tiles_that_see
from clvol.device.view import ray_frame
from clvol.integrators.raycast.caster import Raycaster
from clvol.scene import Camera, ImageSettings, Isosurface
from clvol.volume import Volume
from clvol.volume.voxel_layout import CELL_SHIFT, padded_size

EDGE = 1 << CELL_SHIFT


def cameras(random, grid, image):
    """Random views, perspective and not, some with the eye inside."""
    centre = grid.world_corners().mean(axis=0)
    for _ in range(8):
        away = random.normal(size=3) * random.choice([4.0, 40.0, 150.0])
        kind = "perspective" if random.random() < 0.7 else "orthographic"
        yield Camera(
            projection=kind,
            position=tuple(centre + away),
            target=tuple(centre + random.normal(size=3) * 5),
            up=(0.1, 1.0, 0.2),
            fov_degrees=float(random.uniform(10, 130)),
            height=40.0,
        ).complete(grid, image)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_every_tile_with_a_ray_through_a_marked_cell_is_found(seed):
    random = np.random.default_rng(seed)
    shape = tuple(random.integers(1, 40, 3))
    spacing = tuple(random.uniform(0.3, 3.0, 3))
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    volume = Volume(np.zeros(shape, np.uint8), spacing=spacing, direction=turn)
    grid, size = volume.grid, padded_size(volume)
    cells = random.random([max(1, -(-(n - 1) // EDGE)) for n in size[::-1]]) < 0.15
    cells.flat[random.integers(cells.size)] = True
    image = ImageSettings(width=61, height=45)
    space = LocalSpace(grid, size)
    found = some = 0
    for camera in cameras(random, grid, image):
        tile = (8, 4)
        frame = ray_frame(camera, grid, image.width, image.height)
        seen = tiles_that_see(cells, size, frame, space.matrix, (61, 45), tile)
        seen = seen.reshape(-(-45 // 4), -(-61 // 8))
        origins, directions = camera.world_rays(image.width, image.height)
        t = np.linspace(0, 400, 1500)[:, None, None, None]
        linear = np.linalg.inv(space.matrix) / space.unit
        centre = 0.5 * (np.asarray(size) - 1)
        at = (origins - space.centre + t * directions) @ linear.T + centre
        inside = np.all((at >= 0) & (at <= np.asarray(size) - 1), axis=-1)
        which = np.minimum((at // EDGE).astype(int), np.array(cells.shape[::-1]) - 1)
        which = np.maximum(which, 0)
        met = inside & cells[which[..., 2], which[..., 1], which[..., 0]]
        rows, columns = np.nonzero(met.any(axis=0))
        assert seen[rows // 4, columns // 8].all()
        found += seen.sum()
        some += seen.size
    assert 0 < found < some  # not simply all of them


@pytest.mark.slow
def test_tiles_without_surfaces_are_rendered_without_and_show_the_same(context):
    array = waves((40, 33, 36))
    array[:, :, 12:] *= 0.5  # the surface is on one side
    level = float(array[:, :, 12:].max()) + 1.0
    surface = Isosurface(value=level, opacity=0.6, color=(0.2, 0.5, 1.0))
    surface = surface.model_copy(update={"back_color": surface.color})
    plain = make_scene(array, width=96, height=64, step=0.7)
    scene = replace(plain, isosurfaces=(surface,))
    split = Raycaster(context, scene, tile=(8, 8))
    whole = Raycaster(context, scene, tile=(8, 8))
    whole._without_surfaces = None
    got, expected = (caster.render(scene.camera, 96, 64) for caster in (split, whole))
    np.testing.assert_array_equal(got.rgba, expected.rgba)
    np.testing.assert_array_equal(got.depth, expected.depth)
    assert got.samples == expected.samples
    tiles = [got.counters[f"tiles_{kind}_surfaces"] for kind in ("with", "without")]
    assert sum(tiles) == 12 * 8 and min(tiles) > 0
    assert got.counters["surface_hits"] == expected.counters["surface_hits"] > 0
