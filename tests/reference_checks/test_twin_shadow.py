"""The twin's shadows: attenuation towards the lights, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.twin_scenes import absorbed, along_z, constant_function, ramp, scene
from reference.medium import Medium
from reference.shadow import Shadows, cone_directions, light_grid, turned

from clvol import TransferFunction, Volume
from clvol.volume import Grid

TAU = -np.log(0.9)
COLOR = np.array([0.8, 0.5, 0.2])
DIFFUSE = {"ambient": 0.0, "diffuse": 1.0, "specular": 0.0}
DOWN = {"type": "directional", "direction": [0.0, -1.0, 0.0]}
RAYS = {"method": "rays", "bound": 0.0}


def shadows(array, function=None, **tables):
    tables.setdefault("shadow", RAYS)
    tables.setdefault("light", [DOWN])
    s = scene(array, function, **tables)
    return Shadows(s, Medium(s))


def depth(of: Shadows, at, direction, distance=np.inf):
    at = np.atleast_2d(np.asarray(at, float))
    direction = np.asarray(direction, float) / np.linalg.norm(direction)
    directions = np.broadcast_to(direction, at.shape)
    return of.optical_depth(at, directions, np.full(len(at), distance))


BLOCK = np.zeros((16, 16, 16))


@pytest.mark.parametrize("step", [0.3, 1.0, 5.0])
def test_a_block_attenuates_by_the_way_to_its_face(step):
    of = shadows(BLOCK, shadow={**RAYS, "step": step})
    assert depth(of, [[7, 4, 7], [7, 15, 7]], (0, 1, 0)) == pytest.approx([11 * TAU, 0])
    assert depth(of, (7, 7, 7), (3, 0, 4)) == pytest.approx([10 * TAU])
    assert depth(of, (7, 4, 7), (0, 1, 0), distance=2.5) == pytest.approx([2.5 * TAU])


def test_the_opaque_half_shadows_and_the_other_does_not():
    array = np.zeros((16, 16, 16))
    array[:, 10:, :8] = 1.0
    wall = TransferFunction([0, 0.5, 0.5, 1], [0, 0, 1, 1], [[1, 1, 1]] * 4)
    of = shadows(array, wall)
    found = np.exp(-depth(of, [[4, 4, 7], [12, 4, 7], [4, 12, 7]], (0, 1, 0)))
    assert found == pytest.approx([0, 1, 0])


def test_clips_masks_and_factors_act_on_the_way_to_the_light_too():
    clip = [{"point": [0, 9, 0], "normal": [0, -1, 0]}]
    assert depth(shadows(BLOCK, clip=clip), (7, 4, 7), (0, 1, 0)) == pytest.approx([5 * TAU])
    mask = [{"file": Volume(ramp(axis=1)), "role": "mask", "threshold": 9.5, "keep": "below"}]
    assert depth(shadows(BLOCK, field=mask), (7, 4, 7), (0, 1, 0)) == pytest.approx([5.5 * TAU])
    points = [{"magnitude": 0, "opacity": 1}, {"magnitude": 2, "opacity": 0.5}]
    factor = shadows(ramp(2.0), gradient_opacity={"points": points})
    assert depth(factor, (7, 4, 7), (0, 1, 0)) == pytest.approx([5.5 * TAU])
    layer = [{"magnitude": 2, "points": [{"value": 0, "opacity": 0, "color": [1, 1, 1]}]}]
    function = {"points": [{"value": 0, "opacity": 0.1, "color": [1, 1, 1]}]}
    layered = shadows(ramp(1.0), function, transfer_layer=layer)
    assert depth(layered, (7, 4, 7), (0, 1, 0)) == pytest.approx([5.5 * TAU])


def test_surfaces_count_with_their_opacities():
    surfaces = [{"value": 6.3, "opacity": 0.25}, {"value": 9.1, "opacity": 0.5}]
    of = shadows(ramp(axis=1), constant_function(0.0), isosurface=surfaces)
    found = np.exp(-depth(of, [[7, 4, 7], [7, 8, 7], [7, 10, 7]], (0, 1, 0)))
    assert found == pytest.approx([0.375, 0.5, 1.0])


@pytest.mark.parametrize("slope, arrives", [(1.0, 1.0), (-1.0, 1.0)])
def test_a_surface_does_not_shadow_itself(slope, arrives):
    array = ramp(slope) - (0 if slope > 0 else 15 * slope)
    s = scene(array, constant_function(0.0),
              isosurface=[{"value": 7.7, "opacity": 1.0, "color": [1, 1, 1]}],
              light=[{"type": "directional", "direction": [0, 0, 1]}],
              material=DIFFUSE, shadow=RAYS)  # fmt: skip
    assert along_z(s)[:3] == pytest.approx(np.full(3, arrives))


@pytest.mark.slow
@pytest.mark.parametrize("shadow, tolerance", [
    ({**RAYS, "step": 0.25}, 1e-4), ({"method": "volume", "resolution": 64}, 1e-4),
])  # fmt: skip
def test_light_along_the_view_is_attenuated_as_often(shadow, tolerance):
    """int tau exp(-tau z) exp(-tau z) dz = (1 - exp(-2 tau l)) / 2."""
    s = scene(ramp(), light=[{"type": "directional", "direction": [0, 0, 1]}],
              material=DIFFUSE, shadow=shadow)  # fmt: skip
    expected = -0.5 * np.expm1(-2 * TAU * 15) * COLOR
    assert along_z(s, step=0.125)[:3] == pytest.approx(expected, abs=tolerance)


def test_no_shadow_from_headlights_and_lights_that_cast_none():
    for light in ({"type": "headlight"}, {"type": "directional", "direction": [0, 0, 1],
                                          "casts_shadow": False}):  # fmt: skip
        s = scene(ramp(), light=[light], material=DIFFUSE, shadow=RAYS)
        assert along_z(s)[:3] == pytest.approx(absorbed(0.1, 15) * COLOR)


def test_rays_are_cast_only_where_a_sample_matters():
    keys = dict(light=[{"type": "directional", "direction": [0, 0, 1]}], material=DIFFUSE)
    pictures = [
        along_z(scene(ramp(), **keys, shadow={"method": "rays", "bound": bound}), step=1.0)[0]
        for bound in (0.0, 0.05, 1.0)
    ]
    # Sample i has 0.1 of 0.9^i; above 0.05 for the first seven.
    share = 0.1 * 0.9 ** np.arange(15)
    shadow = 0.9 ** (np.arange(15) + 0.5)
    for found, bound in zip(pictures, (0.0, 0.05, 1.0)):
        arriving = np.where(share > bound, shadow, 1.0)
        assert found == pytest.approx(0.8 * np.sum(share * arriving))


@pytest.mark.parametrize("scattering, color, cone, expected", [
    (0.0, 0.5, 30.0, [1.0, 0.0]),  # shares of T and of 1
    (0.6, 1.0, 30.0, [0.4, 0.6]),
    (0.6, 0.0, 0.0, [1.0, 0.0]),
])  # fmt: skip
def test_scattered_light_is_attenuated_less(scattering, color, cone, expected):
    of = shadows(BLOCK, shadow={
        "scattering": scattering, "scatter_color": [color] * 3, "cone_degrees": cone,
        "resolution": 16})  # fmt: skip
    at = np.array([[7.0, 4.0, 7.0]])
    found = of.transmittance(0, at, None, None, None, None, None)[0]
    assert found == pytest.approx(np.full(3, expected[0] * np.exp(-11 * TAU) + expected[1]))


def test_scattering_has_a_colour():
    of = shadows(BLOCK, shadow={
        "scattering": 1.0, "scatter_color": [1.0, 0.5, 0.0], "cone_degrees": 0.0,
        "resolution": 16})  # fmt: skip
    found = of.transmittance(0, np.array([[7.0, 4.0, 7.0]]), None, None, None, None, None)[0]
    assert found == pytest.approx(np.exp(-11 * TAU * np.array([0.0, 0.5, 1.0])))


def test_the_cone_is_filled_evenly():
    directions = cone_directions(40.0, 4000)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1)
    assert directions[:, 2].min() > np.cos(np.radians(40)) > directions[:, 2].min() - 1e-3
    mean = directions.mean(axis=0)
    assert mean == pytest.approx([0, 0, (1 + np.cos(np.radians(40))) / 2], abs=1e-3)
    axes = np.array([[0.6, 0.0, 0.8], [1, 0, 0], [0, -1, 0]])
    for local in cone_directions(40.0, 5):
        about = turned(axes, local)
        assert np.sum(about * axes, axis=1) == pytest.approx(np.full(3, local[2]))


def test_a_light_volume_spans_the_domain():
    grid = Grid((1, 9, 17), (1.0, 2.0, 0.5), (3.0, 4.0, 5.0))
    light = light_grid(grid, 33)
    assert np.allclose(light.world_corners(), grid.world_corners())
    assert max(light.shape) == 33 and min(light.shape) >= 2
