"""Shadows: what of a light arrives, against geometry, closed forms and the plain twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.shadow_scenes import (
    BALL,
    BLOCK,
    DIFFUSE,
    DOWN,
    RAYS,
    SIDE,
    SLANTED,
    arriving,
    ball,
    inside,
    shadowed,
    share,
)
from helpers.small_scenes import axis_camera
from helpers.twin_scenes import constant_function, ramp
from reference import render_twin
from reference.shadow import turned

from clvol import Renderer, TransferFunction
from clvol.device import light_volume
from clvol.device.effect_switches import effect_switches
from clvol.device.light_volume import (
    CONE_DIRECTIONS,
    check_fits,
    cone_directions,
    light_size,
    light_volume_bytes,
)
from clvol.errors import SceneError, VolumeError
from clvol.features.gradient_storage import DeviceLimits
from clvol.integrators.raycast.caster import Raycaster
from clvol.volume import Grid

TAU = -np.log(0.9)  # of constant_function(), a world length


@pytest.fixture(autouse=True)
def not_reduced(monkeypatch):
    """Blocks of one value are not lit, so nothing of theirs would be shadowed."""
    monkeypatch.setattr("clvol.integrators.raycast.caster.reduced_for_frames", lambda resolved: resolved)


def to_exit(places, towards, upper=SIDE):
    """The way [n] from inside the box 0 .. upper to its face."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.where(towards > 0, (upper - places) / towards, -places / towards)
    return np.where(towards == 0, np.inf, ways).min(axis=1)


def picture(context, resolved, **how):
    image = resolved.image
    return Raycaster(context, resolved, **how).render(resolved.camera, image.width, image.height)


# --- closed forms ---------------------------------------------------------------------------------


@pytest.mark.parametrize("classification", ["post", "preintegrated", "pre"])
@pytest.mark.parametrize("direction", [[0, -1, 0], [0.6, 0, -0.8], [1, 2, -3]])
def test_a_block_attenuates_by_the_way_to_its_face(context, classification, direction):
    towards = -np.array(direction) / np.linalg.norm(direction)
    expected = np.exp(-TAU * to_exit(places := inside(96), towards))
    light = {"type": "directional", "direction": direction}
    integration = {"classification": classification}
    for step in (0.5, 3.0):
        of = shadowed(BLOCK, light=light, shadow={**RAYS, "step": step}, integration=integration)
        np.testing.assert_allclose(share(context, of, places), expected, atol=1e-5)


def test_light_volumes_are_exact_at_their_points(context):
    of = shadowed(BLOCK, shadow={"resolution": 7})
    points = np.stack(np.meshgrid(*[np.linspace(0, SIDE, 7)] * 3), axis=-1).reshape(-1, 3)
    expected = np.exp(-TAU * to_exit(points, np.array([0.6, 0.8, 0.0])))
    np.testing.assert_allclose(share(context, of, points), expected, atol=1e-5)


