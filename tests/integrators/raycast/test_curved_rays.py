"""Rays that bend by the gradient of an index of refraction: against the plain twin and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.effect_scenes import HAZE, LIGHTS, MATERIAL, NOTHING, blobs, oblique, picture, scene, twin

from clvol import Scene, TransferFunction, Volume
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.features import called_for, reduced
from clvol.integrators.registry import check_scene
from clvol.scene import RefractiveIndex

SHAPE = (15, 17, 19)
CAMERA = oblique(SHAPE)
GLASSY = {"points": [{"value": 0.0, "index": 1.0}, {"value": 0.5, "index": 1.02}, {"value": 1.0, "index": 1.3}]}
ON_THE_FLY = {"gradient": {"storage": "on-the-fly"}, "camera": CAMERA}


def check(context, resolved, limit=1e-4):
    """Errors of directions grow along a ray: rounding does, by the index's curvature."""
    found, expected = picture(context, resolved), twin(resolved)
    assert expected[..., 3].max() > 0.1 and found.counters["bends"] > 100
    np.testing.assert_allclose(found.rgba, expected, rtol=0, atol=limit)
    return found.rgba


CASES = {
    "post": {},
    "long step": {"integration": {"step": 2.7}},
    "inside": {"camera": {"position": [9.3, 8.1, 7.4], "target": [2, 3, 15], "up": [0, 1, 0], "fov_degrees": 70.0}},
    "less than before": {"refraction": {"points": [{"value": 0.2, "index": 1.4}, {"value": 0.8, "index": 1.0}]}},
    "preintegrated": {"integration": {"classification": "preintegrated"}},
    "lit, cut and cued": {
        "light": LIGHTS, "material": MATERIAL, "clip": [{"point": [9.0, 8.0, 7.0], "normal": [1.0, 0.4, -0.3]}],
        "depth_cue": {"strength": 0.8, "color": [0.2, 0.4, 0.9], "start": 30.0},
    },
}  # fmt: skip


@pytest.mark.parametrize("case", [
    each if each not in ("preintegrated", "lit, cut and cued") else pytest.param(each, marks=pytest.mark.slow)
    for each in CASES
])  # the slow ones compile programs of their own
def test_pictures_through_curved_rays_are_the_twins(context, case):
    resolved = scene(blobs(SHAPE), **{"refraction": GLASSY, **ON_THE_FLY, **CASES[case]})
    found = check(context, resolved)
    straight = twin(replace(resolved, refraction=None, source=f"{resolved.source}# straight"))
    assert np.abs(found - straight).max() > 0.01


@pytest.mark.slow  # compiles a program for each device
def test_every_device_bends_rays_alike(contexts, each_device):
    check(contexts(each_device), scene(blobs(SHAPE), refraction=GLASSY, **ON_THE_FLY))


def sparse(**tables):
    array = np.zeros((40, 17, 19), np.float32)
    array[12:27] = blobs(SHAPE)
    function = TransferFunction([0.0, 0.6, 1.0], [0.0, 0.0, 0.4], np.ones((3, 3)))
    points = [{"value": 0.1, "index": 1.0}, {"value": 0.5, "index": 1.1}]
    return scene(array, function, refraction={"points": points}, gradient={"storage": "on-the-fly"},
                 camera=oblique(array.shape), **tables)  # fmt: skip


def test_leaps_change_nothing(context):
    """What is transparent and bends rays is no empty space."""
    resolved = sparse()
    one, other = picture(context, resolved), picture(context, resolved, skip=False)
    assert np.array_equal(one.rgba, other.rgba) and one.samples < other.samples
    assert one.counters["bends"] == other.counters["bends"] > 0
    straight = picture(context, replace(resolved, refraction=None)).rgba
    assert np.abs(straight - one.rgba).max() > 0.01


@pytest.mark.slow  # compiles programs with a field
def test_what_masks_hide_bends_rays_all_the_same(context):
    """With leaps and without."""
    half = np.zeros((40, 17, 19), np.float32)
    half[20:] = 1.0
    resolved = sparse(field=[{"file": Volume(half), "role": "mask", "threshold": 0.5}])
    one, other = picture(context, resolved), picture(context, resolved, skip=False)
    assert np.array_equal(one.rgba, other.rgba) and one.samples < other.samples
    assert one.counters["bends"] == other.counters["bends"] > 0


