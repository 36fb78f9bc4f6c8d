"""Where voxels are constant, their value is met exactly: a step of the transfer function may lie right there."""

from __future__ import annotations

import numpy as np
import pytest
from reference import render_twin
from reference.field import Field, GridSampler
from reference.multiresolution import BlockField
from small_scenes import axis_camera, exact, make_scene, picture

from clvol import TransferFunction
from clvol.device.prefilter import coefficients
from clvol.store.volume_blocks import VolumeBlocks
from clvol.volume import Volume

FILTERS = ("nearest", "linear", "cubic", "catmull-rom")
VALUES = np.random.default_rng(11).uniform(-300, 300, 12)


def scene_with_a_step(dtype, value, side, filter, camera=None):
    """Voxels of one value and others beyond x = 9; a step right at the value, opaque on one ``side`` of it."""
    array = np.full((8, 7, 14), value, dtype)
    array[:, :, 10:], array[:, :, 13] = value + 37, value - 11
    low, high = (0.0, 0.5) if side else (0.5, 0.0)
    function = TransferFunction(
        [value - 100.0, value, value, value + 100.0], [low, low, high, high], np.eye(3)[[0, 0, 1, 1]], 4.0
    )
    camera = camera or axis_camera((3.3, 3.0, 3.5), axis=1, height=3.0)  # sees the constant part alone
    return make_scene(array, function, camera=camera, width=5, height=4, filter=filter,
                      classification="post", step=0.37)  # fmt: skip


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("dtype", ("uint8", "int16", "float32", "float64"))
def test_ray_caster_exact_integral_and_twin_take_the_same_side_of_a_step(device, context, dtype, filter):
    """At the step the later point holds: 0.5 in four lengths, over six of them, or nothing."""
    rng = np.random.default_rng(5)
    for _ in range(3):
        value = np.dtype(dtype).type(rng.uniform(60, 200))
        for side in (0, 1):
            scene = scene_with_a_step(dtype, float(value), side, filter)
            expected = 1 - 0.5 ** (6 / 4) if side else 0.0
            pictures = [picture(context, scene).rgba, render_twin(scene)]
            if filter != "catmull-rom":
                pictures.append(exact(device, scene))
            for rgba in pictures:
                np.testing.assert_allclose(rgba[..., 3], expected, atol=2e-6)


@pytest.mark.parametrize("filter", FILTERS)
def test_the_twin_meets_a_constant_to_the_last_bit(filter):
    world = np.random.default_rng(1).uniform(0, 6, (200, 3))
    for value in VALUES:
        volume = Volume(np.full((7, 7, 7), value))
        assert np.all(GridSampler(volume.data, volume.grid, filter)(world) == value)
        assert np.all(Field(volume, filter).gradient(world) == 0)


def test_voxels_without_weight_do_not_count_in_the_twin():
    data = np.full((4, 4, 4), 7.1)
    data[:, :, 2:] = np.nan
    sampler = GridSampler(data, Volume(data).grid, "linear")
    assert sampler(np.array([[1.0, 1.3, 2.2]])) == 7.1
    assert np.isnan(sampler(np.array([[1.1, 1.3, 2.2]])))


@pytest.mark.parametrize("dtype", (np.uint8, np.float32, np.float64))
def test_coefficients_of_a_constant_are_the_constant(dtype):
    for value in VALUES:
        data = np.full((5, 9, 12), abs(value), dtype)
        assert np.all(coefficients(Volume(data)) == data)


def test_blocks_meet_a_constant_to_the_last_bit():
    for value in VALUES:
        volume = Volume(np.full((20, 21, 37), value))
        source = VolumeBlocks(volume)
        levels = np.arange(source.blocks.count) % source.blocks.levels
        field = BlockField.of(source, levels.astype(np.uint8))
        places = np.random.default_rng(2).uniform(0, (36, 20, 19), (300, 3))
        for interblock in (True, False):
            assert np.all(field(places, interblock) == value)
