"""Pictures of levels of the volume: beside numpy's, on lanes and devices alike, and refused where they mean nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.field_points import rough
from helpers.small_scenes import SMOOTH, axis_camera, make_scene, picture, rms, waves
from reference import render_twin
from reference.levels import LevelsField

from clvol import Renderer, Scene, TransferFunction, Volume, VolumeSeries
from clvol.accuracy.ground_truth import GroundTruth
from clvol.device.levels import LevelledVolume
from clvol.device.view import PixelLattice
from clvol.errors import SceneError, VolumeError
from clvol.explanation import explain, kernel_hash
from clvol.features import effects
from clvol.integrators.raycast.levels import LevelsCaster, levels_of_picture
from clvol.integrators.registry import check_scene, integrator_of
from clvol.scene import ImageSettings, Light
from clvol.volume.level_layout import coarser_bytes

NEAR = {"position": (30.0, 24.0, -14.0), "target": (14.0, 9.0, 11.0), "up": (0.0, 1.0, 0.0), "fov_degrees": 60.0}
INSIDE = {"position": (4.0, 8.0, 3.0), "target": (22.0, 9.0, 12.0), "up": (0.0, 1.0, 0.0), "fov_degrees": 90.0}
SMALL = {"width": 9, "height": 7}
SHAPE = (23, 18, 29)
LIGHT = {"type": "directional", "direction": (0.3, -0.5, 0.9)}
WHITE = [1.0, 1.0, 1.0]


def levelled(array=None, **how):
    array = waves(SHAPE) if array is None else array
    return make_scene(array, minification="levels", **{**SMALL, "level_bias": 0.0, **how})


def caster_of(context, resolved, **how) -> LevelsCaster:
    return LevelsCaster(context, resolved, LevelledVolume(context, resolved.volume), **how)


def render(context, resolved, depth=True, **how):
    image = resolved.image
    return caster_of(context, resolved, **how).render(resolved.camera, image.width, image.height, depth=depth)


def twin(resolved):
    """numpy's picture: the fields of levels, in steps of voxels of the finest one."""
    image, integration = resolved.image, resolved.integration
    first, _ = levels_of_picture(resolved, resolved.camera, (image.width, image.height))
    field = LevelsField(resolved.volume, resolved.camera, image.height, integration.level_bias)
    return render_twin(resolved, step=integration.step * 2**first, field=field)


def cases():
    def of(dtype, **how):
        return lambda: levelled(rough(SHAPE, np.dtype(dtype)), **how)

    yield "float32", of("float32", camera=NEAR)
    yield "uint8", of("uint8", camera=NEAR)
    yield "int16", of("int16", camera=NEAR, classification="post")
    yield "float64", of("float64", camera=NEAR)
    yield "inside", of("float32", camera=INSIDE, width=5, height=4)
    yield "orthographic", of("uint16", camera=axis_camera((14, 9, 11), 0, 40.0), classification="post")
    yield "at a level", of("float32", camera=axis_camera((14, 9, 11), 2, 28.0))  # 4 voxels a pixel: one level
    yield "bias", of("uint8", camera=NEAR, level_bias=-1.3)
    flat = {"grid": {"spacing": (0.6, 0.6, 2.5), "direction": [[0, 1, 0], [1, 0, 0], [0, 0, -1]], "origin": (1, 2, 30)}}
    yield "anisotropic", of("float32", camera={**NEAR, "target": (6.0, 9.0, 4.0)}, **flat)
    yield "thin", lambda: levelled(rough((1, 30, 40), np.float32), camera=axis_camera((20, 15, 0), 2, 60.0))


CASES = list(cases())


@pytest.mark.parametrize(("name", "make"), CASES, ids=[name for name, _ in CASES])
def test_pictures_are_numpys(context, name, make):
    resolved = make()
    found = render(context, resolved)
    assert found.notes["minification"]["levels"][1] > 0
    assert rms(found.rgba, twin(resolved)) < 2e-4
    assert found.rgba[..., 3].max() > 0.05


def test_holes_grow_with_what_a_pixel_covers(context):
    array = rough(SHAPE, np.float32)
    array[5:12, 6:12, 8:20], array[15, 9, 9] = np.nan, np.inf
    resolved = levelled(array, camera=NEAR, classification="post")
    assert rms(render(context, resolved).rgba, twin(resolved)) < 2e-4