def test_an_index_that_is_constant_leaves_rays_straight_bit_for_bit(context):
    plain = scene(blobs(SHAPE), **ON_THE_FLY)
    for points in ([{"value": 0.3, "index": 1.5}], [{"value": 0.0, "index": 1.5}, {"value": 1.0, "index": 1.5}],
                   [{"value": 2.0, "index": 1.0}, {"value": 3.0, "index": 1.5}]):  # fmt: skip
        idle = scene(blobs(SHAPE), refraction={"points": points}, **ON_THE_FLY)
        assert kernel_hash(idle) == kernel_hash(plain) and reduced(idle).refraction is None
        told = {e["name"]: e for e in explain(idle)["effects"]}["continuous refraction"]
        assert not told["called_for"] and "the same for all values" in told["reason"]
    # A gradient of 0 in a volume whose other values bend rays.
    array = np.full((9, 9, 30), 0.2, np.float32)
    array[..., 20:] = np.linspace(0.2, 1.0, 10)
    camera = {"projection": "orthographic", "position": [8.0, 4.0, -9.0], "target": [8.0, 4.0, 4.0],
              "up": [0.0, 1.0, 0.0], "height": 6.0}  # fmt: skip
    tables = {"gradient": {"storage": "on-the-fly"}, "camera": camera, "size": (8, 8)}
    curved = picture(context, scene(array, refraction=GLASSY, **tables))
    straight = picture(context, replace(scene(array, refraction=GLASSY, **tables), refraction=None), lanes=None)
    assert curved.counters["bends"] == 0
    np.testing.assert_allclose(curved.rgba, straight.rgba, atol=1e-7)


def slab(n=65, depth=129):
    """0 to 1 across y, constant along x and z."""
    return np.broadcast_to(np.linspace(0.0, 1.0, n, dtype=np.float32)[None, :, None], (depth, n, 5)).copy()


