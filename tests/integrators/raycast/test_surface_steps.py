"""Iso-surfaces whatever the step: the same pixels, all crossings of a cell, grazed ones, faces, holes."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import HAZE, LIGHTS, MATERIAL, NOTHING, ball, oblique, picture, scene
from reference.cell_crossings import cell_crossings
from reference.field import Field

from clvol import TransferFunction, Volume, load_volume

FILTERS = ["nearest", "linear", "cubic", "catmull-rom"]
STEPS = (4.0, 1.3, 1.0, 0.5, 0.125)
SHAPE = (9, 11, 10)
LIT = {"light": LIGHTS, "material": MATERIAL}


def rough(shape=SHAPE, seed=1, dtype=np.uint8) -> np.ndarray:
    """Independent voxels: fields that turn in every cell."""
    return np.random.default_rng(seed).integers(0, 256, shape).astype(dtype)


def at_steps(context, array, function=NOTHING, steps=STEPS, filter="linear", **tables):
    for step in steps:
        integration = {"step": step, "filter": filter}
        yield picture(context, scene(array, function, integration=integration, **tables))


def assert_same(pictures):
    first, *others = pictures
    for other in others:
        assert np.array_equal(first.rgba, other.rgba)
        assert np.array_equal(first.depth, other.depth)
        assert first.counters == other.counters
    return first


def test_a_vessel_tree_covers_the_same_pixels(context, shared_volume):
    """Vessels a voxel wide: what even steps meet of them hangs on where the samples fall."""
    volume = load_volume(shared_volume("aneurism.nrrd"))
    same = assert_same(at_steps(context, volume, size=(128, 128), isosurface=[{"value": 100.0}]))
    assert np.sum(same.rgba[..., 3] == 1.0) == np.isfinite(same.depth).sum() == 902


@pytest.mark.parametrize("filter", FILTERS)
def test_surfaces_alone_are_the_same_picture_bit_for_bit(context, filter):
    surfaces = [
        {"value": 120.0, "opacity": 0.5, "refraction": 1.1}, {"value": 90.0, "opacity": 0.3},
        {"value": 160.0, "color": [0.2, 0.3, 0.9], "opacity": 0.9},
    ]  # fmt: skip
    clip = [{"point": [4.5, 5.0, 4.0], "normal": [0.3, -0.2, 1.0]},
            {"type": "sphere", "center": [3.0, 5.0, 6.0], "radius": 2.5, "keep": "outside"}]  # fmt: skip
    same = assert_same(at_steps(context, rough(), filter=filter, steps=(4.0, 1.0, 0.3), clip=clip,
                                camera=oblique(SHAPE), isosurface=surfaces, **LIT))  # fmt: skip
    assert same.counters["surface_hits"] > 400 and same.counters["bends"] > 100


def test_noise_moves_surfaces_the_same_way_at_every_step(context):
    noise = [{"target": "value", "amplitude": 30.0, "frequency": 3.0},
             {"target": "coordinate", "amplitude": 0.4, "frequency": 2.0}]  # fmt: skip
    surfaces = [{"value": 90.0, "opacity": 0.3}, {"value": 140.0}]
    same = assert_same(at_steps(context, 20 * ball(SHAPE), camera=oblique(SHAPE), noise=noise,
                                isosurface=surfaces, steps=(3.0, 0.7)))  # fmt: skip
    assert same.counters["surface_hits"] > 200


@pytest.mark.parametrize("filter", ["linear", "cubic"])
def test_only_the_volume_between_surfaces_depends_on_the_step(context, filter):
    """Hits and the share that surfaces leave are the same; the haze converges."""
    surfaces = [{"value": 120.0, "opacity": 0.4}, {"value": 60.0, "opacity": 0.2}]
    haze = TransferFunction(255.0 * HAZE.values, HAZE.opacities, HAZE.colors)
    pictures = list(at_steps(context, rough(), haze, filter=filter, camera=oblique(SHAPE),
                             isosurface=surfaces, steps=(2.0, 0.5, 0.125, 0.0625)))  # fmt: skip
    assert len({p.counters["surface_hits"] for p in pictures}) == 1
    apart = [np.abs(p.rgba - pictures[-1].rgba).max() for p in pictures[:-1]]
    assert apart[0] > 4 * apart[1] > 16 * apart[2] and apart[2] < 2e-3


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_every_crossing_of_random_cells_is_met(context, filter, dtype):
    """Voxels without any order, four iso-values: as many crossings as the polynomials have roots in
    double precision, in their order, on all rays but those that graze one."""
    array = rough(seed=7, dtype=dtype)
    values = [60.5, 100.5, 128.0, 190.0]
    opacities = [0.13, 0.07, 0.11, 0.05]
    surfaces = [{"value": v, "opacity": o} for v, o in zip(values, opacities)]
    resolved = scene(array, NOTHING, camera=oblique(SHAPE), isosurface=surfaces, size=(40, 30),
                     integration={"filter": filter, "step": 2.0})  # fmt: skip
    data = picture(context, resolved)
    origins, directions = (r.reshape(-1, 3) for r in resolved.camera.world_rays(40, 30))
    met = cell_crossings(Field(Volume(array), filter), origins, directions,
                         *domain(SHAPE, origins, directions), values)  # fmt: skip
    there = np.isfinite(met.t)
    left = np.where(there, 1.0 - np.array(opacities)[met.surface], 1.0)
    alpha = 1.0 - left.prod(axis=1)
    grazed = grazes(met)
    apart = np.abs(data.rgba[..., 3].ravel() - alpha) > 1e-5
    assert there.sum() > 2000 and grazed.mean() < 0.02
    assert not np.any(apart & ~grazed), f"{np.sum(apart & ~grazed)} rays"
    # Where half of the light is gone, the crossing that took it.
    halves = (1.0 - np.cumprod(left, axis=1)) >= 0.5
    depth = np.where(halves.any(axis=1), met.t[np.arange(len(met.t)), halves.argmax(axis=1)], np.inf)
    sure = ~grazed & np.isfinite(depth)
    assert sure.sum() > 50
    np.testing.assert_allclose(data.depth.ravel()[sure], depth[sure], rtol=0, atol=2e-4)


def domain(shape, origins, directions):
    """Where rays enter and leave the hull of the voxel centres."""
    with np.errstate(divide="ignore"):
        a, b = -origins / directions, (np.array(shape[::-1]) - 1.0 - origins) / directions
    enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    return enter, np.maximum(leave, enter)


def grazes(met, least=1e-4) -> np.ndarray:
    """bool [n]: rays that meet one surface twice within so little: float32 may see none of the two."""
    t, n = met.t, len(met.t)
    near = np.zeros(n, bool)
    for k in range(int(met.surface.max()) + 1):
        own = np.sort(np.where((met.surface == k) & np.isfinite(t), t, np.inf), axis=1)
        with np.errstate(invalid="ignore"):
            near |= np.any(own[:, 1:] - own[:, :-1] < least, axis=1)
    return near


def cell(function) -> np.ndarray:
    """float32 [2, 2, 2] of function(x, y, z) at a cell's corners."""
    z, y, x = np.meshgrid(*[np.arange(2.0)] * 3, indexing="ij")
    return np.vectorize(function)(x, y, z).astype(np.float32)