@pytest.mark.parametrize("camera", [NEAR, axis_camera((14, 9, 11), 0, 40.0)])
def test_lit_pictures_take_gradients_of_levels(context, camera):
    base = levelled(rough(SHAPE, np.float32), camera=camera, classification="post")
    scene = Scene(
        volume=base.volume, transfer_function=SMOOTH, camera=base.camera, image=base.image,
        integration=base.integration, light=[LIGHT], material={"ambient": 0.2, "two_sided": True},
        clip=[{"point": (12.0, 0, 0), "normal": (1.0, 0.2, 0)}], depth_cue={"start": 10.0, "end": 60.0},
    )  # fmt: skip
    resolved = scene.resolve()
    assert rms(render(context, resolved).rgba, twin(resolved)) < 5e-4
    assert not np.allclose(render(context, resolved).rgba, render(context, base).rgba, atol=0.02)


def test_means_that_join_what_holes_part_are_lit(context):
    """No voxel that shows is beside one of another value, but voxels of levels are."""
    array = np.full((16, 16, 24), 100.0, np.float32)
    array[..., 9:12], array[..., 12:] = np.nan, 50.0
    function = TransferFunction([60, 95, 105, 140], [0, 0.4, 0.4, 0], [WHITE] * 4)
    camera = axis_camera((11.5, 7.5, 7.5), 2, 72.0)  # 8 voxels a pixel

    def lit(**how):
        base = make_scene(array, function, camera=camera, width=9, height=9, classification="post", **how)
        return replace(base, lights=(Light(**LIGHT),))

    called_for = [
        {effect.name for effect in effects(resolved) if effect.called_for}
        for resolved in (lit(), lit(minification="levels", level_bias=0.0))
    ]
    assert "lighting" not in called_for[0] and "lighting" in called_for[1]
    resolved = lit(minification="levels", level_bias=0.0)
    found = render(context, resolved)
    assert rms(found.rgba, twin(resolved)) < 5e-4
    assert not np.allclose(found.rgba, render(context, replace(resolved, lights=())).rgba, atol=0.02)


@pytest.mark.parametrize("camera", [{**NEAR, "position": (60.0, 44.0, -64.0)}, axis_camera((14, 19, 21), 0, 50.0)])
def test_what_is_leapt_over_shows_nothing(context, camera):
    """Of a function that shows little, of voxels whose means show elsewhere than they do."""
    array = np.zeros((40, 40, 40), np.uint8)
    array[:12:7, :12:5, :12:6], array[20:30, 20:30, 20:30] = 255, 90
    function = TransferFunction([0, 3, 8, 9, 80, 90, 100], [0, 0, 0.4, 0, 0, 0.2, 0], [WHITE] * 7)
    for bias in (-1.5, 0.0):
        resolved = levelled(array, function=function, camera=camera, level_bias=bias, width=30, height=24)
        leaping, plodding = (render(context, resolved, skip=skip) for skip in (True, False))
        assert leaping.samples < 0.9 * plodding.samples
        np.testing.assert_array_equal(leaping.rgba, plodding.rgba)
        np.testing.assert_array_equal(leaping.depth, plodding.depth)
        assert leaping.rgba[..., 3].max() > 0.05


def test_a_ray_is_the_same_in_any_packet(context):
    resolved = levelled(rough(SHAPE, np.uint8), camera=NEAR)
    many, one = (render(context, resolved, lanes=lanes) for lanes in (16, 1))
    assert rms(many.rgba, one.rgba) < 1e-6
    assert many.counters == one.counters and many.samples == one.samples
    tiles = render(context, resolved, tile=(4, 4))
    np.testing.assert_array_equal(many.rgba, tiles.rgba)


def test_pixels_of_a_voxel_or_less_see_the_voxels(context):
    """Bit for bit, and in as many samples."""
    array = rough(SHAPE, np.uint16)
    camera = axis_camera((14, 9, 11), 0, 18.0)
    resolved = levelled(array, camera=camera, width=24, height=20)
    found, plain = render(context, resolved), picture(context, make_scene(array, camera=camera, width=24, height=20))
    np.testing.assert_array_equal(found.rgba, plain.rgba)
    np.testing.assert_array_equal(found.depth, plain.depth)
    assert found.samples == plain.samples == found.counters["finest_samples"]
    assert found.counters["level_blends"] == 0 and found.notes["minification"] == {"levels": [0, 0], "step": 1.0}


