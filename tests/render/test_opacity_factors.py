"""Factors on the extinction by the gradient, and functions of value and gradient magnitude."""

from __future__ import annotations

import numpy as np
import pytest
from reference import render_twin
from small_scenes import axis_camera, picture, waves
from twin_scenes import RAMP_SIZE, constant_function, ramp, scene

from clvol import TransferFunction, Volume
from clvol.transfer.opacity_envelope import opacity_envelope

KINDS = ("post", "preintegrated", "pre")
SIZE = 17
COLORS = np.eye(3)
WAVES = waves((15, 13, 18))
EXACT = {"storage": "on-the-fly"}  # gradients


def saddle(scale=1.0, spacing=1.0) -> Volume:
    """scale * x * y in voxels: along x the derivative is exactly scale * y a voxel."""
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="xy")
    array = np.broadcast_to(scale * x * y, (3, SIZE, SIZE)).astype(np.float32)
    return Volume(np.ascontiguousarray(array), spacing=(spacing,) * 3)


def along_x(spacing=1.0) -> dict:
    """Rays along x, one through each row of voxels y = 0, 1, ... (the picture's columns)."""
    half = 0.5 * (SIZE - 1) * spacing
    camera = {
        "projection": "orthographic", "position": [-30.0 * spacing, half, spacing],
        "target": [half, half, spacing], "up": [0.0, 0.0, 1.0], "height": 1e-3 * spacing,
    }  # fmt: skip
    return {"camera": camera, "image": {"width": SIZE, "height": 1}}


def rows_of(context, volume, spacing=1.0, function=None, **tables) -> np.ndarray:
    """rgba [y, 4] of the rays along x through the rows of voxels, y ascending."""
    seen = along_x(spacing)
    seen["camera"]["height"] = spacing  # a pixel is square: one row of them, a voxel wide each
    resolved = scene(volume, function, gradient=EXACT, **seen, **tables)
    rgba = picture(context, resolved).rgba[0]
    right = resolved.camera.basis()[1]
    return rgba if right[1] > 0 else rgba[::-1]


def absorbed(depth):
    return -np.expm1(-np.asarray(depth))


def depth_of(opacity: float, length: float) -> float:
    return -np.log1p(-opacity) * length


def layer(magnitude, values, opacities, colors=COLORS) -> dict:
    points = [
        {"value": float(v), "opacity": float(o), "color": [float(part) for part in c]}
        for v, o, c in zip(values, opacities, colors)
    ]
    return {"magnitude": magnitude, "points": points}


def test_thousands_of_points_are_looked_up_exactly(context):
    at = np.sort(np.random.default_rng(1).uniform(0.0, 16.0, 4096)).astype(np.float32)
    factors = np.random.default_rng(2).uniform(0.0, 1.0, 4096)
    points = [{"derivative": float(a), "opacity": float(f)} for a, f in zip(at, factors)]
    rows = rows_of(context, saddle(), directional_opacity={"points": points})
    expected = np.interp(np.arange(SIZE), at, factors) * depth_of(0.1, SIZE - 1)
    np.testing.assert_allclose(rows[:, 3], absorbed(expected), atol=3e-5)


@pytest.mark.parametrize("spacing", [0.125, 4.0])
def test_magnitudes_are_per_world_length(context, spacing):
    points = [{"derivative": 0.0, "opacity": 0.0}, {"derivative": 16.0 / spacing, "opacity": 1.0}]
    volume = saddle(spacing=spacing)
    rows = rows_of(context, volume, spacing, directional_opacity={"points": points})
    expected = np.arange(SIZE) / 16.0 * depth_of(0.1, (SIZE - 1) * spacing)
    np.testing.assert_allclose(rows[:, 3], absorbed(expected), atol=2e-6)


def test_of_a_step_the_later_point_holds_at_it(context):
    points = [(4.0, 1.0), (4.0, 0.25), (8.0, 0.25), (8.0, 0.75)]
    points = [{"derivative": d, "opacity": o} for d, o in points]
    rows = rows_of(context, saddle(), directional_opacity={"points": points})
    y = np.arange(SIZE)
    expected = np.where(y < 4, 1.0, np.where(y < 8, 0.25, 0.75)) * depth_of(0.1, SIZE - 1)
    np.testing.assert_allclose(rows[:, 3], absorbed(expected), atol=2e-6)


def test_a_single_point_holds_everywhere(context):
    factor = {"points": [{"magnitude": 3.0, "opacity": 0.5}]}
    rows = rows_of(context, saddle(), gradient_opacity=factor)
    np.testing.assert_allclose(rows[:, 3], absorbed(0.5 * depth_of(0.1, SIZE - 1)), atol=2e-6)


def test_the_gradients_magnitude_counts_in_all_directions(context):
    points = [{"magnitude": 0.0, "opacity": 0.0}, {"magnitude": 10.0, "opacity": 1.0}]
    ramps = np.arange(16.0)[:, None, None] * 3.0 + np.arange(16.0)[None, :, None] * 4.0
    volume = Volume(np.ascontiguousarray(np.broadcast_to(ramps, (16, 16, 16)), np.float32))
    camera = axis_camera((7.5, 7.5, 7.5), 0, height=2.0)
    tables = {"camera": camera, "image": {"width": 3, "height": 3}, "gradient": EXACT}
    resolved = scene(volume, gradient_opacity={"points": points}, **tables)
    np.testing.assert_allclose(
        picture(context, resolved).rgba[..., 3], absorbed(0.5 * depth_of(0.1, 15)), atol=2e-6
    )
    points = [{"derivative": 0.0, "opacity": 0.25}, {"derivative": 1.0, "opacity": 1.0}]
    resolved = scene(volume, directional_opacity={"points": points}, **tables)
    np.testing.assert_allclose(
        picture(context, resolved).rgba[..., 3], absorbed(0.25 * depth_of(0.1, 15)), atol=2e-6
    )