def along_diagonal() -> dict:
    """An orthographic [camera] whose only pixel sees the cell along its diagonal."""
    return {"projection": "orthographic", "position": [-2.0, -2.0, -2.0],
            "target": [1.0, 1.0, 1.0], "up": [0.0, 1.0, 0.0], "height": 1e-4}  # fmt: skip


def test_three_crossings_in_one_cell(context):
    """-(1 - w)^3 + 6 w (1 - w)^2 - 6 w^2 (1 - w) + w^3 along the diagonal."""
    by_sum = {0: -1.0, 1: 2.0, 2: -2.0, 3: 1.0}
    array = cell(lambda x, y, z: by_sum[x + y + z])
    roots = np.sort(np.roots([14.0, -21.0, 9.0, -1.0]).real)
    colors = {"color": [1.0, 0.0, 0.0], "back_color": [0.0, 1.0, 0.0], "opacity": 0.4}
    for step in (0.01, 1.0, 10.0):
        data = picture(context, scene(array, NOTHING, camera=along_diagonal(), size=(1, 1),
                                      isosurface=[{"value": 0.0, **colors}],
                                      integration={"step": step}))  # fmt: skip
        expected = [0.4 + 0.36 * 0.4, 0.6 * 0.4, 0.0, 1.0 - 0.6**3]
        np.testing.assert_allclose(data.rgba[0, 0], expected, atol=1e-6)
        distance = np.sqrt(3.0) * (2.0 + roots[1])
        np.testing.assert_allclose(data.depth[0, 0], distance, atol=1e-5)
        # Near the end that all the cell's corners but one are beyond, and not within the cubic.
        for value, hits in ((-0.99, 1), (1.5, 0), (-1.5, 0)):
            data = picture(context, scene(array, NOTHING, camera=along_diagonal(), size=(1, 1),
                                          isosurface=[{"value": value, **colors}],
                                          integration={"step": step}))  # fmt: skip
            np.testing.assert_allclose(data.rgba[0, 0, 3], 1.0 - 0.6**hits, atol=1e-6)