def test_coarse_levels_take_fewer_samples(context):
    array, camera = rough(SHAPE, np.uint8), axis_camera((14, 9, 11), 0, 70.0)
    found = render(context, levelled(array, camera=camera, width=10, height=10))  # 7 voxels a pixel
    plain = picture(context, make_scene(array, camera=camera, width=10, height=10))
    assert found.notes["minification"] == {"levels": [2, 3], "step": 4.0}
    assert found.samples < 0.4 * plain.samples
    assert found.counters == {"level_blends": found.samples, "finest_samples": 0}


def test_levels_hold_the_average_of_a_linear_medium(context):
    """Where colours and opacities are linear and thin, a mean of values is as good as a mean of pixels."""
    array = rough((32, 32, 32), np.float32)
    function = TransferFunction([0, 255], [0.0, 0.01], [WHITE] * 2)
    camera = axis_camera((15.5, 15.5, 15.5), 0, 32.0)
    fine = picture(context, make_scene(array, function, camera=camera, width=128, height=128)).rgba
    truth = fine.reshape(8, 16, 8, 16, 4).mean(axis=(1, 3))
    of_levels = render(context, levelled(array, function=function, camera=camera, width=8, height=8, level_bias=-1.0))
    of_voxels = picture(context, make_scene(array, function, camera=camera, width=8, height=8))
    inner = np.s_[1:-1, 1:-1]  # whose pixels lie in the volume as a whole
    assert rms(of_levels.rgba[inner], truth[inner]) < 0.6 * rms(of_voxels.rgba[inner], truth[inner])


def test_sparse_pixels_are_those_of_the_whole_picture(context):
    resolved = levelled(rough(SHAPE, np.uint8), camera=NEAR, width=17, height=14)
    caster = caster_of(context, resolved)
    whole = caster.render(resolved.camera, 17, 14).rgba
    lattice = PixelLattice(3, 1, 2)
    np.testing.assert_allclose(caster.render(resolved.camera, 17, 14, lattice=lattice).rgba, whole[lattice.slices],
                               atol=2e-6)  # fmt: skip


@pytest.mark.parametrize("refine", ["edges", "all"])
@pytest.mark.parametrize("samples", [4, 16])
def test_rays_of_a_pixel_cover_their_share_of_it(device, refine, samples):
    image = ImageSettings(width=8, height=6, samples=samples, refine=refine, edge_threshold=0.0)
    base = levelled(rough(SHAPE, np.uint8), camera=axis_camera((14, 9, 11), 0, 24.0))  # 4 voxels a pixel
    scene = Scene(volume=base.volume, transfer_function=SMOOTH, camera=base.camera, image=image,
                  integration=base.integration)  # fmt: skip
    with Renderer(scene, [device]) as renderer:
        stats = renderer.render().stats
    level = {4: 1, 16: 0}[samples]
    assert stats["minification"] == {"levels": [level, level], "step": 2.0**level}


def test_a_picture_is_the_same_through_a_renderer_and_another_camera(device, context):
    resolved = levelled(rough(SHAPE, np.uint8), camera=NEAR)
    scene = Scene(volume=resolved.volume, transfer_function=SMOOTH, camera=resolved.camera, image=resolved.image,
                  integration=resolved.integration)  # fmt: skip
    near = resolved.camera
    far = near.model_copy(update={"position": (70.0, 60.0, -60.0)})
    with Renderer(scene, [device]) as renderer:
        first = renderer.render()
        other = renderer.render(camera=far)
        again = renderer.render(camera=near)
    assert first.stats["minification"]["levels"] != other.stats["minification"]["levels"]
    np.testing.assert_array_equal(first.rgba, again.rgba)
    np.testing.assert_array_equal(first.rgba, render(context, resolved).rgba)


def test_steps_of_a_series_have_levels_of_their_own(device):
    arrays = [rough(SHAPE, np.float32), waves(SHAPE)]
    resolved = levelled(arrays[0], camera=NEAR)
    scene = Scene(volume=VolumeSeries(arrays), transfer_function=SMOOTH, camera=resolved.camera, image=resolved.image,
                  integration=resolved.integration)  # fmt: skip
    alone = []
    for array in arrays:
        one = Scene(volume=Volume(array), transfer_function=SMOOTH, camera=resolved.camera, image=resolved.image,
                    integration=resolved.integration)  # fmt: skip
        with Renderer(one, [device]) as renderer:
            alone.append(renderer.render().rgba)
    with Renderer(scene, [device]) as renderer:
        for time, wanted in zip((0.0, 1.0), alone):
            np.testing.assert_allclose(renderer.render(time=time).rgba, wanted, atol=1e-6)


