"""The twin's emission and absorption, and what cuts or scales it, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import make_scene, picture, waves
from helpers.twin_scenes import absorbed, along_z, constant_function, ramp, ray, scene
from reference import render_twin
from reference.ray import integrate_ray

from clvol import TransferFunction, Volume

BLOCK = np.zeros((16, 16, 16))
COLOR = np.array([0.8, 0.5, 0.2])
STEPS = (0.3, 1.0, 7.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "filter, classification",
    [("linear", "pre"), ("linear", "post"), ("linear", "preintegrated"), ("cubic", "post")],
)
def test_halving_the_step_converges_to_the_exact_integral(filter, classification):
    s = make_scene(waves((12, 12, 12)), width=8, height=8, filter=filter,
                   classification=classification)  # fmt: skip
    origin, direction = (a[[2, 4], [5, 3]] for a in s.camera.world_rays(8, 8))
    to_index = s.volume.grid.world_to_index()[:3]
    exact = np.array([
        integrate_ray(s.volume.data, s.transfer_function, to_index @ np.append(o, 1),
                      to_index[:, :3] @ d, filter=filter, classification=classification)[0]
        for o, d in zip(origin, direction)
    ])  # fmt: skip
    errors = [
        np.abs(render_twin(s, rays=(origin, direction), step=step) - exact).max()
        for step in (0.5, 0.25, 0.125)
    ]
    assert errors[2] < 1e-4 and errors[2] < errors[0] / 6  # second order: 16


@pytest.mark.parametrize(
    "filter, classification",
    [("linear", "preintegrated"), ("linear", "pre"), ("cubic", "preintegrated"), ("cubic", "post")],
)
def test_the_kernel_has_the_same_segments(context, filter, classification):
    s = make_scene(waves((12, 12, 12)), filter=filter, classification=classification,
                   width=16, height=16, step=0.7, table_size=1024)  # fmt: skip
    twin = render_twin(s)
    difference = np.abs(picture(context, s).rgba - twin).max()
    assert difference < (1e-4 if classification == "preintegrated" else 1e-5)
    # The test can tell segments apart.
    assert np.abs(render_twin(s, step=0.8) - twin).max() > 5 * difference


@pytest.mark.parametrize("classification", ["pre", "post", "preintegrated"])
@pytest.mark.parametrize("step", STEPS)
def test_a_block_attenuates_exponentially(step, classification):
    s = scene(BLOCK, integration={"classification": classification, "step": step})
    opacity = absorbed(0.1, 15.0)
    assert along_z(s) == pytest.approx([*opacity * COLOR, opacity], abs=1e-12)
    slanted = ray(s, (1.0, 7.0, -2.0), (3, 0, 4))
    assert slanted[3] == pytest.approx(absorbed(0.1, 15 / 0.8), abs=1e-12)


def test_world_lengths_count_not_voxels():
    s = scene(BLOCK[:1], grid={"spacing": (0.5, 0.5, 3.0)})
    assert ray(s, (2, 2, -9), (0, 0, 1))[3] == pytest.approx(absorbed(0.1, 3.0))


def test_a_ray_that_misses_and_one_from_inside():
    s = scene(BLOCK)
    assert np.all(along_z(s, x=-0.1) == 0)
    assert along_z(s, start=5.0)[3] == pytest.approx(absorbed(0.1, 10.0))


def test_nan_is_transparent_where_it_is_used():
    array = ramp()
    array[4] = np.nan
    assert along_z(scene(array), step=0.5)[3] == pytest.approx(absorbed(0.1, 13.0))


def test_rays_stop_early_and_at_opaque():
    s = scene(BLOCK, integration={"early_termination": 0.2, "step": 1.0})
    assert along_z(s)[3] == pytest.approx(absorbed(0.1, 16), abs=0.04)
    assert along_z(s)[3] == pytest.approx(1 - 0.9**15)  # 15 steps: 0.21 is left
    s = scene(BLOCK, integration={"early_termination": 0.3, "step": 1.0})
    assert along_z(s)[3] == pytest.approx(1 - 0.9**12)
    assert along_z(scene(BLOCK, constant_function(1.0)))[3] == 1.0


# --- clips


@pytest.mark.parametrize("step", STEPS)
def test_a_clip_sphere_leaves_its_chord(step):
    keys = {"type": "sphere", "center": [7, 7, 7], "radius": 5.0}
    chord = 2 * np.sqrt(25 - 0.3**2 - 0.9**2)
    inside = along_z(scene(BLOCK, clip=[keys]), step=step)
    assert inside[3] == pytest.approx(absorbed(0.1, chord), abs=1e-12)
    outside = along_z(scene(BLOCK, clip=[{**keys, "keep": "outside"}]), step=step)
    assert outside[3] == pytest.approx(absorbed(0.1, 15 - chord), abs=1e-12)
    missed = scene(BLOCK, clip=[{**keys, "keep": "outside", "radius": 0.5}])
    assert along_z(missed, step=step)[3] == pytest.approx(absorbed(0.1, 15), abs=1e-12)


def test_boxes_and_planes_cut_where_they_are():
    box = {"type": "box", "lower": [2, 2, 3.2], "upper": [9, 9, 7.7]}
    plane = {"point": [0, 0, 5.0], "normal": [0, 0, 2]}
    for clips, length in (
        ([box], 4.5), ([{**box, "keep": "outside"}], 10.5), ([plane], 10.0),
        ([box, plane], 2.7), ([{**box, "keep": "outside"}, plane], 7.3),
        ([plane, {**plane, "normal": [0, 0, -1]}], 0.0),
    ):  # fmt: skip
        assert along_z(scene(BLOCK, clip=clips), step=0.7)[3] == pytest.approx(
            absorbed(0.1, length), abs=1e-12
        )


def test_a_slanted_plane_cuts_at_the_ray():
    s = scene(BLOCK, clip=[{"point": [7, 7, 7], "normal": [1, 0, 1]}])
    assert along_z(s, x=5.0)[3] == pytest.approx(absorbed(0.1, 15 - 9.0), abs=1e-12)


def test_two_balls_taken_away_leave_three_stretches():
    balls = [{"type": "sphere", "center": [7.3, 6.1, z], "radius": 2.0, "keep": "outside"}
             for z in (4, 11)]  # fmt: skip
    assert along_z(scene(BLOCK, clip=balls))[3] == pytest.approx(absorbed(0.1, 7.0), abs=1e-12)


# --- factors and the second value


SLOPE = 2.5


@pytest.mark.parametrize("magnitude, share", [(SLOPE, 0.6), (2 * SLOPE, 0.5 * 0.6 + 0.5)])
def test_gradient_opacity_scales_the_extinction(magnitude, share):
    points = [{"magnitude": 0.0, "opacity": 1.0}, {"magnitude": magnitude, "opacity": 0.6}]
    s = scene(ramp(SLOPE), gradient_opacity={"points": points})
    assert along_z(s)[3] == pytest.approx(absorbed(0.1, 15 * share), abs=1e-9)


def test_directional_opacity_sees_the_slope_along_the_ray():
    points = [{"derivative": 0.0, "opacity": 0.0}, {"derivative": SLOPE, "opacity": 1.0}]
    s = scene(ramp(SLOPE), directional_opacity={"points": points})
    assert along_z(s)[3] == pytest.approx(absorbed(0.1, 15.0), abs=1e-9)
    slanted = ray(s, (1.0, 7.0, -2.0), (3, 0, 4))
    assert slanted[3] == pytest.approx(absorbed(0.1, 15 / 0.8 * 0.8), abs=1e-9)
    assert ray(s, (-5.0, 7.0, 7.0), (1, 0, 0))[3] == 0.0


@pytest.mark.parametrize("classification", ["pre", "post", "preintegrated"])
def test_a_function_of_value_and_gradient_is_linear_between_layers(classification):
    layer = {"magnitude": 2 * SLOPE, "points": [{"value": 0, "opacity": 0.4, "color": [0, 1, 0]}]}
    function = {"color_space": "linear",
                "points": [{"value": 0, "opacity": 0.1, "color": [1, 0, 0]}]}  # fmt: skip
    s = scene(ramp(SLOPE), function, transfer_layer=[layer],
              integration={"classification": classification})  # fmt: skip
    tau = -0.5 * np.log([0.9, 0.6])
    opacity = -np.expm1(-15 * tau.sum())
    red, green = opacity * tau / tau.sum()
    assert along_z(s) == pytest.approx([red, green, 0, opacity], abs=1e-9)


# --- fields


def field_volume(array):
    """On a grid of its own that covers z = 2 ... 11 of the block."""
    return Volume(array, spacing=(15.0, 15.0, 3.0), origin=(0.0, 0.0, 2.0))


def test_labels_recolour_and_scale_where_they_are():
    array = np.zeros((4, 2, 2), np.uint8)
    array[1], array[2] = 5, 9
    labels = [{"label": 5, "color": [0, 0, 1], "opacity": 0.5}]
    function = TransferFunction([0.0], [0.1], [[1.0, 0.0, 0.0]])
    s = scene(BLOCK, function,
              field=[{"file": field_volume(array), "role": "label", "labels": labels}])  # fmt: skip
    # The nearest of the voxels at z = 2, 5, 8, 11 is the second from 3.5 to 6.5.
    before, label, after = absorbed(0.1, 3.5), absorbed(0.1, 1.5), absorbed(0.1, 8.5)
    red = before + (1 - before) * (1 - label) * after
    expected = [red, 0, (1 - before) * label, absorbed(0.1, 13.5)]
    assert along_z(s, step=0.5) == pytest.approx(expected, abs=1e-12)


def test_densities_add_extinction_and_emission():
    points = [{"value": 0, "opacity": 0.3, "color": [0, 1, 0]}]
    s = scene(BLOCK, {"color_space": "linear",
                      "points": [{"value": 0, "opacity": 0.1, "color": [1, 0, 0]}]},
              field=[{"file": Volume(BLOCK), "role": "density", "points": points}])  # fmt: skip
    tau = -np.log([0.9, 0.7])
    opacity = -np.expm1(-15 * tau.sum())
    red, green = opacity * tau / tau.sum()
    assert along_z(s) == pytest.approx([red, green, 0, opacity], abs=1e-12)
    part = field_volume(np.zeros((4, 2, 2)))
    s = scene(BLOCK, field=[{"file": part, "role": "density", "points": points}])
    depth = 15 * tau[0] + 9 * tau[1]
    assert along_z(s, step=0.5)[3] == pytest.approx(-np.expm1(-depth), abs=1e-12)


@pytest.mark.parametrize("keep, length", [("above", 15 - 6.3), ("below", 6.3)])
def test_a_mask_cuts_inside_a_segment(keep, length):
    mask = {"file": Volume(ramp(0.1)), "role": "mask", "threshold": 0.63, "keep": keep}
    assert along_z(scene(BLOCK, field=[mask]))[3] == pytest.approx(absorbed(0.1, length), abs=1e-9)


def test_a_mask_removes_what_lies_beside_its_grid():
    mask = {"file": field_volume(np.ones((4, 2, 2))), "role": "mask"}
    assert along_z(scene(BLOCK, field=[mask]), step=0.5)[3] == pytest.approx(absorbed(0.1, 9))


# --- depth cue, noise, cycling


def test_depth_cueing_by_the_distance_from_the_eye():
    wall = TransferFunction([0.0], [1.0], [[1.0, 0.5, 0.0]])
    cue = {"start": 5.0, "end": 15.0, "strength": 0.8, "color": [0.0, 0.0, 1.0]}
    s = scene(BLOCK, wall, depth_cue=cue)
    share = 0.8 * (9.5 - 5) / 10  # the first segment's middle, 9 + 0.5 from the eye
    expected = (1 - share) * np.array([1, 0.5, 0, 1]) + share * np.array([0, 0, 1, 1])
    assert along_z(s, start=-9.0, step=1.0) == pytest.approx(expected)
    assert along_z(s, start=-1.0) == pytest.approx([1, 0.5, 0, 1])
    assert along_z(s, start=-90.0) == pytest.approx([0.2, 0.1, 0.8, 1])


def constant_tile(*levels):
    return np.broadcast_to(np.array(levels, np.uint8), (32, 32, 32, 4))


def test_noise_of_one_level_adds_it_in_every_octave():
    function = TransferFunction([0.0, 20.0], [0.0, 0.8], [[1.0, 1.0, 1.0]] * 2)
    noise = [{"target": "value", "amplitude": 8.0, "octaves": 3, "gain": 0.5}]
    found = along_z(scene(BLOCK, function, noise=noise), noise_tile=constant_tile(0, 0, 0, 191))
    level = 191 / 127.5 - 1
    assert found[3] == pytest.approx(absorbed(0.8 * 8 * 1.75 * level / 20, 15), abs=1e-12)


def test_noise_of_one_level_moves_all_places_along_the_volumes_axes():
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x to -y, y to x
    wall = TransferFunction([0, 7.25, 7.25, 99], [0, 0, 1, 1], [[1, 1, 1]] * 4)
    noise = [{"target": "coordinate", "amplitude": 2.0}]
    tile = constant_tile(255, 0, 128, 0)
    array = ramp(axis=2)  # along the volume's x axis, which is -y in the world
    s = scene(array, wall, grid={"direction": turned}, noise=noise, depth_cue={
        "start": 0, "end": 100, "color": [0.0, 0.0, 0.0]})  # fmt: skip
    found = ray(s, (8.2, 1.0, 7.1), (0, -1, 0), step=0.01, noise_tile=tile)
    assert found[0] == pytest.approx(1 - (7.25 - 2.0 + 1.0) / 100, abs=1e-4)


def test_octaves_double_the_frequency():
    from reference.noise import fractal_noise, tile_noise

    tile = np.random.default_rng(3).integers(0, 256, (32, 32, 32, 4)).astype(np.uint8)
    volume = Volume(np.zeros((5, 9, 17)), spacing=(0.5, 0.5, 1.0), origin=(1.0, 2.0, 3.0))
    keys = {"target": "value", "amplitude": 1.0, "frequency": 3.0, "octaves": 2, "gain": 0.7,
            "velocity": [0.1, 0.2, 0.3]}  # fmt: skip
    (noise,) = scene(volume, noise=[keys]).noise
    at = np.array([[2.3, 3.1, 5.7]])
    p, moved = 3.0 * np.array([[1.3, 1.1, 2.7]]) / 8.0, np.array([0.2, 0.4, 0.6])
    expected = tile_noise(tile, p + moved) + 0.7 * tile_noise(tile, 2 * p + moved)
    assert np.allclose(fractal_noise(noise, tile, volume.grid, at, 2.0), expected)


def test_noise_repeats_and_moves_with_time():
    from reference.noise import tile_noise

    tile = np.random.default_rng(3).integers(0, 256, (32, 32, 32, 4)).astype(np.uint8)
    p = np.random.default_rng(4).uniform(-2, 2, (20, 3))
    assert np.allclose(tile_noise(tile, p), tile_noise(tile, p + [1, -2, 3]))
    at = np.array([[3 / 32, 5 / 32, 7 / 32]])
    assert np.allclose(tile_noise(tile, at), tile[7, 5, 3] / 127.5 - 1)
    noise = {"target": "value", "amplitude": 30.0, "frequency": 0.5, "velocity": [0, 0, 0.25]}
    keys = {"function": TransferFunction([-30, 30], [0, 0.5], [[1, 1, 1]] * 2)}
    still = scene(np.zeros((4, 4, 4)), **keys, noise=[{**noise, "velocity": [0, 0, 0]}])
    moved = scene(np.zeros((4, 4, 4)), **keys, noise=[noise], animation={"time": 2.0})
    again = scene(np.zeros((4, 4, 4)), **keys, noise=[noise], animation={"time": 4.0})
    pictures = [along_z(s, 1.5, 1.5, noise_tile=tile) for s in (still, moved, again)]
    assert np.allclose(pictures[0], pictures[2]) and not np.allclose(pictures[0], pictures[1])


@pytest.mark.parametrize("classification", ["post", "preintegrated"])
def test_cycling_moves_the_colours_alone(classification):
    function = TransferFunction([0, 7.5, 15], [0.1, 0.4, 0.1], [[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    keys = {"integration": {"classification": classification, "step": 0.5}}
    plain = along_z(scene(ramp(), function, **keys))
    moved = along_z(scene(ramp(), function, **keys, animation={"time": 2.0, "cycle": 0.2}))
    assert moved[3] == plain[3]
    assert moved[1] != pytest.approx(plain[1], abs=0.05)
    whole = along_z(scene(ramp(), function, **keys, animation={"time": 2.0, "cycle": 0.5}))
    assert whole == pytest.approx(plain, abs=1e-12)