@pytest.mark.parametrize("shadow", [RAYS, {"resolution": 24}], ids=["rays", "volume"])
def test_lengths_are_the_worlds_on_any_grid(context, shadow):
    """An anisotropic, turned grid of other units: 0.9 a length of 2."""
    angle = 0.4
    cosine, sine = np.cos(angle), np.sin(angle)
    grid = {"spacing": (0.5, 1.0, 0.25), "origin": (5.0, -3.0, 100.0),
            "direction": [[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]}  # fmt: skip
    way = np.array([0.3, 0.2, -0.9])
    light = {"type": "directional", "direction": list(-way)}
    of = shadowed(BLOCK, constant_function(unit=2.0), light, shadow, grid=grid)
    along = np.array(grid["direction"]).T @ (way / np.linalg.norm(way))  # along the grid's axes
    places = inside(64, 4.0, 8.0)
    spacing = np.array(grid["spacing"])
    expected = np.exp(-0.5 * TAU * to_exit(places * spacing, along, SIDE * spacing))
    atol = 1e-5 if shadow is RAYS else 2e-3
    np.testing.assert_allclose(share(context, of, places), expected, atol=atol)


@pytest.mark.parametrize("shadow", [RAYS, {"resolution": 16}], ids=["rays", "volume"])
def test_a_point_light_in_the_volume_is_as_far_as_it_is(context, shadow):
    light = {"type": "point", "position": [7.0, 11.0, 7.0]}
    of = shadowed(BLOCK, light=light, shadow=shadow)
    places = np.array([[7, 4, 7], [7, 13, 7], [4, 7, 7], [7, 11, 7]])
    away = np.linalg.norm(places - light["position"], axis=1)
    np.testing.assert_allclose(share(context, of, places), np.exp(-TAU * away), atol=1e-5)


def test_a_slab_of_one_voxel_is_one_voxel_thick(context):
    light = {"type": "directional", "direction": [0, 0, -1]}
    of = shadowed(BLOCK[:1] + ramp(axis=2)[:1].astype(np.float32), light=light)
    # Lattice coordinates: such an axis runs from 0 to 1.
    np.testing.assert_allclose(share(context, of, [[7, 7, 0.25]]), np.exp(-TAU * 0.75), atol=1e-5)


# --- opaque things --------------------------------------------------------------------------------

OPAQUE_ABOVE_TEN = TransferFunction([0, 10, 10, 15], [0, 0, 1, 1], [[1, 1, 1]] * 4)


@pytest.mark.parametrize("shadow", [RAYS, {"resolution": 16}], ids=["rays", "volume"])
def test_an_opaque_slab_hides_light_wholly(context, shadow):
    of = shadowed(ramp(axis=1).astype(np.float32), OPAQUE_ABOVE_TEN, DOWN, shadow)
    found = share(context, of, [[7, 4, 7], [0, 0, 0], [15, 9, 15], [3, 15, 2]])
    assert found.tolist() == [0.0, 0.0, 0.0, 1.0]


def test_a_half_space_casts_its_shadow_where_geometry_says(context):
    """All above x = 10 is opaque: a ray to the light meets it, or leaves the volume before."""
    step = 0.05
    of = shadowed(ramp(axis=2).astype(np.float32), OPAQUE_ABOVE_TEN, shadow={**RAYS, "step": step})
    places = inside(4000, [0, 0, 0], [9.9, 15, 15])
    edge = SIDE - (10.0 - places[:, 0]) * 0.8 / 0.6
    clear = np.abs(places[:, 1] - edge) > 2 * step
    found = share(context, of, places)
    hidden = places[:, 1] < edge
    assert (found[clear & hidden] == 0.0).all() and (found[clear & ~hidden] == 1.0).all()
    assert clear.mean() > 0.95 and 0.2 < hidden.mean() < 0.8


@pytest.mark.parametrize("resolution", [9, 16, 33])
def test_a_light_volume_leaks_no_farther_than_a_light_cell(context, resolution):
    """One opaque voxel: light cells that its shadow does not touch are lit, exactly."""
    array = np.zeros((16, 16, 16), np.float32)
    array[8, 12, 7] = 1.0
    wall = TransferFunction([0, 0.5, 0.5, 1], [0, 0, 1, 1], [[1, 1, 1]] * 4)
    of = shadowed(array, wall, DOWN, {"resolution": resolution, "step": 0.1})
    places = inside(20000)
    found = share(context, of, places)
    cell = SIDE / (resolution - 1)
    low, high = np.floor(places / cell) * cell, np.floor(places / cell) * cell + cell
    # What is above 0.5 lies within half a voxel of the voxel's centre.
    touches = (low[:, 0] < 7.5) & (high[:, 0] > 6.5) & (low[:, 2] < 8.5) & (high[:, 2] > 7.5)
    touches &= low[:, 1] < 12.5
    assert (found[~touches] == 1.0).all()
    if resolution >= 16:  # points of the grid fall in the shadow
        assert found[touches].min() < 0.5


@pytest.mark.slow
def test_what_is_clipped_away_casts_no_shadow(context):
    below_nine = [{"point": [0, 9, 0], "normal": [0, -1, 0]}]
    of = shadowed(ramp(axis=1).astype(np.float32), OPAQUE_ABOVE_TEN, DOWN, clip=below_nine)
    assert share(context, of, [[7, 4, 7], [2, 8, 1]]).tolist() == [1.0, 1.0]
    for shadow in (RAYS, {"resolution": 16}):
        of = shadowed(BLOCK, light=DOWN, shadow=shadow, clip=below_nine)
        np.testing.assert_allclose(share(context, of, [[7, 4, 7]]), np.exp(-5 * TAU), atol=1e-5)


def test_each_kept_stretch_counts(context):
    hole = [{"type": "box", "lower": [-1, 6, -1], "upper": [16, 9, 16], "keep": "outside"}]
    of = shadowed(BLOCK, light=DOWN, clip=hole)
    places = [[7, 4, 7], [7, 10, 7], [7, 5.5, 3]]
    expected = np.exp(-TAU * np.array([8.0, 5.0, 6.5]))
    np.testing.assert_allclose(share(context, of, places), expected, atol=1e-5)


# --- light volumes and rays -----------------------------------------------------------------------

def test_light_volumes_converge_to_rays(context):
    places = inside(400, 0.0, 23.0)
    fine = {"step": 0.25}
    exact = share(context, shadowed(ball(), BALL, shadow={**RAYS, **fine}), places)
    errors = []
    for resolution in (12, 24, 48, 96):
        shadow = {"resolution": resolution, **fine}
        found = share(context, shadowed(ball(), BALL, shadow=shadow), places)
        errors.append(np.sqrt(np.mean((found - exact) ** 2)))
    assert errors[0] < 0.05 and errors[3] < 1e-3
    assert all(2 * after < before for before, after in zip(errors, errors[1:])), errors


SCENES = {
    "plain": {},
    "clipped": {"clip": [{"point": [11, 12, 9], "normal": [1, 0.3, 0.1]}]},
    "surface": {"isosurface": [{"value": 7.0, "opacity": 0.6, "color": [0.4, 1, 1]}]},
}
SHADOWS = {
    "rays": {**RAYS, "step": 0.5},
    "volume": {"resolution": 20},
    "scattering": {"resolution": 20, "scattering": 0.7, "scatter_color": [1, 0.5, 0]},
}
TWO_LIGHTS = [SLANTED, {"type": "point", "position": [20, 20, 3], "color": [0.2, 0.4, 1]}]


def twin_scene(shadow, tables, **integration):
    return shadowed(ball(), BALL, TWO_LIGHTS, SHADOWS[shadow], image={"width": 16, "height": 16},
                    integration=integration, **SCENES[tables])  # fmt: skip


@pytest.mark.parametrize("tables", SCENES)
@pytest.mark.parametrize("shadow", SHADOWS)
def test_pictures_are_the_twins(context, shadow, tables):
    of = twin_scene(shadow, tables)
    frame, expected = picture(context, of), render_twin(of)
    # A surface that is only grazed between samples is seen by the twin, which looks closer.
    assert np.abs(frame.rgba - expected).max() < (5e-3 if tables == "surface" else 1e-3)
    assert np.sqrt(np.mean((frame.rgba - expected) ** 2)) < 3e-4
    unshadowed = shadowed(ball(), BALL, TWO_LIGHTS, None, image=of.image, **SCENES[tables])
    assert np.abs(picture(context, unshadowed).rgba - expected).max() > 0.03


@pytest.mark.slow
@pytest.mark.parametrize("tables", SCENES)
@pytest.mark.parametrize("shadow", SHADOWS)
def test_packets_of_rays_and_single_rays_agree(context, shadow, tables):
    of = twin_scene(shadow, tables, classification="preintegrated")
    single, packet = (picture(context, of, lanes=lanes) for lanes in (1, 16))
    np.testing.assert_allclose(single.rgba, packet.rgba, atol=2e-6)
    assert single.counters["lit_samples"] == packet.counters["lit_samples"]
    counted = [f.counters.get("shadow_rays", 0) for f in (single, packet)]
    assert counted[0] == pytest.approx(counted[1], abs=2)  # at right angles rounding decides


@pytest.mark.parametrize("tables", SCENES)
@pytest.mark.parametrize("shadow", ["rays", "volume"])
def test_leaping_changes_no_bit_and_samples_less(context, shadow, tables):
    shadow = {**SHADOWS[shadow], "step": 0.4}
    of = shadowed(ball(64, (20.0, 30.0, 40.0)), BALL, TWO_LIGHTS, shadow,
                  image={"width": 24, "height": 24}, **SCENES[tables])  # fmt: skip
    leaps, looks = (Raycaster(context, of, skip=skip) for skip in (True, False))
    frames = [caster.render(of.camera, 24, 24) for caster in (leaps, looks)]
    assert np.array_equal(frames[0].rgba, frames[1].rgba)
    counts = [f.counters.get("shadow_samples", 0) for f in frames]
    counts = [n + c.light_volume_samples for n, c in zip(counts, (leaps, looks))]
    assert 0 < counts[0] < 0.6 * counts[1]


def test_launches_of_any_length_fill_the_same_volume(context, monkeypatch):
    of = twin_scene("scattering", "plain")
    whole = Raycaster(context, of)
    monkeypatch.setattr(light_volume, "_SECONDS_A_SAMPLE", 1e-5)
    parts = Raycaster(context, of)
    one, other = (context.read(c.effects.arrays["light_volume"]) for c in (whole, parts))
    assert np.array_equal(one, other) and one.shape == (2, 20, 20, 20, 4)
    assert whole.light_volume_samples == parts.light_volume_samples


def test_a_light_volume_outlives_the_camera_but_not_the_transfer_function(context):
    of = twin_scene("volume", "plain")
    caster = Raycaster(context, of)
    before, samples = caster.effects.arrays["light_volume"], caster.light_volume_samples
    for position in ([0, 0, -40], [60, 0, 0]):
        camera = of.camera.model_copy(update={"position": position})
        caster.render(camera, 8, 8)
        assert caster.effects.arrays["light_volume"] is before
    caster.set_transfer_function(constant_function())
    after = caster.effects.arrays["light_volume"]
    assert after is not before and samples > 0
    assert not np.array_equal(context.read(before), context.read(after))


@pytest.mark.slow
@pytest.mark.parametrize("shadow", ["rays", "volume"])
def test_shadows_move_with_the_noise_that_casts_them(context, shadow):
    noise = {"target": "coordinate", "amplitude": 4.0, "velocity": [0.5, 0.0, 0.0]}
    of = shadowed(ball(), BALL, shadow=SHADOWS[shadow], noise=[noise], animation={"time": 0.0},
                  image={"width": 8, "height": 8})  # fmt: skip
    later = _at(of, 0.6)
    first = Raycaster(context, of)
    moved, anew = first.for_scene(later), Raycaster(context, later)
    places = inside(64, 0.0, 23.0)
    before, found, expected = (arriving(c, places)[0] for c in (first, moved, anew))
    assert np.array_equal(found, expected) and np.abs(found - before).max() > 0.1
    assert np.array_equal(*(c.render(of.camera, 8, 8).rgba for c in (moved, anew)))


def test_cycling_colours_leave_the_light_volume_as_it_is(context):
    of = shadowed(ball(), BALL, shadow=SHADOWS["volume"], animation={"cycle": 0.25})
    first, later = Raycaster(context, of), _at(of, 0.6)
    moved, anew = first.for_scene(later), Raycaster(context, later)
    volumes = [c.effects.arrays["light_volume"] for c in (first, moved, anew)]
    assert volumes[1] is volumes[0]
    assert np.allclose(context.read(volumes[2]), context.read(volumes[0]), atol=1e-6)


def _at(resolved, time):
    animation = resolved.animation.model_copy(update={"time": time})
    return replace(resolved, animation=animation)


# --- surfaces -------------------------------------------------------------------------------------

CLEAR = constant_function(0.0)


@pytest.mark.slow
def test_surfaces_attenuate_by_their_opacities(context):
    surfaces = [{"value": 6.3, "opacity": 0.25}, {"value": 9.1, "opacity": 0.5}]
    array = ramp(axis=1).astype(np.float32)
    for shadow in (RAYS, {**RAYS, "step": 7.0}, {"resolution": 16}):
        of = shadowed(array, CLEAR, DOWN, shadow, isosurface=surfaces)
        found = share(context, of, [[7, 4, 7], [7, 8, 7], [7, 10, 7]])
        np.testing.assert_allclose(found, [0.375, 0.5, 1.0], atol=1e-6)


ALONG_VIEW = {"type": "directional", "direction": [0, 0, 1]}


def sphere(light, shadow, opacity=1.0):
    """An iso-surface of radius 8 seen along z."""
    camera = axis_camera((11.5, 11.5, 11.5), 2, height=20.0)
    return shadowed(ball(24, (11.5, 11.5, 11.5)), CLEAR, light, shadow, camera=camera,
                    image={"width": 48, "height": 48}, material=DIFFUSE,
                    isosurface=[{"value": 8.0, "opacity": opacity, "color": [1, 1, 1]}])  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("shadow", [RAYS, {"resolution": 24}, {"resolution": 64}],
                         ids=["rays", "24", "64"])  # fmt: skip
def test_a_surface_does_not_shadow_itself(context, shadow):
    lit, bare = (picture(context, sphere(ALONG_VIEW, s)).rgba[..., 0] for s in (shadow, None))
    assert np.abs(lit - bare).max() < 1e-3 and bare.max() > 0.95


@pytest.mark.parametrize("shadow", [RAYS, {"resolution": 24}, {"resolution": 64}],
                         ids=["rays", "24", "64"])  # fmt: skip
def test_the_back_of_a_translucent_sphere_is_in_its_fronts_shadow(context, shadow):
    lit, bare = (picture(context, sphere(ALONG_VIEW, s, 0.3)).rgba[..., 0] for s in (shadow, None))
    middle = slice(12, 36), slice(12, 36)
    np.testing.assert_allclose(lit[middle] / bare[middle], (1 + 0.7 * 0.7) / (1 + 0.7), atol=2e-3)


@pytest.mark.parametrize("shadow", [RAYS, {"resolution": 64}], ids=["rays", "volume"])
def test_a_sphere_lit_from_the_side_has_a_lit_half(context, shadow):
    light = {"type": "directional", "direction": [-1, 0, 1]}
    lit, bare = (picture(context, sphere(light, s)).rgba[..., 0] for s in (shadow, None))
    bright = bare > 0.05
    assert np.abs(lit - bare)[bright].max() < 1e-3 and bright.mean() > 0.2


# --- scattering -----------------------------------------------------------------------------------


@pytest.mark.parametrize("light", [SLANTED, {"type": "point", "position": [7.0, 40.0, 9.0]}],
                         ids=["directional", "point"])  # fmt: skip
def test_scattered_light_is_the_mean_over_a_cone(context, light):
    color, s, degrees = np.array([1.0, 0.5, 0.0]), 0.6, 40.0
    shadow = {"scattering": s, "scatter_color": list(color), "cone_degrees": degrees,
              "resolution": 16}  # fmt: skip
    of = shadowed(BLOCK, light=light, shadow=shadow)
    places = inside(64).round()
    if light["type"] == "point":
        towards = np.array(light["position"]) - places
        towards /= np.linalg.norm(towards, axis=1)[:, None]
    else:
        towards = np.broadcast_to([0.6, 0.8, 0.0], places.shape)
    cone = np.mean([
        np.exp(-TAU * to_exit(places, turned(towards, local))[:, None] * (1 - color))
        for local in cone_directions(degrees)
    ], axis=0)  # fmt: skip
    direct = np.exp(-TAU * to_exit(places, towards))[:, None]
    found, _ = arriving(Raycaster(context, of), places)
    np.testing.assert_allclose(found, (1 - s) * direct + s * cone, atol=2e-5)


def test_a_cone_of_no_width_is_a_ray(context):
    shadow = {"scattering": 1.0, "scatter_color": [0, 0, 0], "cone_degrees": 0, "resolution": 20}
    places = inside(64, 0.0, 23.0)
    ray = share(context, shadowed(ball(), BALL, shadow={"resolution": 20}), places)
    cone = share(context, shadowed(ball(), BALL, shadow=shadow), places)
    np.testing.assert_allclose(cone, ray, atol=1e-6)


def test_the_cones_directions_fill_it_evenly():
    directions = cone_directions(40.0, 4000)
    assert directions[:, 2].min() == pytest.approx(np.cos(np.radians(40)), abs=1e-3)
    expected = [0, 0, (1 + np.cos(np.radians(40))) / 2]
    assert directions.mean(axis=0) == pytest.approx(expected, abs=1e-3)
    few = cone_directions(40.0)
    assert len(few) == CONE_DIRECTIONS
    assert few.mean(axis=0) == pytest.approx(expected, abs=0.03)


# --- only what is called for ----------------------------------------------------------------------


def test_no_shadow_ray_for_what_does_not_count(context):
    caster = Raycaster(context, shadowed(BLOCK, shadow={"method": "rays", "bound": 0.01}))
    places = inside(64, 0.0, 14.0)
    found, counters = arriving(caster, places, weight=0.01)
    assert (found == 1.0).all() and counters["shadow_rays"] == counters["shadow_samples"] == 0
    weights = np.where(np.arange(64) % 2, 0.02, 0.0)
    found, counters = arriving(caster, places, weight=weights)
    assert counters["shadow_rays"] == 32 and counters["shadow_samples"] >= 32
    assert (found[::2] == 1.0).all() and (found[1::2] < 1.0).all()


def test_no_shadow_where_nothing_is_lit(context, monkeypatch):
    """What has opacity has no gradient here, and so nothing is lit."""
    monkeypatch.undo()  # reduced after all
    of = shadowed(np.zeros((16, 16, 16), np.float32), image={"width": 8, "height": 8})
    caster = Raycaster(context, of)
    assert not caster.switches.get("SHADOWS") and caster.light_volume_samples == 0
    counters = caster.render(of.camera, 8, 8).counters
    assert not counters.get("shadow_rays") and not counters.get("shadow_samples")


def test_a_bound_changes_the_picture_by_less_than_it_adds_up_to(context):
    image = {"width": 16, "height": 16}
    exact = picture(context, shadowed(ball(), BALL, image=image))
    bound = 1e-3
    of = shadowed(ball(), BALL, shadow={"method": "rays", "bound": bound}, image=image)
    fewer = picture(context, of)
    assert fewer.counters["shadow_rays"] < exact.counters["shadow_rays"]
    assert np.abs(fewer.rgba - exact.rgba).max() < 42 * bound  # segments on a ray


def test_only_faces_towards_a_light_cast_rays(context):
    """Under a one-sided material, lights straight behind all faces light none."""
    array = ramp(axis=0).astype(np.float32)
    light = {"type": "directional", "direction": [0, 0, -1]}
    material = {**DIFFUSE, "two_sided": False}
    of = shadowed(array, light=light, material=material, image={"width": 8, "height": 8})
    counters = picture(context, of).counters
    assert counters["lit_samples"] > 0 and counters["shadow_rays"] == 0


@pytest.mark.parametrize("light", [{"type": "headlight"}, {**SLANTED, "casts_shadow": False}],
                         ids=["headlight", "casts-none"])  # fmt: skip
def test_lights_without_shadows_call_for_none(context, light):
    image = {"width": 8, "height": 8}
    of, bare = (shadowed(ball(), BALL, light, s, image=image) for s in (RAYS, None))
    assert effect_switches(of) == effect_switches(bare)
    assert np.array_equal(picture(context, of).rgba, picture(context, bare).rgba)


def test_of_two_lights_only_the_casting_one_has_a_volume(context):
    lights = [{**DOWN, "casts_shadow": False}, {"type": "headlight"}, SLANTED]
    of = shadowed(BLOCK, light=lights, shadow={"resolution": 16})
    caster = Raycaster(context, of)
    assert caster.effects.arrays["light_volume"].shape == (1, 16, 16, 16, 1)
    found, _ = arriving(caster, [[3, 5, 7]], light=2)
    way = to_exit(np.array([[3, 5, 7]]), np.array([0.6, 0.8, 0.0]))
    np.testing.assert_allclose(found[:, 0], np.exp(-TAU * way), atol=1e-5)


# --- memory ---------------------------------------------------------------------------------------


def test_a_light_volume_that_does_not_fit_is_refused():
    of = shadowed(BLOCK, light=TWO_LIGHTS, shadow={"resolution": 100, "scattering": 0.5})
    needed = 2 * 16 * 100**3
    assert light_volume_bytes(of) == needed
    check_fits(of, DeviceLimits(memory=needed, buffer=needed))
    with pytest.raises(SceneError) as refused:
        check_fits(of, DeviceLimits(memory=2**40, buffer=needed - 1))
    message = str(refused.value)
    assert "shadow.resolution: got 100" in message and str(needed) in message
    assert "\n" not in message
    with pytest.raises(VolumeError, match="memory cap"):
        Renderer(of, memory_cap=needed)


def test_light_volumes_are_as_dense_along_all_axes():
    grid = Grid((5, 9, 9), (1.0, 2.0, 0.5), (3.0, 4.0, 5.0))
    assert light_size(grid, 33) == (17, 33, 5)
    assert light_size(grid, 4) == (3, 4, 2)
