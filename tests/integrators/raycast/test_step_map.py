"""Steps that follow the data: fewer samples within the stated error, and the same whatever is leapt over."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import exact, make_scene, rms, waves

from clvol import TransferFunction, Volume
from clvol.device.volume import DeviceVolume
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.step_map import CELL_SHIFT, cell_bounds, follows_data, step_map

SHAPE = (48, 40, 56)
GENTLE = TransferFunction(
    [0.0, 60.0, 140.0, 255.0],
    [0.0, 0.01, 0.03, 0.06],
    [[0.1, 0.2, 0.8], [0.2, 0.9, 0.4], [0.9, 0.6, 0.2], [1.0, 0.9, 0.9]],
)
CLASSIFICATIONS = ("preintegrated", "post")


def smooth_scene(array=None, function=GENTLE, step_error=1e-3, **more):
    array = waves(SHAPE) if array is None else array
    return make_scene(array, function, step_error=step_error, **more)


def frame(context, scene, **how):
    return Raycaster(context, scene, **how).render(scene.camera, scene.image.width, scene.image.height)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_fewer_samples_at_about_the_same_error(context, device, classification):
    scene = smooth_scene(classification=classification)
    even = smooth_scene(classification=classification, step_error=0.0)
    assert follows_data(scene) and not follows_data(even)
    found, plain, truth = frame(context, scene), frame(context, even), exact(device, even)
    assert found.samples < 0.8 * plain.samples
    assert rms(found.rgba, truth) < rms(plain.rgba, truth) + 3e-4


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_errors_are_what_the_bound_allows(context, device, classification):
    """Against the exact integral: by no more than the bound per edge, over all edges of a ray."""
    truth = exact(device, smooth_scene(classification=classification))
    longest = np.hypot(np.hypot(*SHAPE[:2]), SHAPE[2])
    plain = np.abs(frame(context, smooth_scene(classification=classification, step_error=0.0)).rgba - truth).max()
    samples = []
    for step_error in (1e-5, 1e-4, 1e-3, 1e-2):
        found = frame(context, smooth_scene(classification=classification, step_error=step_error))
        assert np.abs(found.rgba - truth).max() < plain + step_error * longest
        samples.append(found.samples)
    assert samples == sorted(samples, reverse=True) and samples[-1] < samples[0]


def test_pictures_converge_with_the_step(context, device):
    truth = exact(device, smooth_scene())
    errors = [rms(frame(context, smooth_scene(step=step)).rgba, truth) for step in (1.0, 0.5, 0.25)]
    assert errors[1] < 0.4 * errors[0] and errors[2] < 0.4 * errors[1]


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_packets_tiles_and_depth_change_nothing(context, classification):
    scene = smooth_scene(classification=classification, width=37, height=29)
    whole = frame(context, scene)
    for how in ({"lanes": 1}, {"tile": (8, 8)}):
        other = frame(context, scene, **how)
        assert np.abs(other.rgba - whole.rgba).max() < 2e-6 and other.samples == whole.samples
    size = scene.image.width, scene.image.height
    assert np.array_equal(Raycaster(context, scene).render(scene.camera, *size, depth=False).rgba, whole.rgba)


def test_leaps_over_empty_space_change_little(context):
    """What is leapt over is transparent; the segments around it begin at other samples."""
    array = waves(SHAPE)
    function = TransferFunction([0.0, 150.0, 255.0], [0.0, 0.0, 0.05], [[1.0, 0.5, 0.2]] * 3)
    scene = smooth_scene(array, function)
    leaping, all_of_it = frame(context, scene), frame(context, scene, skip=False)
    assert leaping.samples < all_of_it.samples
    assert np.abs(leaping.rgba - all_of_it.rgba).max() < 1e-3


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_depth_is_that_of_even_steps(context, classification):
    function = TransferFunction([0.0, 255.0], [0.06, 0.09], [[1.0, 0.5, 0.2]] * 2)
    scenes = [smooth_scene(function=function, classification=classification, step_error=e) for e in (1e-3, 0.0)]
    found, plain = (frame(context, scene) for scene in scenes)
    assert found.samples < plain.samples
    both = np.isfinite(found.depth) & np.isfinite(plain.depth)
    assert both.mean() > 0.2 and (np.isfinite(found.depth) == np.isfinite(plain.depth)).mean() > 0.98
    assert np.abs(found.depth[both] - plain.depth[both]).max() < 0.1


def test_noise_keeps_steps_even():
    array = np.random.default_rng(5).integers(0, 255, SHAPE).astype(np.uint8)
    assert not follows_data(smooth_scene(array))


@pytest.mark.parametrize(
    "change",
    [
        {"filter": "cubic"}, {"filter": "nearest"}, {"quadrature": "cells"}, {"classification": "pre"},
        {"compositing": "maximum"}, {"step_error": 0.0},
    ],
    ids=str,
)  # fmt: skip
def test_scenes_that_keep_even_steps(change):
    assert not follows_data(smooth_scene(**change))


def test_holes_and_wide_types_keep_even_steps():
    array = waves(SHAPE)
    array[3, 4, 5] = np.nan
    assert not follows_data(smooth_scene(array))
    assert not follows_data(smooth_scene(waves(SHAPE, np.float64)))
    assert not follows_data(smooth_scene(waves(SHAPE) * 1e-20))


def test_a_function_that_shows_nothing_keeps_even_steps():
    nothing = TransferFunction([0.0, 255.0], [0.0, 0.0], [[1.0, 1.0, 1.0]] * 2)
    assert not follows_data(smooth_scene(function=nothing))


@pytest.mark.parametrize("dtype", (np.uint8, np.int16, np.float32))
@pytest.mark.parametrize("shape", ((9, 10, 37), (1, 5, 6), (17, 4, 16)))
def test_bounds_of_cells_are_those_of_their_voxels(context, dtype, shape):
    array = np.random.default_rng(2).integers(0, 90, shape).astype(dtype)
    volume = DeviceVolume(context, Volume(array))
    padded = array.astype(np.float64)
    for axis, n in enumerate(shape):
        padded = np.repeat(padded, 2, axis=axis) if n == 1 else padded
    found = cell_bounds(context, volume)
    v = np.pad(padded, 1, mode="edge")
    centre, n = np.s_[1:-1], 1 << CELL_SHIFT

    def moved(z, y, x):
        return v[tuple(np.s_[1 + s : v.shape[a] - 1 + s] for a, s in enumerate((z, y, x)))]

    c = v[centre, centre, centre]
    axes = np.eye(3, dtype=int)
    second = np.max([np.abs(moved(*s) - 2 * c + moved(*-s)) for s in axes], axis=0)
    pairs = zip(axes, axes[[1, 2, 0]])
    mixed = np.max([np.abs(moved(*(s + t)) - moved(*s) - moved(*t) + c) for s, t in pairs], axis=0)
    slope = np.max([np.abs(moved(*s) - c) for s in axes], axis=0)
    for at in np.ndindex(*found.shape[:3]):
        own = tuple(slice(n * k, n * k + n) for k in at)
        assert found[at][0] == pytest.approx((second[own].max() + 2 * mixed[own].max()), rel=0.5)
        assert found[at][0] >= (second + 2 * mixed)[own].max() * (1 - 1e-6)
        assert found[at][1] == pytest.approx(slope[own].max())
        whole = padded[tuple(slice(n * k, n * k + n + 1) for k in at)]
        assert found[at][2] <= whole.min() and found[at][3] >= whole.max()


def test_a_segment_stays_where_its_steps_are_allowed(context):
    """A sharp edge in a smooth volume: no long segment begins within its reach."""
    array = waves(SHAPE, low=100.0, high=101.0)
    array[20:24, 16:20, 28:32] = 250.0
    scene = smooth_scene(array)
    caster = Raycaster(context, scene)
    steps = step_map(context, scene, caster.volume, scene.transfer_function, caster.nodes.values)
    edge = np.array([20, 16, 28]) // 4
    for at in np.ndindex(*steps.shape):
        away = np.abs(np.array(at) - edge).max()
        if steps[at] > 1:
            assert 4 * away >= steps[at]
    assert steps.max() == 8 and steps[tuple(edge)] == 1