@pytest.mark.parametrize("kind", KINDS)
def test_layers_of_one_function_are_that_function(context, kind):
    values, opacities = [0.0, 128.0, 255.0], [0.0, 0.1, 0.2]
    function = TransferFunction(values, opacities, [[0.2, 0.4, 0.6]] * 3)
    between = layer(7.0, [0, 64, 128, 255], [0.0, 0.05, 0.1, 0.2], [[0.2, 0.4, 0.6]] * 4)
    small = {"image": {"width": 16, "height": 12}, "integration": {"classification": kind}}
    plain = picture(context, scene(WAVES, function, **small))
    resolved = scene(WAVES, function, **small, transfer_layer=[between], gradient=EXACT)
    np.testing.assert_allclose(picture(context, resolved).rgba, plain.rgba, atol=1e-4)


@pytest.mark.parametrize("slope", [0.5, 3.0, 4.0, 6.0, 9.0])
def test_extinction_and_emission_are_linear_between_layers(context, slope):
    layers = [layer(4.0, [0.0], [0.3], [[0, 0, 1.0]]), layer(8.0, [0.0], [0.05], [[0, 1.0, 0]])]
    resolved = scene(
        ramp(slope), constant_function(0.1, (1.0, 0.0, 0.0)), transfer_layer=layers,
        camera=axis_camera((7.5, 7.5, 7.5), 0, height=2.0), image={"width": 3, "height": 2},
    )  # fmt: skip
    weights = [np.interp(slope, [0, 4, 8], np.eye(3)[k]) for k in range(3)]
    depths = np.array([w * depth_of(o, RAMP_SIZE - 1) for w, o in zip(weights, (0.1, 0.3, 0.05))])
    opacity = absorbed(depths.sum())
    red, blue, green = depths * opacity / depths.sum()
    expected = np.broadcast_to([red, green, blue, opacity], (2, 3, 4))
    np.testing.assert_allclose(picture(context, resolved).rgba, expected, atol=2e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_what_only_a_layer_shows_is_not_leapt_over(context, kind):
    array = np.zeros((40, 40, 40), np.float32)
    array[24:36, 24:36, 24:36] = waves((12, 12, 12), low=20.0)
    hidden = TransferFunction([0.0, 255.0], [0.0, 0.0], [[1.0, 1.0, 1.0]] * 2)
    shown = layer(10.0, [10.0, 200.0], [0.0, 0.4], COLORS[:2])
    tables = {"image": {"width": 16, "height": 12}, "integration": {"classification": kind}}
    resolved = scene(array, hidden, transfer_layer=[shown], gradient=EXACT, **tables)
    leaping, marching = (picture(context, resolved, skip=skip) for skip in (True, False))
    assert leaping.rgba[..., 3].max() > 0.05
    assert np.array_equal(leaping.rgba, marching.rgba)
    assert leaping.samples < marching.samples


@pytest.mark.parametrize("kind", KINDS)
def test_everything_that_the_gradient_decides_agrees_with_the_definition(context, kind):
    function = TransferFunction([0.0, 120.0, 255.0], [0.0, 0.2, 0.4], COLORS)
    magnitudes = [(2.0, 0.1), (9.0, 0.6), (9.0, 1.0), (20.0, 0.3)]
    tables = {
        "transfer_layer": [
            layer(5.0, [0.0, 70.0, 200.0], [0.0, 0.5, 0.1]), layer(12.0, [30.0, 80.0], [0.3, 0.4])
        ],
        "gradient_opacity": {"points": [{"magnitude": m, "opacity": o} for m, o in magnitudes]},
        "directional_opacity": {"points": [{"derivative": 0.0, "opacity": 0.2},
                                           {"derivative": 15.0, "opacity": 1.0}]},
        "light": [{"type": "directional", "direction": (-1.0, -0.3, -0.5)}],
        "integration": {"classification": kind},
        "image": {"width": 16, "height": 12},
        "gradient": EXACT,
    }  # fmt: skip
    grid = {"spacing": (0.5, 0.7, 0.6), "origin": (100.0, -7.0, 3.0)}
    resolved = scene(WAVES, function, grid=grid, **tables)
    seen = picture(context, resolved)
    atol = 1e-5 if kind != "preintegrated" else 3e-4  # of a table over both ends of a segment
    np.testing.assert_allclose(seen.rgba, render_twin(resolved), atol=atol)
    one, many = (picture(context, resolved, lanes=lanes) for lanes in (1, 16))
    np.testing.assert_allclose(one.rgba, many.rgba, atol=1e-6)


def test_a_factor_of_nothing_hides_all(context):
    factor = {"points": [{"magnitude": 0.0, "opacity": 0.0}]}
    seen = picture(context, scene(WAVES, gradient_opacity=factor, image={"width": 8, "height": 8}))
    assert not seen.rgba.any()


def test_a_union_shows_exactly_where_one_of_its_functions_does():
    one = TransferFunction([0.0, 10.0, 10.0, 20.0], [0.0, 0.0, 0.5, 0.0], np.zeros((4, 3)))
    other = TransferFunction([40.0, 50.0, 60.0], [0.0, 0.2, 0.0], np.ones((3, 3)))
    both = opacity_envelope([one, other])
    values = np.linspace(-5.0, 65.0, 1401)
    shows = (one.opacity(values) > 0) | (other.opacity(values) > 0)
    assert np.array_equal(both.opacity(values) > 0, shows)
    assert set(one.values) | set(other.values) == set(both.values)
    assert opacity_envelope([one]) is one
