"""Segments that are packed before they are classified (cl/segment_queue.h): pictures without the queue, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import make_scene, waves
from reference import render_twin

from clvol import TransferFunction
from clvol.integrators.raycast.caster import Raycaster

SIZE = (45, 38)
RNG = np.random.default_rng(4)
COLORS = np.array([[1, 0, 0], [0, 1, 0], [0.1, 0.2, 1], [0.9, 0.8, 0.1]])
MANY = np.linspace(0, 255, 64)


def function(values, opacities, unit=1.0):
    return TransferFunction(values, opacities, COLORS[np.arange(len(values)) % 4], unit)


FUNCTIONS = {
    "three peaks": ([0, 70, 76, 82, 130, 136, 142, 190, 196, 202, 255], [0, 0, 0.3, 0, 0, 0.3, 0, 0, 0.5, 0, 0]),
    "opaque at one value": ([0, 95, 100, 105, 255], [0, 0, 1, 0, 0]),
    "jump": ([0, 120, 120, 255], [0, 0, 0.4, 0.6]),
    "constant": ([0, 255], [0.05, 0.05]),
    "one point": ([100], [0.2]),
    "nearly opaque": ([0, 30, 60, 120, 255], [0, 0, 0.5, 0.8, 0.95]),
    "64 points": (MANY, np.where(np.arange(64) % 7 < 3, 0.0, 0.2 * RNG.random(64))),
    "inside the range of values": ([110, 120, 140], [0.0, 0.3, 0.0]),
}


def beside_the_queue(context, scene):
    """The picture of ``scene``, which is the same without the queue."""
    pictures = []
    for more in ({}, {"QUEUED_SEGMENTS": 0}):
        caster = Raycaster(context, scene, lanes=16)
        caster.switches |= more
        pictures.append(caster.render(scene.camera, *SIZE))
    queued, plain = pictures
    assert np.array_equal(queued.rgba, plain.rgba) and np.array_equal(queued.depth, plain.depth)
    assert queued.samples == plain.samples
    return queued


def scene_of(array, transfer, **integration):
    tables = {"classification": "preintegrated", "step": 0.7, **integration}
    return make_scene(array, transfer, width=SIZE[0], height=SIZE[1], **tables)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.every_case
def test_the_queue_changes_no_bit(context, name):
    scene = scene_of(waves((21, 19, 23), np.uint8), function(*FUNCTIONS[name]))
    queued = beside_the_queue(context, scene)
    assert queued.rgba[..., 3].max() > 0.05
    np.testing.assert_allclose(queued.rgba, render_twin(scene), atol=2e-3)


@pytest.mark.parametrize("early_termination", (0.0, 0.5))
def test_the_queue_ends_rays_where_they_would_end_without_it(context, early_termination):
    transfer = function(*FUNCTIONS["nearly opaque"])
    beside_the_queue(context, scene_of(waves((21, 19, 23), np.uint8), transfer, early_termination=early_termination))


def test_holes_in_the_volume_stay_transparent_in_the_queue(context):
    array = waves((21, 19, 23), np.float32, 0, 255)
    array[RNG.random(array.shape) < 0.02] = np.nan
    beside_the_queue(context, scene_of(array, function(*FUNCTIONS["three peaks"])))


def test_values_far_from_zero_and_huge_ones_do_not_tell_the_queue(context):
    for scale, origin in ((1e30, 0.0), (1.0, 1e6)):
        array = waves((21, 19, 23), np.float32, 0, 255) * np.float32(scale) + np.float32(origin)
        values, opacities = FUNCTIONS["three peaks"]
        transfer = function(np.array(values) * scale + origin, opacities)
        assert beside_the_queue(context, scene_of(array, transfer)).rgba[..., 3].max() > 0.3