@pytest.mark.parametrize("filter", ["linear", "catmull-rom"])
def test_a_surface_in_faces_edges_and_corners_is_met_once(context, filter):
    """x + y + z takes a whole number in corners of cells, along the diagonal and beside it; z alone in
    whole faces."""
    z, y, x = np.meshgrid(*[np.arange(9.0)] * 3, indexing="ij")
    for array, values in ((z, (4.0, 5.0)), (x + y + z, (10.0, 13.0))):
        for value in values:
            for target in ([4.0, 4.0, 4.0], [4.25, 4.5, 4.0]):
                camera = {"projection": "orthographic", "target": target, "height": 2.0,
                          "position": [t - 9.0 for t in target], "up": [0.0, 1.0, 0.0]}  # fmt: skip
                for sign in (1.0, -1.0):
                    data = picture(context, scene(
                        sign * array, NOTHING, camera=camera, size=(9, 9),
                        isosurface=[{"value": sign * value, "opacity": 0.5}],
                        integration={"filter": filter},
                    ))  # fmt: skip
                    assert np.all(data.rgba[..., 3] == 0.5)


def test_a_ridge_that_just_reaches_the_value_is_met_and_a_valley_is_not(context):
    """At least the iso-value is above: the ridge's crest alone is, on either side of it is not."""
    for crest, value, hits in ((1.0, 1.0, 2), (-1.0, -1.0, 0)):
        array = np.zeros((9, 5, 5), np.float32)
        array[4] = crest
        camera = {"projection": "orthographic", "position": [2.0, 2.0, -5.0], "up": [0.0, 1.0, 0.0],
                  "target": [2.3, 2.1, 4.0], "height": 2.0}  # fmt: skip
        surface = [{"value": value, "opacity": 0.5}]
        for data in at_steps(context, array, camera=camera, isosurface=surface, steps=(3.0, 0.3)):
            assert np.all(data.rgba[..., 3] == 1.0 - 0.5**hits)


def test_a_saddle_is_grazed_on_its_own_side(context):
    """x y along the line y = 1/2 - x + d: the top is (1/2 + d)^2 / 4, above the value or below."""
    array = cell(lambda x, y, z: x * y)
    for d, hits in ((1e-3, 2), (-1e-3, 0)):
        camera = {"projection": "orthographic", "position": [-1.0, 1.5 + d, 0.5],
                  "target": [0.25, 0.25 + d, 0.5], "up": [0.0, 0.0, 1.0], "height": 1e-3}  # fmt: skip
        surface = [{"value": 0.0625, "opacity": 0.5}]
        for data in at_steps(context, array, camera=camera, size=(1, 1), isosurface=surface,
                             steps=(9.0, 0.37)):  # fmt: skip
            assert data.rgba[0, 0, 3] == 1.0 - 0.5**hits


