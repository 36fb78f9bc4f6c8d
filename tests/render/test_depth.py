"""Depth: where along a ray its opacity reaches one half, to a thousandth of a step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from small_scenes import axis_camera, make_scene

from clvol import Camera, Scene, TransferFunction, Volume
from clvol.render.engines import Engines
from clvol.render.reference import render_reference

SHAPE = (64, 8, 8)
MIDDLE = (3.5, 3.5, 31.5)
DISTANCE = 40.0
ENTRY = DISTANCE - 31.5  # of rays along z
WHITE = [1.0, 1.0, 1.0]
STEEP = (0.03, 0.4, 0.999, 1.0 - 1e-12, 1.0)
STEPS = (0.4, 1.0, 2.7)
RULES = [
    {"classification": "preintegrated"},
    {"classification": "post"},
    {"classification": "pre"},
    {"classification": "preintegrated", "quadrature": "cells"},
    {"classification": "post", "quadrature": "cells"},
]
CHORDS = [rule for rule in RULES if rule["classification"] == "preintegrated"]
# Each makes the ray caster's effects, blocks or slices do the march.
ELSEWHERE = {
    "clip": {"clip": [{"point": [0, 0, 9.3], "normal": [0, 0, 1]}]},
    "cue": {"depth_cue": {"start": 10.0, "end": 50.0}},
    "surface": {"isosurface": [{"value": 254.9, "opacity": 0.5}]},
    "factor": {"directional_opacity": {"points": [{"derivative": 0.0, "opacity": 0.7}]}},
    "pyramid": {"integration": {"method": "pyramid"}},
    "blocks": {"integration": {"method": "multiresolution"}, "multiresolution": {"stepping": "full"}},
    "long steps": {"integration": {"method": "multiresolution"}, "multiresolution": {"stepping": "limited"}},
    "bounded": {"integration": {"method": "multiresolution"}, "multiresolution": {"stepping": "bounded"}},
    "slices": {"integration": {"method": "multiresolution"}, "multiresolution": {"stepping": "pyramid"}},
}


def level(opacity: float) -> TransferFunction:
    return TransferFunction([0.0, 255.0], [opacity, opacity], [WHITE, WHITE])


def rising(opacity: float) -> TransferFunction:
    return TransferFunction([0.0, 255.0], [0.0, opacity], [WHITE, WHITE])


def uniform() -> np.ndarray:
    return np.full(SHAPE, 100, np.uint8)


def ramp() -> np.ndarray:
    """float32: from 0 to 255 along z."""
    along = np.linspace(0.0, 255.0, SHAPE[0], dtype=np.float32)
    return np.ascontiguousarray(np.broadcast_to(along[:, None, None], SHAPE))


def seen(context, array, function, *, camera=None, size=(6, 5), **tables) -> np.ndarray:
    """The picture's depth, by whatever method the tables ask for."""
    camera = camera or axis_camera(MIDDLE, axis=2, height=4.0, distance=DISTANCE)
    tables["integration"] = {"early_termination": 0.0, **tables.get("integration", {})}
    volume = array if isinstance(array, Volume) else Volume(array)
    resolved = Scene(
        volume=volume, transfer_function=function, camera=Camera(**camera),
        image={"width": size[0], "height": size[1]}, **tables,
    ).resolve()  # fmt: skip
    engines = Engines(context)
    try:
        return engines.make(resolved).render(resolved.camera, *size).depth
    finally:
        engines.close()


def half(opacity: float) -> float:
    """How far a ray goes in a medium of this opacity per edge before half of it is absorbed."""
    return math.log(2.0) / -math.log1p(-opacity) if opacity < 1 else 0.0


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: "-".join(rule.values()))
def test_a_homogeneous_medium_absorbs_half_at_ln_2_over_its_extinction(context, rule):
    for opacity in STEEP:
        for step in STEPS:
            depth = seen(context, uniform(), level(opacity), integration={"step": step, **rule})
            wrong = np.abs(depth - (ENTRY + half(opacity))).max()
            assert wrong < 1e-3 * step, (opacity, step, wrong / step)


@pytest.mark.parametrize("how", ELSEWHERE)
def test_so_it_does_under_every_effect_and_method(context, how):
    tables = {**ELSEWHERE[how]}
    integration = tables.pop("integration", {})
    entry = ENTRY + (9.3 if how == "clip" else 0.0)
    share = 0.7 if how == "factor" else 1.0
    for opacity in STEEP:
        for step in STEPS:
            depth = seen(
                context, uniform(), level(opacity), integration={"step": step, **integration}, **tables
            )
            wrong = np.abs(depth - (entry + half(opacity) / share)).max()
            assert wrong < 1e-3 * step, (opacity, step, wrong / step)


# In media that are linear along the ray a chord is all there is to know of a segment.
PROFILES = {
    "thin": rising(0.2),
    "steep": rising(0.999),
    "opaque at the end": rising(1.0),
    "a jump": TransferFunction([0, 101.3, 101.3, 255], [0, 0, 0.97, 0.97], [WHITE] * 4),
    "a jump to opaque": TransferFunction([0, 101.3, 101.3, 255], [0, 0, 1, 1], [WHITE] * 4),
    "a peak": TransferFunction([0, 120, 123, 126, 200, 255], [0, 0, 0.9, 0, 0, 0.8], [WHITE] * 6),
}



def optical_depth(function: TransferFunction, length: float) -> float:
    """Of a ray's first ``length`` edges through ramp(), in closed form: opacity is linear between the points,
    and int -log(1 - a) da = a + (1 - a) log(1 - a)."""

    def antiderivative(a):
        return a + (1 - a) * math.log1p(-a) if a < 1 else 1.0

    per_edge = 255.0 / (SHAPE[0] - 1)
    end, total = length * per_edge, 0.0
    for v0, v1, a0, a1 in zip(function.values, function.values[1:], function.opacities, function.opacities[1:]):
        low, high = v0, min(v1, end)
        if not high > low:
            continue
        b = a0 + (a1 - a0) * (high - v0) / (v1 - v0)
        if a0 == b:
            mean = -math.log1p(-a0) if a0 < 1 else math.inf
        else:
            mean = (antiderivative(b) - antiderivative(a0)) / (b - a0)
        total += mean * (high - low) / per_edge
    return total


def depth_along_ramp(function: TransferFunction, left: float = math.log(2.0)) -> float:
    low, high = 0.0, SHAPE[0] - 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if optical_depth(function, middle) < left else (low, middle)
    return ENTRY + high


@pytest.mark.parametrize("profile", PROFILES)
def test_the_references_depth_is_right(device, profile):
    camera = axis_camera(MIDDLE, axis=2, height=4.0, distance=DISTANCE)
    scene = make_scene(ramp(), PROFILES[profile], camera=camera, width=3, height=2)
    depth = render_reference(scene, device, tolerance=1e-9)[1]
    np.testing.assert_allclose(depth, depth_along_ramp(PROFILES[profile]), rtol=0, atol=1e-5)


@pytest.mark.parametrize("profile", PROFILES)
def test_pre_integrated_depth_is_the_references_at_any_step(context, profile):
    function = PROFILES[profile]
    expected = depth_along_ramp(function)
    for rule in CHORDS:
        for step in (*STEPS, 9.0):
            depth = seen(context, ramp(), function, integration={"step": step, **rule})
            print(profile, rule, step, np.abs(depth - expected).max() / step)
