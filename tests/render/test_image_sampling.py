"""Fewer rays than pixels: sparse pictures, and pixels interpolated between rays that agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import SMOOTH, make_scene, rms, waves

from clvol import Renderer, TransferFunction
from clvol.device.view import PixelLattice
from clvol.integrators.raycast.caster import Raycaster
from clvol.render.prepared_cache import PreparedCache

SIZE = (53, 47)


def scene_of(spacing=1, tolerance=0.01, **more):
    width, height = SIZE
    resolved = make_scene(waves((21, 19, 23)), width=width, height=height, **more)
    image = resolved.image.model_copy(update={"ray_spacing": spacing, "ray_tolerance": tolerance})
    return replace(resolved, image=image)


def picture(context, resolved, **how):
    return Raycaster(context, resolved).render(resolved.camera, *SIZE, **how)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_a_lattice_has_the_very_pixels_of_the_picture(context, projection):
    scene = scene_of(camera={"projection": projection})
    whole = picture(context, scene)
    lattice = PixelLattice(4, 3, 1)
    sparse = picture(context, scene, lattice=lattice)
    rows, columns = lattice.pixels(*SIZE).T
    np.testing.assert_allclose(sparse.rgba.reshape(-1, 4), whole.rgba[rows, columns], atol=2e-6)
    assert sparse.rays == len(rows) and sparse.samples < whole.samples / 8


@pytest.mark.parametrize("spacing", [2, 3, 8, 16])
def test_without_tolerance_only_what_lies_between_equal_rays_is_not_cast(context, spacing):
    whole, filled = picture(context, scene_of()).rgba, picture(context, scene_of(spacing, 0.0)).rgba
    for row, column in np.argwhere(np.abs(filled - whole).max(axis=-1) > 2e-6):
        top, left = row // spacing * spacing, column // spacing * spacing
        corners = filled[top : top + spacing + 1 : spacing, left : left + spacing + 1 : spacing]
        assert np.ptp(corners.reshape(-1, 4), axis=0).max() == 0
    np.testing.assert_allclose(filled[::spacing, ::spacing], whole[::spacing, ::spacing], atol=2e-6)


@pytest.mark.parametrize("spacing", [2, 4])
def test_more_tolerance_means_fewer_rays_and_more_error(context, spacing):
    whole = picture(context, scene_of())
    found = [picture(context, scene_of(spacing, t)) for t in (0.0, 0.003, 0.03, 0.3)]
    rays = [data.rays for data in found]
    errors = [rms(data.rgba, whole.rgba) for data in found]
    assert rays == sorted(rays, reverse=True) and rays[-1] < 0.5 * whole.rays
    assert errors == sorted(errors) and errors[-1] < 0.05
    samples = [data.samples for data in found]
    assert samples == sorted(samples, reverse=True)


def test_what_is_interpolated_lies_between_rays_that_agree(context):
    # Everywhere inside a smooth field: nothing hides between the rays.
    near = {"camera": {"projection": "orthographic", "height": 7.0}}
    tolerance = 0.05
    whole, filled = picture(context, scene_of(**near)), picture(context, scene_of(4, tolerance, **near))
    assert whole.rgba[..., 3].min() > 0.1 and filled.rays < 0.8 * whole.rays
    assert 0 < np.abs(filled.rgba - whole.rgba).max() < tolerance


def test_tiles_do_not_change_a_bit(context):
    scene = scene_of(4, 0.02)
    pictures = [
        Raycaster(context, scene, lanes=16, tile=tile).render(scene.camera, *SIZE)
        for tile in ((16, 16), (8, 4), (32, 64))
    ]
    for other in pictures[1:]:
        assert np.array_equal(pictures[0].rgba, other.rgba)
        assert np.array_equal(pictures[0].depth, other.depth)
        assert (pictures[0].rays, pictures[0].samples) == (other.rays, other.samples)


def test_single_rays_and_packets_agree(context):
    scene = scene_of(4, 0.02)
    packet, single = (
        Raycaster(context, scene, lanes=lanes).render(scene.camera, *SIZE) for lanes in (16, 1)
    )
    np.testing.assert_allclose(packet.rgba, single.rgba, atol=2e-5)


def test_no_depth_is_made_up_between_something_and_nothing(context):
    array = np.zeros((9, 9, 9), np.float32)
    array[2:7, 2:7, 2:7] = 255
    function = TransferFunction([0, 100, 255], [0, 0, 1.0], [[1, 1, 1]] * 3)
    resolved = make_scene(array, function, width=53, height=47)
    whole = picture(context, resolved)
    image = resolved.image.model_copy(update={"ray_spacing": 4, "ray_tolerance": 1.0})
    filled = picture(context, replace(resolved, image=image))
    finite = np.isfinite(filled.depth)
    assert finite.any() and not finite.all()
    assert np.isfinite(whole.depth[finite]).all()


def test_pictures_smaller_than_the_spacing(context):
    for width, height in ((1, 1), (3, 1), (2, 5), (17, 16)):
        resolved = make_scene(width=width, height=height)
        image = resolved.image.model_copy(update={"ray_spacing": 16, "ray_tolerance": 0.0})
        caster = Raycaster(context, replace(resolved, image=image))
        data = caster.render(resolved.camera, width, height)
        plain = Raycaster(context, resolved).render(resolved.camera, width, height)
        np.testing.assert_allclose(data.rgba, plain.rgba, atol=2e-6)


def test_the_scene_key_reaches_the_renderer_and_its_stats(device):
    with Renderer(scene_of(4, 0.1), [device]) as renderer:
        stats = renderer.render().stats
    assert 0 < stats["rays"] < SIZE[0] * SIZE[1]


def test_engines_of_one_scene_share_tables_and_volume(context):
    engines = PreparedCache(context)
    first, second = engines.prepare(scene_of()), engines.prepare(scene_of())
    third = engines.prepare(scene_of(2))
    assert first.volume is not second.volume  # two volumes, however alike
    resolved = scene_of()
    image = resolved.image.model_copy(update={"ray_spacing": 2})
    one, other = engines.prepare(resolved), engines.prepare(replace(resolved, image=image))
    assert one.table is other.table and one.resolved.image.ray_spacing == 1
    assert other.resolved.image.ray_spacing == 2 and third.resolved.image.ray_spacing == 2
    assert SMOOTH is resolved.transfer_function
