"""Lit volumes: the kernels against the plain twin, and what lighting may not do.

Both march the same segments. They differ by float32's rounding: where a ray enters the volume is
known to about 1e-7 of its size, so of a segment the opacity to some 1e-6 of it; the
post-classification table has 4096 nodes over the values, which misses its kinks by less than that.
ROUNDING is a few times what these come to on pictures of opacity 0.2 to 0.7.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import (
    HAZE,
    LIGHTS,
    MATERIAL,
    ball,
    blobs,
    oblique,
    picture,
    scaled,
    scene,
    twin,
)  # fmt: skip

from clvol import TransferFunction

ROUNDING = 3e-5
ON_THE_FLY = {"storage": "on-the-fly"}
SHAPE = (15, 17, 19)
CAMERA = oblique(SHAPE)
LIT = {"light": LIGHTS, "material": MATERIAL, "gradient": ON_THE_FLY, "camera": CAMERA}
SPACING, ORIGIN = (0.7, 1.9, 1.1), (3.0, -4.0, 5.0)
# One constant colour and opacity: what is seen is the lighting.
CLAY = TransferFunction([0.0], [0.25], [[0.8, 0.5, 0.2]])


def moved(camera, by):
    return {
        key: (np.array(value) + by).tolist() if key in ("position", "target") else value
        for key, value in camera.items()
    }


def check(context, resolved, limit=ROUNDING, **how):
    expected = twin(resolved)
    found = picture(context, resolved, **how).rgba
    assert expected[..., 3].max() > 0.1
    np.testing.assert_allclose(found, expected, rtol=0, atol=limit)
    return found


VARIANTS = {
    "post": {},
    "preintegrated": {"integration": {"classification": "preintegrated"}},
    "pre": {"integration": {"classification": "pre"}},
    "sobel": {"gradient": {"operator": "sobel", "storage": "on-the-fly"}},
    "nearest": {"integration": {"filter": "nearest"}},
    "cubic": {"integration": {"filter": "cubic"}},
    "prefiltered cubic": {"integration": {"filter": "cubic", "prefilter": True}},
    "catmull-rom": {"integration": {"filter": "catmull-rom", "step": 0.6}},
    "depth cue": {"depth_cue": {"strength": 0.8, "color": [0.2, 0.4, 0.9], "start": 30.0}},
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_lit_pictures_are_the_twins(context, variant):
    resolved = scene(blobs(SHAPE), **{**LIT, **VARIANTS[variant]})
    found = check(context, resolved)
    unlit = twin(scene(blobs(SHAPE), camera=CAMERA))
    assert np.abs(found - unlit).max() > 0.02  # the lighting shows


# Of the program that "post" above compiles: only numbers change.
VIEWS = {
    "oblique spacing": dict(
        grid={"spacing": SPACING, "origin": ORIGIN}, camera=moved(oblique(SHAPE, SPACING), ORIGIN)
    ),
    "orthographic": dict(camera=oblique(SHAPE, projection="orthographic", height=15.0)),
    "inside": dict(
        camera={"position": [9.3, 8.1, 7.4], "target": [2, 3, 15], "up": [0, 1, 0],
                "fov_degrees": 70.0}
    ),
    "long step": dict(integration={"step": 3.7}),
    "one-sided": dict(material={**MATERIAL, "two_sided": False}),
    "fading": dict(material={**MATERIAL, "fade": 0.2}),
    "fading away": dict(material={**MATERIAL, "fade": 1e300}),
    "hardly fading": dict(material={**MATERIAL, "fade": 1e-300}),
    "shiny": dict(material={**MATERIAL, "shininess": 1e4, "specular": 1.0}),
    "dull": dict(material={**MATERIAL, "shininess": 1.0}),
    "far lights": dict(
        light=[{"type": "point", "position": [1e25, -2e25, 1e24]},
               {"type": "point", "position": [1e10, -2e10, 1e9], "color": [1.0, 0.0, 0.0]}]
    ),
    "a light among the samples": dict(light=[{"type": "point", "position": [9.1, 8.2, 7.3]}]),
}  # fmt: skip


@pytest.mark.parametrize("view", VIEWS)
def test_lit_views_are_the_twins(context, view):
    # A highlight of exponent n has slopes up to sqrt(n) an angle, which float32 knows to 1e-6.
    limit = 2e-4 if view == "shiny" else ROUNDING
    check(context, scene(blobs(SHAPE), **{**LIT, **VIEWS[view]}), limit)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float64])
def test_lit_voxels_of_every_type(context, dtype):
    top = {np.uint8: 255, np.int16: 3000, np.float64: 1e5}[dtype]
    resolved = scene(blobs(SHAPE, top=top, dtype=dtype), scaled(HAZE, top), **LIT)
    check(context, resolved)


@pytest.mark.parametrize("operator", ["central", "sobel"])
def test_precomputed_gradients_light_like_those_on_the_fly(context, operator):
    """A direction of three signed bytes is off by up to 0.4 degrees: cosines by 0.007, highlights
    of exponent 14 by 0.05. Where neighbours' gradients all but cancel it may be more: of few."""
    resolved = scene(blobs(SHAPE), **{**LIT, "gradient": {"operator": operator}})
    expected = twin(resolved)
    apart = np.abs(picture(context, resolved).rgba - expected).max(axis=-1)
    assert np.sqrt(np.mean(apart**2)) < 5e-3 and np.mean(apart > 5e-3) < 0.01


