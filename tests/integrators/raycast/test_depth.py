"""Depth: where along a ray its opacity reaches one half, to a thousandth of a step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.small_scenes import axis_camera, make_scene

from clvol import Camera, Scene, TransferFunction, Volume
from clvol.integrators.reference.picture import render_reference
from clvol.render.prepared_cache import PreparedCache

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
    """The picture's depth, by whatever method the tables ask for; by even steps."""
    camera = camera or axis_camera(MIDDLE, axis=2, height=4.0, distance=DISTANCE)
    tables["integration"] = {"early_termination": 0.0, "step_error": 0.0, **tables.get("integration", {})}
    volume = array if isinstance(array, Volume) else Volume(array)
    resolved = Scene(
        volume=volume, transfer_function=function, camera=Camera(**camera),
        image={"width": size[0], "height": size[1]}, **tables,
    ).resolve()  # fmt: skip
    engines = PreparedCache(context)
    try:
        return engines.prepare(resolved).render(resolved.camera, *size).depth
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


# Nodes enough that the table's own error is below that of the place.
FINE = {"table_size": 512}


@pytest.mark.parametrize("profile", PROFILES)
def test_pre_integrated_depth_is_exact_at_any_step(context, profile):
    function = PROFILES[profile]
    expected = depth_along_ramp(function)
    for rule in CHORDS:
        for step in (0.4, 2.7, 9.0):
            depth = seen(context, ramp(), function, integration={"step": step, **rule, **FINE})
            wrong = np.abs(depth - expected).max()
            assert wrong < 1e-3 * min(step, 1.0), (rule, step, wrong)


@pytest.mark.parametrize("rule", [r for r in RULES if r not in CHORDS], ids=lambda rule: "-".join(rule.values()))
def test_depth_by_midpoints_is_as_exact_as_their_sums(context, rule):
    """To a thousandth at steps of one, four times better at half of it: what is left is the rule's own error."""
    for profile in ("thin", "steep", "opaque at the end"):
        function = PROFILES[profile]
        expected = depth_along_ramp(function)
        if rule["classification"] == "pre":  # extinction is linear between voxels: not quite the same medium
            expected = seen(context, ramp(), function, integration={"method": "reference", **rule})
        for step in (1.0, 0.5):
            depth = seen(context, ramp(), function, integration={"step": step, **rule})
            wrong = np.abs(depth - expected).max()
            assert wrong < 1e-3 * step**2 + 1e-5, (profile, step, wrong)


@pytest.mark.parametrize("how", ["cue", "clip", "pyramid", "blocks", "long steps"])
def test_and_so_it_is_under_other_methods(context, how):
    """Clipped rays begin farther on, where the medium is less than half as deep."""
    tables = {**ELSEWHERE[how]}
    integration = {"classification": "preintegrated", **tables.pop("integration", {}), **FINE}
    if "multiresolution" in tables:  # a finest level alone: fields of others are not the ramp
        tables["multiresolution"] = {**tables["multiresolution"], "memory": "64 MiB"}
    for profile in ("steep", "a jump to opaque"):
        function, left = PROFILES[profile], math.log(2.0)
        if how == "clip":
            left += optical_depth(function, 9.3)
        expected = depth_along_ramp(function, left)
        for step in (0.7, 2.3):
            depth = seen(context, ramp(), function, integration={"step": step, **integration}, **tables)
            wrong = np.abs(depth - expected).max()
            assert wrong < 1e-3 * step, (profile, step, wrong / step)


@pytest.mark.parametrize("rule", CHORDS[:1] + RULES[1:3], ids=lambda rule: rule["classification"])
def test_surfaces_in_the_segment_take_their_part(context, rule):
    """A surface that lets 0.6 through: half is absorbed before it, by it, or behind it."""
    per_edge = 255.0 / (SHAPE[0] - 1)
    for opacity, place in ((0.05, 10.3), (0.05, 3.4), (0.05, 40.2), (0.9, 0.25), (0.9, 0.6)):
        extinction = -math.log1p(-opacity)
        surface = {"value": place * per_edge, "opacity": 0.4}
        before = extinction * place
        expected = math.log(2.0) / extinction
        if expected > place:
            left = math.log(2.0) - before + math.log1p(-0.4)
            expected = place + max(left, 0.0) / extinction
        for step in STEPS:
            integration = {"step": step, **rule}
            depth = seen(context, ramp(), level(opacity), integration=integration, isosurface=[surface])
            wrong = np.abs(depth - (ENTRY + expected)).max()
            assert wrong < 1e-3 * step + 1e-4, (opacity, place, step, wrong / step)


def test_layers_take_theirs(context):
    """In a ramp the gradient is one everywhere: two functions of the value are mixed in equal shares."""
    magnitude = 255.0 / (SHAPE[0] - 1)
    layer = {"magnitude": 2.0 * magnitude, "points": points(PROFILES["thin"])}
    low, high = 0.0, SHAPE[0] - 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        both = [optical_depth(PROFILES[name], middle) for name in ("steep", "thin")]
        low, high = (middle, high) if sum(both) < 2 * math.log(2.0) else (low, middle)
    for step in (0.4, 2.7):
        integration = {"step": step, "classification": "preintegrated", **FINE}
        depth = seen(context, ramp(), PROFILES["steep"], integration=integration, transfer_layer=[layer])
        assert np.abs(depth - (ENTRY + high)).max() < 1e-3 * step


@pytest.mark.slow
def test_densities_add_to_what_is_absorbed(context):
    field = {"file": Volume(uniform()), "role": "density", "points": points(level(0.3))}
    extinction = -math.log1p(-0.3) + math.log(2.0) / half(0.4)
    for step in STEPS:
        depth = seen(context, uniform(), level(0.4), integration={"step": step}, field=[field])
        assert np.abs(depth - (ENTRY + math.log(2.0) / extinction)).max() < 1e-3 * step


def points(function: TransferFunction) -> list[dict]:
    rows = zip(function.values, function.opacities, function.colors)
    return [{"value": float(v), "opacity": float(o), "color": [float(x) for x in c]} for v, o, c in rows]


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: "-".join(rule.values()))
def test_from_an_eye_inside_depth_begins_at_the_eye(context, rule):
    camera = {"position": [3.5, 3.5, 20.25], "target": [3.5, 3.5, 60.0], "fov_degrees": 8.0, "up": [0, 1, 0]}
    for opacity in STEEP[1:]:
        depth = seen(context, uniform(), level(opacity), camera=camera, integration={"step": 1.3, **rule})
        assert np.abs(depth - half(opacity)).max() < 1e-3 * 1.3


def test_depth_does_not_depend_on_the_step(context):
    """Oblique rays through a ramp along an axis, at steps that divide nothing."""
    camera = {"position": [20.0, -31.0, -40.0], "target": list(MIDDLE), "fov_degrees": 5.0}
    for function in (rising(0.2), rising(0.9)):
        pictures = [
            seen(context, ramp(), function, camera=camera, size=(16, 12), integration={"step": step, **FINE})
            for step in (0.31, 0.83, 1.9)
        ]
        both = np.isfinite(pictures).all(axis=0)
        assert both.mean() > 0.2
        for other, step in zip(pictures[1:], (0.83, 1.9)):
            assert np.abs(other[both] - pictures[0][both]).max() < 1e-3 * step + 1e-4
