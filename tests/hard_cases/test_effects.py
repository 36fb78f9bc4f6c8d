"""Properties of scenes with lights, surfaces and clips: random small ones, and extreme numbers."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import HAZE, LIGHTS, MATERIAL, SIZE, blobs, oblique, picture, scaled, scene
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reference import render_twin

from clvol import TransferFunction

# What compiles a program of its own: voxel type, holes, filter, classification, gradients.
VARIANTS = {
    "uint8": (np.uint8, False, {"filter": "linear", "classification": "post"}, {}),
    "float32 with holes, preintegrated": (
        np.float32, True, {"filter": "linear", "classification": "preintegrated"}, {}
    ),
    "float64 with holes, cubic, pre": (
        np.float64, True, {"filter": "cubic", "classification": "pre"}, {}
    ),
    "float32, nearest, sobel": (
        np.float32, False, {"filter": "nearest", "classification": "post"},
        {"storage": "on-the-fly", "operator": "sobel"},
    ),
}  # fmt: skip
variants = pytest.mark.parametrize("variant", VARIANTS)


def examples(count: int):
    slow = [HealthCheck.too_slow, HealthCheck.data_too_large]
    return settings(max_examples=count, deadline=None, derandomize=True, database=None,
                    suppress_health_check=slow)  # fmt: skip


@st.composite
def scenes(draw, variant):
    """Resolved scenes with lights, surfaces that refract, clips that cut and a depth cue."""
    dtype, holes, integration, gradient = VARIANTS[variant]
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    shape = tuple(draw(st.integers(1, 11)) for _ in range(2)) + (draw(st.integers(3, 11)),)
    top = {np.uint8: 255.0, np.float32: 1.0, np.float64: 1e5}[dtype]
    smooth = draw(st.booleans())
    field = rng.random(shape)
    if smooth:
        field = blobs(shape, seed=int(rng.integers(99)), dtype=np.float64)
    # Each scene has something of everything: else it would be a program of its own.
    field.flat[:2] = 0.0, 1.0
    array = field * top
    array = np.round(array).astype(dtype) if dtype == np.uint8 else array.astype(dtype)
    if holes:
        bad = rng.choice([np.nan, np.inf, -np.inf], shape)
        is_bad = rng.random(shape) < draw(st.sampled_from([0.003, 0.08]))
        is_bad.flat[:3] = False, False, True
        array = np.where(is_bad, bad, array)
    spacing = 10.0 ** rng.uniform(-0.5, 0.5, 3) * 10.0 ** draw(st.sampled_from([-6.0, 0.0, 3.0]))
    size = np.maximum(np.array(shape[::-1]) - 1.0, 1.0) * spacing
    count = draw(st.integers(0, 4))
    values = np.sort(rng.uniform(0, 1, count + 1)) * top
    opacities = rng.choice([0.0, 1.0, 0.5, *rng.random(3)], count + 1)
    opacities[-1] = max(opacities[-1], 0.1)
    unit = float(size.max()) * 10.0 ** draw(st.sampled_from([-1, 0]))
    function = TransferFunction(values, opacities, rng.random((count + 1, 3)), unit)
    lights = [_light(rng, size) for _ in range(draw(st.integers(1, 4)))]
    surfaces = [
        {"value": float(rng.uniform(0.1, 0.9) * top), "opacity": float(rng.choice([1.0, 0.4])),
         "color": rng.random(3).tolist(), "back_color": rng.random(3).tolist(),
         "refraction": float(rng.choice([1.0, 1.3, 0.6]))}
        for _ in range(draw(st.integers(1, 3)))
    ]  # fmt: skip
    surfaces[0]["refraction"] = 1.4
    clips = [_clip(rng, size) for _ in range(draw(st.integers(0, 2)))]
    clips.append({"type": "sphere", "center": (0.4 * size).tolist(), "keep": "outside",
                  "radius": float(rng.uniform(0.1, 0.4) * size.max())})  # fmt: skip
    material = {
        "ambient": rng.random(), "diffuse": rng.random(), "specular": 0.05 + 0.9 * rng.random(),
        "shininess": float(rng.choice([1.0, 20.0, 1e4])), "two_sided": bool(rng.random() < 0.7),
        "fade": float(rng.choice([0.0, 0.1 * top / size.max()])),
    }  # fmt: skip
    away = rng.normal(size=3)
    away *= np.linalg.norm(size) / np.linalg.norm(away) * draw(st.sampled_from([0.1, 2.0, 20.0]))
    camera = {
        "projection": draw(st.sampled_from(["perspective", "orthographic"])),
        "position": (size / 2 + away).tolist(), "target": (size / 2).tolist(),
        "up": rng.normal(size=3).tolist(), "height": float(np.linalg.norm(size)),
        "fov_degrees": float(min(140.0, np.degrees(1.6 * np.linalg.norm(size)
                                                   / np.linalg.norm(away)))),
    }  # fmt: skip
    cue = {"strength": 0.5, "color": rng.random(3).tolist()}
    resolved = scene(
        array, function, grid={"spacing": tuple(spacing)}, size=(13, 10), camera=camera,
        light=lights, material=material, isosurface=surfaces, clip=clips, depth_cue=cue,
        gradient=gradient, integration={**integration, "table_size": 64,
                                        "step": draw(st.sampled_from([0.4, 1.0, 3.0]))},
    )  # fmt: skip
    return resolved


def _light(rng, size):
    kind = rng.choice(["directional", "point", "headlight"])
    light = {"type": str(kind), "color": rng.random(3).tolist(), "intensity": 0.1 + rng.random()}
    if kind == "directional":
        light["direction"] = rng.normal(size=3).tolist()
    if kind == "point":
        light["position"] = (rng.uniform(-1, 2, 3) * size).tolist()
    return light


def _clip(rng, size):
    kind = rng.choice(["plane", "box", "sphere"])
    at = rng.uniform(-0.3, 1.3, 3) * size
    if kind == "plane":
        normal = rng.normal(size=3)
        normal *= np.sign((size / 2 - at) @ normal)
        return {"point": at.tolist(), "normal": normal.tolist()}
    if kind == "box":
        reach = rng.uniform(0.1, 0.4, 3) * size
        return {"type": "box", "lower": (at - reach).tolist(), "upper": (at + reach).tolist(),
                "keep": "outside"}  # fmt: skip
    radius = float(rng.uniform(0.1, 0.4) * size.max())
    return {"type": "sphere", "center": at.tolist(), "radius": radius, "keep": "outside"}


def brightest(resolved) -> np.ndarray:
    """The most [3] that a lit, cued sample or surface can show."""
    colors = [*np.atleast_2d(resolved.transfer_function.color(resolved.transfer_function.values))]
    colors += [c for s in resolved.isosurfaces for c in (s.color, s.back_color)]
    color = np.max(colors, axis=0)
    m, light = resolved.material, sum(np.array(k.color) * k.intensity for k in resolved.lights)
    lit = color * (m.ambient + m.diffuse * light) + m.specular * light
    return np.maximum.reduce([color, lit, np.array(resolved.depth_cue.color)])


@pytest.mark.slow
@variants
def test_pictures_with_effects_are_finite_bounded_and_the_same_again(context, variant):
    @examples(15)
    @given(scenes(variant))
    def check(resolved):
        data = picture(context, resolved)
        rgba, most = data.rgba, brightest(resolved)
        assert np.isfinite(rgba).all() and not np.isnan(data.depth).any()
        assert rgba[..., 3].min() >= 0 and rgba[..., 3].max() <= 1
        assert rgba[..., :3].min() >= 0
        assert (rgba[..., :3] <= rgba[..., 3:] * most * (1 + 1e-5) + 3e-6).all()
        assert np.isfinite(data.depth[rgba[..., 3] > 0.5 + 1e-6]).all() and (data.depth >= 0).all()
        for how in ({}, {"tile": (8, 4)}, {"skip": False}):
            assert np.array_equal(picture(context, resolved, **how).rgba, rgba)
        seen.append(rgba[..., 3].max() > 0.05)

    seen: list = []
    check()
    # A hole blanks four voxels around it under the cubic filter: much of the smallest volumes.
    assert np.mean(seen) > 0.25, "too many of these scenes are blank"


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["uint8", "float64 with holes, cubic, pre"])
def test_random_scenes_are_mostly_the_twins(context, variant):
    """Rays that graze a surface, or bend at one of noise, may go either way: of most scenes' pixels
    the most are the same."""

    @examples(12)
    @given(scenes(variant))
    def check(resolved):
        apart = np.abs(picture(context, resolved).rgba - render_twin(resolved)).max(axis=-1)
        shares.append(np.mean(apart > 2e-2))

    shares: list = []
    check()
    assert np.median(shares) <= 0.02 and np.mean(shares) < 0.1, shares


def extreme(value=1.0, unit=1.0, dtype=np.float32, fade=0.05):
    """One scene in other units of value and length."""
    array = (blobs().astype(np.float64) * value).astype(dtype)
    camera = oblique(array.shape)
    for key in ("position", "target"):
        camera[key] = (np.array(camera[key]) * unit).tolist()
    lights = [dict(light) for light in LIGHTS]
    lights[1]["position"] = (np.array(lights[1]["position"]) * unit).tolist()
    surfaces = [{"value": 0.35 * value, "opacity": 0.4, "color": [0.9, 0.3, 0.2]},
                {"value": 0.6 * value, "opacity": 0.7, "color": [0.2, 0.3, 0.9]}]  # fmt: skip
    clips = [
        {"type": "sphere", "center": (np.array([9.0, 8.0, 5.0]) * unit).tolist(),
         "radius": 5.0 * unit, "keep": "outside"},
        {"point": (np.array([3.0, 8.0, 7.0]) * unit).tolist(), "normal": [1.0, 0.4, -0.3]},
    ]  # fmt: skip
    return scene(
        array, scaled(HAZE, value, unit), grid={"spacing": (unit,) * 3}, camera=camera,
        light=lights, material={**MATERIAL, "fade": fade * value / unit}, isosurface=surfaces,
        clip=clips,
        depth_cue={"start": 10 * unit, "end": 60 * unit, "color": [0.5, 0.4, 0.3]},
        gradient={"storage": "on-the-fly"}, size=SIZE,
    )  # fmt: skip


NUMBERS = [
    (1e17, 1.0, np.float32), (1e-11, 1.0, np.float32), (1e-17, 1.0, np.float32),
    (1e30, 1.0, np.float32), (1e-30, 1.0, np.float32), (1e37, 1.0, np.float32),
    (1.0, 1e28, np.float32), (1.0, 1e-30, np.float32), (1e-20, 1e20, np.float32),
    (1e20, 1e-20, np.float32), (1e300, 1.0, np.float64), (1e-300, 1.0, np.float64),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("value, unit, dtype", NUMBERS)
def test_units_of_value_and_length_do_not_show(context, value, unit, dtype):
    """Lights, fading, surfaces, clips and cues, over values and lengths of any magnitude."""
    if "base" not in _pictures.setdefault(context.device, {}):
        _pictures[context.device]["base"] = picture(context, extreme()).rgba
    base = _pictures[context.device]["base"]
    found = picture(context, extreme(value, unit, dtype)).rgba
    assert base[..., 3].max() > 0.5
    np.testing.assert_allclose(found, base, rtol=0, atol=1e-5)


_pictures: dict = {}