def test_what_is_not_used_costs_nothing(context):
    array = rough(SHAPE, np.uint8)
    plain = make_scene(array)
    assert kernel_hash(plain) == kernel_hash(make_scene(array, level_bias=2.0))
    assert kernel_hash(levelled(array)) != kernel_hash(plain)
    small = rough((2, 1, 2), np.uint8)  # nothing can be halved
    assert kernel_hash(make_scene(small)) == kernel_hash(make_scene(small, minification="levels"))
    clear = TransferFunction([0, 255, 400], [0, 0, 1], [WHITE] * 3)
    idle, empty = make_scene(array, clear, minification="levels"), make_scene(array, clear)
    assert kernel_hash(idle) == kernel_hash(empty)


def test_explain_names_the_levels():
    explained = explain(levelled(rough(SHAPE, np.uint8), camera=NEAR))
    effect = next(each for each in explained["effects"] if each["name"] == "minification")
    assert effect["called_for"] and "4 coarser levels" in effect["reason"]
    assert explained["minification"]["mode"] == "levels"
    first, last = explained["minification"]["levels"]
    assert 0 < first < last and f"voxels of level {first}" in explained["minification"]["reason"]
    assert explain(make_scene(rough(SHAPE, np.uint8)))["minification"]["mode"] == "off"


def test_memory_counts_levels(device):
    resolved, plain = levelled(), make_scene(waves(SHAPE), **SMALL)
    more = [integrator_of(each).device_bytes(each.volume, each) for each in (resolved, plain)]
    assert more[0] - more[1] == coarser_bytes(resolved.volume) > 0
    scene = Scene(volume=resolved.volume, transfer_function=SMOOTH, image=resolved.image,
                  integration=resolved.integration)  # fmt: skip
    with pytest.raises(VolumeError, match="memory cap"), Renderer(scene, [device], more[1] + 8):
        pass


def test_errors_are_measured_beside_the_voxels():
    """What levels average is part of the error."""
    truth = GroundTruth(levelled(rough(SHAPE, np.uint8)), None)
    assert truth.is_exact and truth.resolved.integration.minification == "off"


REFUSED = [
    ({"integration": {"filter": "cubic"}}, "the filter 'cubic': levels are made for the linear one"),
    ({"integration": {"filter": "nearest"}}, "the filter 'nearest'"),
    ({"integration": {"classification": "pre"}}, "means of values, not of colours"),
    ({"integration": {"quadrature": "cells"}}, "cells are those of voxels"),
    ({"integration": {"compositing": "maximum"}}, "means have other extremes than voxels"),
    ({"integration": {"method": "pyramid"}}, "minification"),
    ({"integration": {"method": "slicing"}}, "minification"),
    ({"integration": {"method": "multiresolution"}}, "minification"),
    ({"integration": {"method": "reference"}}, "minification"),
    ({"isosurface": [{"value": 100.0}]}, "surfaces are found in cells of voxels"),
    ({"light": [LIGHT], "shadow": {}}, "light is found in the voxels"),
    ({"light": [LIGHT], "gradient": {"operator": "sobel", "storage": "on-the-fly"}}, "central differences"),
    ({"light": [LIGHT], "gradient": {"storage": "precomputed"}}, "gradients are those of levels"),
    ({"gradient_opacity": {"points": [{"magnitude": 0, "opacity": 0}, {"magnitude": 5, "opacity": 1}]}},
     "magnitudes of gradients depend on the level"),
    ({"noise": [{"target": "value", "amplitude": 3.0}]}, "its terms have sizes of their own"),
    ({"field": [{"file": Volume(np.ones((4, 4, 4), np.uint8)), "role": "label",
                 "labels": [{"label": 1, "color": WHITE}]}]}, "means of labels mean nothing"),
    ({"compression": {"codec": "rvq", "decode": "resident"}}, "calls for minification"),
]  # fmt: skip


@pytest.mark.parametrize(("tables", "why"), REFUSED, ids=lambda each: each if isinstance(each, str) else "")
def test_what_levels_do_not_go_with_is_refused(tables, why):
    tables = {**tables, "integration": {"minification": "levels", **tables.get("integration", {})}}
    scene = Scene(volume=Volume(waves((9, 8, 10), np.uint8)), transfer_function=SMOOTH, **tables)
    with pytest.raises(SceneError, match=why):
        check_scene(scene.resolve())


def test_a_bias_beyond_four_levels_is_refused():
    with pytest.raises(SceneError, match="integration.level_bias.*from -4 to 4"):
        Scene(volume=Volume(waves((9, 8, 10))), transfer_function=SMOOTH, integration={"level_bias": 5.0})