def test_equal_and_crowded_iso_values_are_all_met(context):
    array = np.broadcast_to(np.arange(9, dtype=np.float32)[:, None, None], (9, 5, 5)).copy()
    values = np.array([4.5, 4.5, 4.500001, 4.6, 4.6, 5.0])
    camera = {"projection": "orthographic", "position": [2.0, 2.0, -5.0], "up": [0.0, 1.0, 0.0],
              "target": [2.3, 2.1, 4.0], "height": 2.0}  # fmt: skip
    for voxels, levels in ((array, values), (9.0 - array, 9.0 - values)):
        surfaces = [{"value": float(level), "opacity": 0.2} for level in levels]
        for data in at_steps(context, voxels, camera=camera, isosurface=surfaces, steps=(7.0, 0.4)):
            np.testing.assert_allclose(data.rgba[..., 3], 1.0 - 0.8 ** len(values), atol=1e-6)


@pytest.mark.parametrize("filter", FILTERS)
def test_cells_that_use_a_hole_have_no_surface(context, filter):
    """Whole cells, at every step: the other crossings of the same rays stay."""
    array = rough(seed=3, dtype=np.float32)
    array[np.random.default_rng(5).random(SHAPE) < 0.02] = np.nan
    surfaces = [{"value": 128.0, "opacity": 0.1}]
    same = assert_same(at_steps(context, array, filter=filter, steps=(4.0, 0.7), size=(40, 30),
                                camera=oblique(SHAPE), isosurface=surfaces))  # fmt: skip
    camera = scene(array, NOTHING, camera=oblique(SHAPE), size=(40, 30)).camera
    origins, directions = (r.reshape(-1, 3) for r in camera.world_rays(40, 30))
    met = cell_crossings(Field(Volume(array), filter), origins, directions,
                         *domain(SHAPE, origins, directions), [128.0])  # fmt: skip
    alpha = 1.0 - 0.9 ** np.isfinite(met.t).sum(axis=1)
    apart = np.abs(same.rgba[..., 3].ravel() - alpha) > 1e-5
    assert np.isfinite(met.t).sum() > 200 and not np.any(apart & ~grazes(met))


def test_a_slab_of_one_voxel(context):
    array = rough((1, 9, 9), seed=2)
    camera = oblique((3, 9, 9))
    for filter in FILTERS:
        assert_same(at_steps(context, array, filter=filter, steps=(3.0, 0.5), camera=camera,
                             isosurface=[{"value": 120.0, "opacity": 0.4}]))  # fmt: skip


def test_shadows_of_surfaces_do_not_depend_on_the_shadow_s_step(context):
    """A ball before a wall: the share of its light that arrives."""
    array = np.zeros((17, 17, 17), np.float32)
    array[:, :, :] = np.maximum(6.0 - ball((17, 17, 17), (8, 8, 5)), 0.0)
    array[14:] = 9.0
    light = [{"type": "directional", "direction": [0.1, 0.2, 1.0]}]
    camera = {"position": [30.0, 8.0, 2.0], "target": [8.0, 8.0, 8.0], "up": [0.0, 1.0, 0.0]}
    pictures = [
        picture(context, scene(array, NOTHING, camera=camera, light=light, isosurface=[
            {"value": 3.0, "opacity": 0.6}, {"value": 5.5, "opacity": 0.3}],
            shadow={"method": "rays", "bound": 0.0, "step": step}))
        for step in (3.0, 1.0, 0.25)
    ]  # fmt: skip
    for other in pictures[1:]:
        np.testing.assert_allclose(other.rgba, pictures[0].rgba, rtol=0, atol=1e-6)