@pytest.mark.slow
def test_lanes_tiles_and_leaping_change_nothing(context):
    array = np.zeros((40, 17, 19), np.float32)
    array[:15] = blobs(SHAPE)
    resolved = scene(array, **{**LIT, "camera": oblique(array.shape)})
    one = check(context, resolved)
    assert np.array_equal(one, picture(context, resolved, tile=(8, 20)).rgba)
    assert np.array_equal(one, picture(context, resolved, skip=False).rgba)
    lanes = 1 if context.is_cpu else 16
    np.testing.assert_allclose(picture(context, resolved, lanes=lanes).rgba, one, atol=3e-6)


@pytest.mark.parametrize("shape", [(1, 17, 19), (17, 1, 19), (15, 17, 1), (1, 1, 9), (1, 1, 1)])
def test_thin_volumes_are_lit(context, shape):
    array = blobs(shape) if max(shape) > 1 else np.full(shape, 0.7, np.float32)
    resolved = scene(array, scaled(HAZE, 1.0, 0.3), **{**LIT, "camera": oblique(shape, away=3.0)})
    expected = twin(resolved)
    found = picture(context, resolved).rgba
    assert expected[..., 3].max() > 0.02 or max(shape) == 1
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING)


def test_without_a_gradient_nothing_is_shaded(context):
    array = np.full(SHAPE, 0.7, np.float32)
    lit = picture(context, scene(array, **LIT)).rgba
    unlit = picture(context, scene(array, camera=CAMERA)).rgba
    np.testing.assert_allclose(lit, unlit, rtol=0, atol=3e-6)


def test_light_adds_up_from_0_to_40_lights(context):
    rng = np.random.default_rng(5)
    ways, colors = rng.normal(size=(40, 3)), rng.uniform(0.01, 0.1, (40, 3))
    lights = [
        {"type": "directional", "direction": way.tolist(), "color": color.tolist()}
        for way, color in zip(ways, colors)
    ]
    dark = {"type": "directional", "direction": [1.0, 0.0, 0.0], "color": [0.0, 0.0, 0.0]}

    def lit_by(some):
        # A light that is all but black keeps the scene a lit one.
        faint = {**dark, "color": [1e-12, 0.0, 0.0]}
        return picture(context, scene(blobs(SHAPE), **{**LIT, "light": [*some, faint]})).rgba

    ambient = lit_by([])
    every = lit_by(lights) - ambient
    halves = lit_by(lights[:17]) + lit_by(lights[17:]) - 2 * ambient
    assert every[..., :3].max() > 0.05 and np.abs(every[..., 3]).max() < 1e-7
    np.testing.assert_allclose(every, halves, rtol=0, atol=3e-6)
    check(context, scene(blobs(SHAPE), **{**LIT, "light": lights}))


