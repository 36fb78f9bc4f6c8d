"""The twin's iso-surfaces: hits, normals, order, bends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.twin_scenes import absorbed, along_z, constant_function, ramp, ray, scene
from reference.classify import MovedFunction, of_chord
from reference.surfaces import bent, crossings

from clvol import TransferFunction
from clvol.scene.clip import Clip

CLEAR = constant_function(0.0)
CENTRE, RADIUS = np.array([7.2, 7.6, 7.4]), 5.3
LINEAR = {"opacity_unit": 1.0, "color_space": "linear"}
BLACK_TO_WHITE = {"start": 0.0, "end": 100.0, "color": [1.0, 1.0, 1.0]}


def paraboloid():
    """Squared distances to the centre: Catmull-Rom reconstructs them exactly, and their slope."""
    z, y, x = np.meshgrid(*(np.arange(16.0),) * 3, indexing="ij")
    return sum((c - m) ** 2 for c, m in zip((x, y, z), CENTRE))


def clear_function(opacity=0.0, color=(1.0, 1.0, 1.0)):
    return {**LINEAR, "points": [{"value": 0.0, "opacity": opacity, "color": list(color)}]}


def sphere_scene(**tables):
    surface = {"value": RADIUS**2, "color": [0.0, 0.0, 0.0], **tables.pop("surface", {})}
    return scene(paraboloid(), clear_function(), isosurface=[surface],
                 integration={"filter": "catmull-rom"}, **tables)  # fmt: skip


@pytest.mark.parametrize("step", [0.4, 1.0, 6.0])
def test_a_sphere_is_hit_where_it_is(step):
    """The distance is told by the depth cue, from black at the eye to white at 100."""
    s = sphere_scene(depth_cue=BLACK_TO_WHITE)
    for offset, direction in (((0.0, 0.0), (0, 0, 1)), ((2.0, -3.0), (0, 0, 1)),
                              ((0.5, 1.0), (0.3, -0.2, 1))):  # fmt: skip
        origin = np.array([CENTRE[0] + offset[0], CENTRE[1] + offset[1], -4.0])
        d = np.array(direction) / np.linalg.norm(direction)
        b = (origin - CENTRE) @ d
        distance = -b - np.sqrt(b**2 - np.sum((origin - CENTRE) ** 2) + RADIUS**2)
        found = ray(s, origin, d, step=step)
        assert found == pytest.approx([*np.full(3, distance / 100), 1.0], abs=1e-10)
    assert ray(s, (CENTRE[0] + 5.31, CENTRE[1], -4), (0, 0, 1), step=step)[3] == 0


def test_a_spheres_normals_are_radial():
    light = np.array([0.48, -0.6, -0.64])
    s = sphere_scene(
        surface={"color": [1.0, 1.0, 1.0]},
        material={"ambient": 0, "diffuse": 1, "specular": 0},
        light=[{"type": "directional", "direction": list(-light)}],
    )
    for x, y in ((0.0, 0.0), (2.0, -3.0), (-1.0, 4.0)):
        normal = np.array([x, y, -np.sqrt(RADIUS**2 - x**2 - y**2)]) / RADIUS
        found = along_z(s, CENTRE[0] + x, CENTRE[1] + y)[0]
        assert found == pytest.approx(max(normal @ light, 0.0), abs=1e-9)


def test_front_and_back_have_their_colours_and_their_order():
    surface = {"value": RADIUS**2, "opacity": 0.6, "color": [1, 0, 0], "back_color": [0, 1, 0]}
    s = sphere_scene(surface=surface)
    # Values fall towards the centre: first the back, then the front.
    assert along_z(s, CENTRE[0], CENTRE[1]) == pytest.approx([0.24, 0.6, 0.0, 0.84])


@pytest.mark.parametrize("step", [0.7, 1.0, 20.0])
@pytest.mark.parametrize("classification", ["post", "preintegrated"])
def test_the_volume_before_and_behind_a_surface(step, classification):
    surfaces = [{"value": 10.4, "opacity": 0.5, "color": [1, 0, 0]},
                {"value": 4.25, "opacity": 0.2, "color": [0, 1, 0]}]  # fmt: skip
    s = scene(ramp(), clear_function(0.1, (0.0, 0.0, 1.0)), isosurface=surfaces,
              integration={"classification": classification})  # fmt: skip
    to_first, between, beyond = (1 - absorbed(0.1, length) for length in (4.25, 6.15, 4.6))
    left = to_first * 0.8
    green, red = 0.2 * to_first, 0.5 * left * between
    blue = (1 - to_first) + left * (1 - between) + left * between * 0.5 * (1 - beyond)
    assert along_z(s, step=step) == pytest.approx([red, green, blue, red + green + blue])


def test_a_surface_leaves_the_segments_as_they_are():
    """Values z^2 in steps of 3, an invisible surface at 7.5: the volume by its whole chords."""
    function = TransferFunction([0, 100, 225], [0.0, 0.05, 0.01], [[1, 1, 1]] * 3)
    integration = {"filter": "catmull-rom", "classification": "preintegrated"}
    surface = {"value": 7.5**2, "opacity": 0.0}
    s = scene(ramp() ** 2, function, isosurface=[surface], integration=integration)
    shift = -(3.0**2) * 2 / 12  # -s'' h^2 / 12
    chords = [(0, 9, 0), (9, 36, shift), (36, 81, shift), (81, 144, shift)]
    depth = 0.0
    for front, back, by in chords:
        length = np.array([np.sqrt(back) - np.sqrt(front)])
        ends = np.array([[front + by], [back + by]])
        depth += of_chord(MovedFunction(function), *ends, length)[1][0]
    clip = {"point": [0, 0, 12], "normal": [0, 0, -1]}  # Catmull-Rom is exact away from the faces
    found = along_z(replace(s, clips=(Clip(**clip),)), step=3.0)
    assert -np.log1p(-found[3]) == pytest.approx(depth, rel=1e-9)


def test_every_crossing_in_a_segment_is_found():
    wave = np.array([1.0, 0.0] * 8).reshape(16, 1, 1)
    s = scene(np.broadcast_to(wave, (16, 2, 2)).copy(), clear_function(),
              isosurface=[{"value": 0.3, "opacity": 0.1, "color": [1, 1, 1]}])  # fmt: skip
    assert along_z(s, 0.5, 0.5, step=15.0)[3] == pytest.approx(1 - 0.9**15)


def test_crossings_are_in_order_and_say_which_way():
    def bump(at):
        return 4.0 - (at[:, 2] - 5.0) ** 2

    origin, direction = np.zeros((2, 3)), np.array([[0, 0, 1.0], [1, 0, 0]])
    met = crossings(bump, origin, direction, np.zeros(2), np.full(2, 10.0), [0.0, 3.0])
    assert met.t[0] == pytest.approx([3, 4, 6, 7], abs=1e-12) and np.all(np.isinf(met.t[1]))
    assert met.surface[0].tolist() == [0, 1, 1, 0]
    assert met.rising[0].tolist() == [True, True, False, False]


def test_snell():
    angle, index = np.radians(35.0), 1.5
    d = np.array([[np.sin(angle), 0, np.cos(angle)]])
    up = np.array([[0.0, 0.0, 3.0]])
    into, reflected = bent(d, up, np.array([index]), np.array([True]))
    assert into[0, 0] == pytest.approx(np.sin(angle) / index) and not reflected[0]
    out, _ = bent(into, -up, np.array([index]), np.array([False]))
    assert np.allclose(out, d)
    steep, reflected = bent(d, up, np.array([index * 1.4]), np.array([False]))
    assert reflected[0] and np.allclose(steep, d * [1, 1, -1])
    assert np.linalg.norm(into) == pytest.approx(1.0)
    straight, _ = bent(d, 0 * up, np.array([index]), np.array([True]))
    assert np.allclose(straight, d)


@pytest.mark.parametrize("step", [0.3, 1.0, 4.0])
def test_a_slab_bends_a_ray(step):
    """What the bent path absorbs: 5.5 before the surface, 9.5 behind it, each over its cosine."""
    s = scene(ramp(), clear_function(0.1),
              isosurface=[{"value": 5.5, "opacity": 0.0, "refraction": 1.4}])  # fmt: skip
    sine = 0.6
    path = 5.5 / 0.8 + 9.5 / np.sqrt(1 - (sine / 1.4) ** 2)
    found = ray(s, (2.0, 7.0, -0.8), (3, 0, 4), step=step)
    assert found[3] == pytest.approx(absorbed(0.1, path), abs=1e-9)


@pytest.mark.parametrize("step", [0.3, 4.0])
def test_total_reflection(step):
    """From above the surface, at an angle beyond the critical one: down to it and back up."""
    s = scene(ramp(), clear_function(0.1),
              isosurface=[{"value": 9.5, "opacity": 0.0, "refraction": 1.4}])  # fmt: skip
    found = ray(s, (1.0, 7.0, 15.0), (5, 0, -4.5), step=step)
    assert found[3] == pytest.approx(absorbed(0.1, 2 * 5.5 * np.hypot(5, 4.5) / 4.5), abs=1e-9)
    found = ray(s, (1.0, 7.0, 15.0), (3, 0, -4), step=step)
    out = np.sqrt(1 - (1.4 * 0.6) ** 2)
    path = 5.5 / 0.8 + min(9.5 / out, (14 - 5.5 * 0.75) / (1.4 * 0.6))
    assert found[3] == pytest.approx(absorbed(0.1, path), abs=1e-9)


def test_a_sphere_of_glass_turns_a_ray_twice():
    """A ball deviates it by 2 (a - b), sin a = n sin b."""
    index, height = 1 / 1.3, 3.0  # values fall inwards: what lies below is denser
    cosines = [np.sqrt(1 - (height / RADIUS / n) ** 2) for n in (1.0, 1.3)]
    a, b = np.arccos(cosines)
    s = sphere_scene(surface={"opacity": 0.0, "refraction": index},
                     depth_cue=BLACK_TO_WHITE)  # fmt: skip
    from reference.march import _March

    march, seen = _March(s, None, None, None, None), []
    restart = march._restart
    march._restart = lambda rays, *how: (restart(rays, *how), seen.append(rays.direction.copy()))
    march.render(np.array([[CENTRE[0] + height, CENTRE[1], -4.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert len(seen) == 2
    assert seen[0][0] == pytest.approx([-np.sin(a - b), 0, np.cos(a - b)], abs=1e-9)
    assert seen[1][0] == pytest.approx([-np.sin(2 * (a - b)), 0, np.cos(2 * (a - b))], abs=1e-9)


def test_masks_and_clips_remove_surfaces():
    from clvol import Volume

    surface = [{"value": 5.5, "opacity": 1.0}]
    mask = [{"file": Volume(ramp()), "role": "mask", "threshold": 8.0}]
    clip = [{"point": [0, 0, 8], "normal": [0, 0, 1]}]
    assert along_z(scene(ramp(), clear_function(), isosurface=surface))[3] == 1.0
    assert along_z(scene(ramp(), clear_function(), isosurface=surface, field=mask))[3] == 0.0
    assert along_z(scene(ramp(), clear_function(), isosurface=surface, clip=clip))[3] == 0.0
