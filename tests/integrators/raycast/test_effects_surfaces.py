"""Iso-surfaces: where they are found, their order, how they bend rays; kernels against the twin."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import (
    LIGHTS,
    MATERIAL,
    NOTHING,
    SIZE,
    ball,
    blobs,
    oblique,
    picture,
    scene,
    twin,
)  # fmt: skip
from reference.cell_crossings import medium_crossings
from reference.medium import Medium

from clvol import TransferFunction

SHAPE = (15, 17, 19)
CAMERA = oblique(SHAPE)
LIT = {"light": LIGHTS, "material": MATERIAL, "gradient": {"storage": "on-the-fly"}}
TWO = [
    {"value": 0.6, "opacity": 0.7, "color": [0.2, 0.3, 0.9]},
    {"value": 0.35, "opacity": 0.4, "color": [0.9, 0.3, 0.2], "back_color": [0.2, 0.8, 0.3]},
]
GLASS = [{"value": 0.4, "opacity": 0.3, "color": [0.9, 0.3, 0.2], "refraction": 1.3}]
# A crossing known to 5e-5 edges, of surfaces whose light changes by less than 1 an edge.
ROUNDING = 1e-4
CUBE = (17, 17, 17)


def along_z(height=9.0) -> dict:
    """An orthographic [camera] that looks along +z through a cube of 17 voxels, 9 before it."""
    return {"projection": "orthographic", "position": [8.0, 8.0, -9.0], "target": [8.0, 8.0, 8.0],
            "up": [0.0, 1.0, 0.0], "height": height}  # fmt: skip


def ramp(values=range(17)) -> np.ndarray:
    """float32 [17, 17, 17] with these values along z."""
    return np.broadcast_to(np.array(values, np.float32)[:, None, None], CUBE).copy()


def check(context, resolved, limit=ROUNDING, others=0):
    """The twin finds the roots of each cell's polynomial in double precision: all pixels but so many
    ``others`` are its."""
    expected = twin(resolved)
    data = picture(context, resolved)
    assert 0.05 < expected[..., 3].mean()
    apart = np.abs(data.rgba - expected).max(axis=-1)
    assert np.sum(apart > limit) <= others, f"{np.sum(apart > limit)}, {apart.max()}"
    return data


VARIANTS = {
    "empty": (NOTHING, {}),
    "in a volume": (None, {}),
    "in a volume, preintegrated": (None, {"integration": {"classification": "preintegrated"}}),
    "in a volume, pre": (None, {"integration": {"classification": "pre"}}),
    "fine steps": (NOTHING, {"integration": {"step": 0.3}}),
    "long steps": (NOTHING, {"integration": {"step": 4.0}}),
    "nearest": (NOTHING, {"integration": {"filter": "nearest"}}),
    "cubic": (NOTHING, {"integration": {"filter": "cubic"}}),
    "prefiltered": (NOTHING, {"integration": {"filter": "cubic", "prefilter": True}}),
    "catmull-rom": (NOTHING, {"integration": {"filter": "catmull-rom"}}),
    "one-sided": (NOTHING, {"material": {**MATERIAL, "two_sided": False}}),
    "glass": (NOTHING, {"isosurface": GLASS}),
    "glass in a volume": (None, {"isosurface": GLASS}),
    "thin glass": (NOTHING, {"isosurface": [{**GLASS[0], "refraction": 0.7}]}),
}  # fmt: skip


@pytest.mark.parametrize("variant", VARIANTS)
def test_surfaces_are_the_twins(context, variant):
    function, keys = VARIANTS[variant]
    functions = {} if function is None else {"function": function}
    # A bent ray goes on 2e-3 edges from the surface: that much of the volume's opacity is not seen.
    limit = 1e-3 if variant == "glass in a volume" else ROUNDING
    # Interpolated gradients are not quite the field's: one ray that glances off goes on through the
    # surface, which the twin, starting in it, meets again and again.
    others = 1 if "glass" in variant else 0
    resolved = scene(
        blobs(SHAPE), **functions, **{**LIT, "camera": CAMERA, "isosurface": TWO, **keys}
    )
    check(context, resolved, limit, others)


_firsts: dict = {}


def first_crossings(resolved) -> np.ndarray:
    """World distances [height, width] from the camera's plane to the surface, else inf: once for
    all devices and steps."""
    filter = resolved.integration.filter
    if filter not in _firsts:
        origins, directions = resolved.camera.world_rays(*SIZE)
        rays = origins.reshape(-1, 3), directions.reshape(-1, 3)
        start = np.full(len(rays[0]), 45.0)
        met = medium_crossings(Medium(resolved), *rays, start, start + 35.0,
                               [resolved.isosurfaces[0].value])  # fmt: skip
        _firsts[filter] = met.t[:, 0].reshape(origins.shape[:2])
    return _firsts[filter]


@pytest.mark.parametrize("filter", ["nearest", "linear", "cubic", "catmull-rom"])
def test_an_opaque_surface_is_where_the_field_takes_its_value(context, filter):
    """Its depth is the distance to it, to 1e-4 of an edge: the root of the field's polynomial in
    double. Whatever the step, and with no lights."""
    array = ball(SHAPE, (9.3, 8.1, 6.9))
    camera = oblique(SHAPE, projection="orthographic", height=14.0)
    for step in (0.4, 1.0, 4.0):
        resolved = scene(array, NOTHING, camera=camera, isosurface=[{"value": 5.3}],
                         integration={"filter": filter, "step": step})  # fmt: skip
        depth = picture(context, resolved).depth
        first = first_crossings(resolved)
        both = np.isfinite(first) & np.isfinite(depth)
        assert both.mean() > 0.2 and np.array_equal(np.isfinite(first), np.isfinite(depth))
        np.testing.assert_allclose(depth[both], first[both], rtol=0, atol=1e-4)


def test_a_sphere_is_where_it_is(context):
    """Squares are met exactly by Catmull-Rom's spline: the surface of r^2 is the sphere itself,
    also where a ray only grazes it within a segment, and where it just misses."""
    middle, radius = np.array([8.0, 8.0, 7.4]), 5.0  # between the places that segments look at
    squares = ball(CUBE, middle).astype(np.float64) ** 2
    for step in (1.3, 2.0, 3.3):
        resolved = scene(squares, NOTHING, camera=along_z(10.2), size=(61, 61),
                         isosurface=[{"value": radius**2}],
                         integration={"filter": "catmull-rom", "step": step})  # fmt: skip
        data = picture(context, resolved)
        origins, _ = resolved.camera.world_rays(61, 61)
        away = np.sum((origins[..., :2] - middle[:2]) ** 2, axis=-1)
        clear = np.abs(away - radius**2) > 1e-4
        assert clear.mean() > 0.99 and np.sum((away > 24.5) & (away < 25)) > 10
        assert np.array_equal((data.rgba[..., 3] == 1.0)[clear], (away < radius**2)[clear])
        inner = away < radius**2 - 0.05
        expected = 9.0 + middle[2] - np.sqrt(radius**2 - away[inner])
        np.testing.assert_allclose(data.depth[inner], expected, rtol=0, atol=1e-4)


def test_surfaces_and_volume_are_composited_in_the_order_of_the_ray(context):
    """Uniform haze, three surfaces in one segment, from both sides: the closed form."""
    haze = TransferFunction([0.0], [0.1], [[0.2, 0.4, 0.6]])
    values, opacities = np.array([4.3, 5.1, 9.7]), np.array([0.2, 0.5, 0.9])
    front, back = np.eye(3), np.eye(3)[::-1] * 0.5 + 0.1
    surfaces = [
        {"value": v, "opacity": o, "color": f.tolist(), "back_color": b.tolist()}
        for v, o, f, b in zip(values, opacities, front, back)
    ][::-1]
    for falls in (False, True):
        array = ramp(np.arange(17)[:: -1 if falls else 1])
        at = (16.0 - values)[::-1] if falls else values
        shown = (back if falls else front)[:: -1 if falls else 1]
        order = opacities[:: -1 if falls else 1]
        expected, left, before = np.zeros(3), 1.0, 0.0
        for place, color, opacity in zip([*at, 16.0], [*shown, np.zeros(3)], [*order, 0.0]):
            passed = 1.0 - 0.9 ** (place - before)
            expected += left * passed * np.array([0.2, 0.4, 0.6])
            left *= 1.0 - passed
            expected += left * opacity * color
            left, before = left * (1.0 - opacity), place
        for step in (1.0, 4.0, 40.0):
            resolved = scene(
                array, haze, camera=along_z(), isosurface=surfaces, integration={"step": step}
            )
            rgba = picture(context, resolved).rgba
            linear = [np.asarray(s.color) for s in resolved.isosurfaces]
            assert np.allclose(sorted(map(tuple, linear)), sorted(map(tuple, front)))
            np.testing.assert_allclose(rgba[..., 3], 1.0 - left, atol=2e-5)
            np.testing.assert_allclose(
                rgba[..., :3], np.broadcast_to(expected, (*rgba.shape[:2], 3)), atol=5e-5
            )


def test_a_surface_without_a_gradient_shows_its_own_colour(context):
    """Under the nearest filter the gradient is that of the voxel beyond the surface: the crest of a
    ridge one voxel wide has none."""
    values = np.zeros(17)
    values[8] = 1.0
    surface = [{"value": 0.5, "color": [0.5, 0.6, 0.7], "back_color": [0, 0, 0]}]
    resolved = scene(ramp(values), NOTHING, **LIT, camera=along_z(), isosurface=surface,
                     integration={"filter": "nearest", "step": 0.25})  # fmt: skip
    rgba = picture(context, resolved).rgba
    expected = np.asarray(resolved.isosurfaces[0].color)
    np.testing.assert_allclose(rgba[..., :3], np.broadcast_to(expected, (*rgba.shape[:2], 3)),
                               atol=1e-6)  # fmt: skip


def wall(index, falls=False):
    """A plane at z = 5 where the index changes, and an opaque one at z = 12."""
    array = ramp(np.arange(17)[:: -1 if falls else 1])
    at = (lambda z: 16.0 - z) if falls else (lambda z: z)
    surfaces = [{"value": at(5.0), "opacity": 0.01, "refraction": index}, {"value": at(12.0)}]
    camera = {"position": [8.0, 8.0, -2.0], "target": [8.0, 8.0, 8.0], "up": [0.0, 1.0, 0.0],
              "fov_degrees": 80.0}  # fmt: skip
    return scene(array, NOTHING, camera=camera, isosurface=surfaces)


@pytest.mark.parametrize("index, falls", [(1.5, False), (0.8, False), (1.5, True), (1.0, False)])
def test_rays_are_refracted_by_snells_law(context, index, falls):
    """To the opaque wall a ray goes 7 / cos of its angle beyond the plane; what would be more than
    90 degrees is reflected and never gets there."""
    resolved = wall(index, falls)
    data = picture(context, resolved)
    _, directions = resolved.camera.world_rays(*data.depth.shape[::-1])
    cosine = directions[..., 2]
    origins_z, ratio = -2.0, (index if falls else 1.0 / index)
    sine = ratio * np.sqrt(1.0 - cosine**2)
    beyond = np.sqrt(np.maximum(1.0 - sine**2, 0.0))
    path = (5.0 - origins_z) / cosine + 7.0 / np.maximum(beyond, 1e-9)
    # In the middle, where no ray leaves the volume through its sides.
    reach = (5.0 - origins_z) * np.sqrt(1 - cosine**2) / cosine
    reach += 7.0 * sine / np.maximum(beyond, 1e-9)
    whole = (sine < 0.99) & (reach < 7.9)
    assert whole.sum() > 40
    np.testing.assert_allclose(data.rgba[..., 3][whole], 1.0, atol=1e-6)
    np.testing.assert_allclose(data.depth[whole], path[whole], rtol=0, atol=1e-3)
    if falls:
        total = sine > 1.01
        assert total.sum() > 20 and np.all(data.rgba[..., 3][total] < 0.03)
    twice = twin(resolved)
    same = np.abs(twice - data.rgba).max(axis=-1) < 1e-4
    assert same[whole].all() and same.mean() > 0.97


def test_after_eight_bends_a_ray_goes_straight_on(context):
    """A field that rises and falls through the value ten times: +-1 +-1 every four voxels."""
    values = np.sin(0.5 * np.pi * np.arange(20))
    array = np.broadcast_to(values.astype(np.float32)[:, None, None], (20, 17, 17)).copy()
    glass = [{"value": 0.4, "opacity": 0.1, "refraction": 1.2}]
    resolved = scene(array, NOTHING, camera=along_z(8.0), isosurface=glass)
    data = picture(context, resolved)
    rays = data.depth.size
    assert data.counters["surface_hits"] == 10 * rays and data.counters["bends"] == 8 * rays
    np.testing.assert_allclose(data.rgba[..., 3], 1.0 - 0.9**10, atol=1e-5)


@pytest.mark.slow
def test_leaping_lanes_and_tiles_change_no_surface(context):
    array = np.zeros((48, 17, 19), np.float32)
    array[:15] = blobs(SHAPE)
    surfaces = [*TWO, {"value": 0.45, "opacity": 0.2, "refraction": 1.1}]
    resolved = scene(array, **LIT, camera=oblique(array.shape), isosurface=surfaces)
    one = picture(context, resolved).rgba
    assert np.array_equal(one, picture(context, resolved, skip=False).rgba)
    assert np.array_equal(one, picture(context, resolved, tile=(4, 12)).rgba)
    other = picture(context, resolved, lanes=1 if context.is_cpu else 16).rgba
    # Another compilation: a grazed surface may be missed or met.
    assert np.sum(np.abs(one - other).max(axis=-1) > 1e-4) <= 1


@pytest.mark.slow
def test_holes_hide_only_the_surfaces_that_use_them(context):
    """Pixels whose rays keep a voxel's distance from every hole do not change."""
    array = blobs(SHAPE)
    holes = np.random.default_rng(2).random(SHAPE) < 0.004
    resolved = scene(np.where(holes, np.nan, array), **LIT, camera=CAMERA, isosurface=TWO)
    data = picture(context, resolved)
    assert np.isfinite(data.rgba).all()
    whole = picture(context, scene(array, **LIT, camera=CAMERA, isosurface=TWO)).rgba
    origins, directions = resolved.camera.world_rays(*data.depth.shape[::-1])
    at = np.argwhere(holes)[:, ::-1].astype(float)
    offset = at - origins[..., None, :]
    along = np.sum(offset * directions[..., None, :], axis=-1, keepdims=True)
    away = np.linalg.norm(offset - along * directions[..., None, :], axis=-1).min(axis=-1)
    # Gradients use voxels up to two cells' diagonals away.
    untouched = away > 2.0 * np.sqrt(3.0)
    assert 0.2 < untouched.mean() < 0.95 and holes.sum() > 10
    # The same but for two programs' rounding.
    np.testing.assert_allclose(data.rgba[untouched], whole[untouched], rtol=0, atol=1e-4)
    assert np.abs(data.rgba - whole).max() > 0.1
    expected = twin(resolved)
    np.testing.assert_allclose(data.rgba, expected, rtol=0, atol=ROUNDING)