def path_height(context, step, y0=16.0):
    """Where a ray that enters at height ``y0`` along z leaves a slab, read from the colour of a thin last layer."""
    array = slab()
    index = {"points": [{"value": float(v), "index": float(np.sqrt(1.0 + 0.4 * v))} for v in np.linspace(0, 1, 129)]}
    camera = {"projection": "orthographic", "position": [2.0, y0, -9.0], "target": [2.0, y0, 4.0],
              "up": [0.0, 1.0, 0.0], "height": 1e-3}  # fmt: skip
    seen = TransferFunction([0.0, 1.0], [1e-3, 1e-3], [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    resolved = scene(array, seen, size=(1, 1), refraction=index, camera=camera, gradient={"storage": "on-the-fly"},
                     integration={"step": step})  # fmt: skip
    rgba = picture(context, resolved).rgba[0, 0]
    return rgba[0] / rgba[3], resolved


def test_a_ray_through_a_linear_gradient_is_a_parabola(context):
    """With n^2 = 1 + g y, rays are parabolas: y = y0 + g z^2 / (4 n0^2), n0 where the ray enters along z. Its mean
    height, weighed by the length of the path, is what the colour shows."""
    y0, g = 16.0, 0.4 / 64
    square = 1.0 + g * y0  # of n0
    z = np.linspace(0.0, 128.0, 20001)
    y = y0 + g * z**2 / (4.0 * square)
    length = np.sqrt(1.0 + (g * z / (2.0 * square)) ** 2)
    depth = np.cumsum(length) * (z[1] - z[0]) * -np.log(1 - 1e-3)
    weight = length * np.exp(-depth)
    expected = np.sum(y * weight) / np.sum(weight) / 64
    errors = [abs(path_height(context, step, y0)[0] - expected) for step in (8.0, 4.0, 2.0, 0.5)]
    assert expected > 0.35 and errors[-1] < 1e-4
    assert errors[1] < 0.4 * errors[0] and errors[2] < 0.4 * errors[1]  # second order


def test_rays_that_go_in_circles_end(context):
    """Maxwell's fish eye, n = 2 / (1 + r^2), in which rays are circles."""
    x = np.linspace(-1, 1, 33)
    r = np.sqrt(x[:, None, None] ** 2 + x[:, None] ** 2 + x**2).astype(np.float32)
    points = [{"value": float(v), "index": float(4.0 / (1.0 + 4.0 * v**2))} for v in np.linspace(0, 1.5, 100)]
    camera = {"position": [16.0, 16.0, 22.0], "target": [30.0, 16.0, 22.0], "up": [0.0, 1.0, 0.0], "fov_degrees": 60.0}
    thin = TransferFunction([0.0, 1.0], [1e-3, 1e-3], np.ones((2, 3)))
    resolved = scene(r, thin, size=(8, 8), refraction={"points": points}, camera=camera,
                     gradient={"storage": "on-the-fly"})  # fmt: skip
    found = picture(context, resolved)
    longest = -np.log(1.0 - found.rgba[..., 3].max()) / -np.log(1 - 1e-3)
    assert np.isfinite(found.rgba).all() and 2 * 55.5 < longest < 10 * 55.5


def test_what_is_not_a_number_bends_nothing(context):
    array = blobs(SHAPE)
    array[5:8, 6:9, 7:11] = np.nan
    found = picture(context, scene(array, refraction=GLASSY, **ON_THE_FLY))
    assert np.isfinite(found.rgba).all() and found.counters["bends"] > 0


@pytest.mark.slow  # compiles a program of its own
def test_an_environment_behind_is_seen_along_the_last_direction(context, tmp_path):
    import OpenEXR

    rows, columns = (np.arange(24) + 0.5) / 24 * np.pi, ((np.arange(48) + 0.5) / 48 - 0.5) * 2 * np.pi
    v, u = np.meshgrid(rows, columns, indexing="ij")
    x, y, z = np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u)
    rgb = np.stack([1 + 0.6 * x, 0.8 + 0.5 * y, 0.5 + 0.4 * z], -1).astype(np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": rgb}).write(str(tmp_path / "sky.exr"))
    sky = {"file": str(tmp_path / "sky.exr"), "visible": True}
    resolved = scene(blobs(SHAPE), NOTHING, refraction=GLASSY, environment=sky, **ON_THE_FLY)
    assert called_for(resolved) == ["environment background", "continuous refraction", "gradients"]
    expected, found = twin(resolved), picture(context, resolved).rgba
    np.testing.assert_allclose(found, expected, atol=2e-3)
    assert np.abs(expected - twin(replace(resolved, refraction=None, source="straight"))).max() > 0.02


@pytest.mark.parametrize("tables, where", [
    ({"isosurface": [{"value": 0.5}]}, "isosurface.*straight rays"),
    ({"integration": {"quadrature": "cells"}}, "continuous refraction"),
    ({"integration": {"method": "pyramid", "classification": "preintegrated"}}, "continuous refraction"),
    ({"integration": {"method": "slicing"}}, "continuous refraction"),
    ({"integration": {"method": "multiresolution"}}, "continuous refraction"),
    ({"integration": {"method": "reference"}}, "refraction"),
])  # fmt: skip
def test_what_rays_that_bend_cannot_be_combined_with_is_refused(tables, where):
    with pytest.raises(SceneError, match=where):
        check_scene(scene(blobs(SHAPE), refraction=GLASSY, **{"camera": CAMERA, **tables}))


@pytest.mark.parametrize("points, where", [
    ([], "refraction.points"), ([{"value": 0.0, "index": 0.0}], "refraction.points.0.index"),
    ([{"value": 0.0, "index": 1.0}, {"value": 0.0, "index": 1.2}], "refraction.points.1.value"),
])  # fmt: skip
def test_what_is_no_index_is_refused(points, where):
    with pytest.raises(SceneError, match=where):
        Scene(volume=Volume(blobs(SHAPE)), transfer_function=HAZE, refraction={"points": points})


@pytest.mark.parametrize("indices", [
    [1, 1.2, 1.2, 1.5, 1.5], [1, 1.1, 1.2, 1.1, 1.1], [1, 1, 1, 1, 2], [2, 2, 2, 2, 2],
])  # fmt: skip
def test_the_shape_of_an_index_has_opacity_where_it_changes(indices):
    index = RefractiveIndex(np.arange(5.0), np.array(indices, float))
    at = np.linspace(-1, 5, 601) + 1e-9
    changes = index.slope(at) != 0
    shape = index.shape
    assert (shape is None) == (not changes.any())
    if shape is not None:
        np.testing.assert_array_equal(shape.opacity(at) > 0, changes)