def test_a_point_light_at_a_sample_lights_all_the_others(context):
    """There it has no direction and gives nothing; samples lie at k + 1/2 along z."""
    camera = {"projection": "orthographic", "position": [8.0, 8.0, -16.0],
              "target": [8.0, 8.0, 8.0], "up": [0.0, 1.0, 0.0], "height": 2.0}  # fmt: skip
    light = [{"type": "point", "position": [8.0, 8.0, 4.5]}]
    resolved = scene(ball((17, 17, 17), (8.0, 8.0, -9.0)), CLAY, size=(1, 1),
                     **{**LIT, "light": light, "camera": camera})  # fmt: skip
    found = check(context, resolved)
    assert np.isfinite(found).all()


def test_light_and_colour_enter_as_the_formula_says(context):
    """A ramp along z seen along it from a light 40 degrees aside: every sample is lit alike."""
    angle = np.radians(40.0)
    light = {"type": "directional", "direction": [np.sin(angle), 0.0, np.cos(angle)],
             "color": [1.0, 0.5, 0.25], "intensity": 1.5}  # fmt: skip
    camera = {"projection": "orthographic", "position": [8.0, 8.0, -9.0], "target": [8.0, 8.0, 8.0],
              "up": [0.0, 1.0, 0.0], "height": 9.0}  # fmt: skip
    ramp = np.broadcast_to(np.arange(17, dtype=np.float32)[:, None, None], (17, 17, 17)).copy()
    arriving = 1.5 * np.array([1.0, 0.5, 0.25])
    color = np.array([0.8, 0.5, 0.2])
    for keys in ({}, {"ambient": 0.0}, {"diffuse": 0.0}, {"specular": 0.0}, {"shininess": 50.0}):
        m = {**MATERIAL, **keys}
        rgba = picture(context, scene(ramp, CLAY, **{**LIT, "light": [light], "material": m,
                                                     "camera": camera})).rgba  # fmt: skip
        expected = color * (m["ambient"] + m["diffuse"] * np.cos(angle) * arriving)
        expected += m["specular"] * np.cos(angle / 2) ** m["shininess"] * arriving
        np.testing.assert_allclose(rgba[..., 3], 1 - 0.75**16, atol=3e-6)
        np.testing.assert_allclose(rgba[..., :3] / rgba[..., 3:], np.broadcast_to(
            expected, (*rgba.shape[:2], 3)), atol=1e-5)  # fmt: skip


def test_depth_cueing_goes_by_the_length_of_the_path(context):
    """Nothing before the start, all of it beyond the end, in proportion between, from the eye."""
    camera = {"position": [8.0, 8.0, -10.0], "target": [8.0, 8.0, 8.0], "up": [0.0, 1.0, 0.0],
              "fov_degrees": 40.0}  # fmt: skip
    thin = TransferFunction([0.0], [1.0 - np.exp(-1e-3)], [[1.0, 1.0, 1.0]])
    cue = {"start": 12.0, "end": 22.0, "strength": 0.75, "color": [0.0, 1.0, 0.0]}
    resolved = scene(np.zeros((17, 17, 17), np.float32), thin, camera=camera, depth_cue=cue,
                     integration={"step": 0.25})  # fmt: skip
    rgba = picture(context, resolved).rgba
    origins, directions = resolved.camera.world_rays(*rgba.shape[1::-1])
    t = np.linspace(0.0, 60.0, 12001)
    for row, column in [(10, 13), (4, 6), (17, 20)]:
        at = origins[row, column] + t[:, None] * directions[row, column]
        inside = np.all((at >= 0) & (at <= 16), axis=1)
        depth = 1e-3 * (t[1] - t[0])
        weight = inside * depth * np.exp(-depth * np.cumsum(inside))
        share = 0.75 * np.clip((t - 12.0) / 10.0, 0.0, 1.0)
        assert rgba[row, column, 1] == pytest.approx(weight.sum(), rel=2e-3)
        assert rgba[row, column, 0] == pytest.approx((weight * (1 - share)).sum(), rel=2e-3)
