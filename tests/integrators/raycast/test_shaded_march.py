"""Scenes whose effects change colours alone (cl/march_shaded.h): the pictures of cl/march_effects.h, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import waves

from clvol import Scene, TransferFunction, Volume
from clvol.integrators.raycast.caster import Raycaster

SIZE = (45, 38)
SHAPE = (34, 30, 41)
SUN = {"type": "directional", "direction": [1.0, -2.0, 1.5], "color": [1.0, 0.7, 0.4]}
HEAD = {"type": "headlight", "intensity": 0.6}
COLORS = [[0.1, 0.2, 0.8], [0.2, 0.9, 0.4], [0.9, 0.6, 0.2], [1.0, 0.9, 0.9]]
HAZE = TransferFunction([0, 60, 140, 255], [0.004, 0.02, 0.03, 0.3], COLORS)
PEAKS = TransferFunction([0, 70, 80, 90, 180, 190, 200, 255], [0, 0, 0.4, 0, 0, 0.7, 0, 0], COLORS * 2)
WITHOUT = {"HOLD_SEGMENTS": 0, "CONSTANT_CELLS": 0}


def island(dtype=np.uint8):
    """Waves in the middle of a field of one value."""
    array = np.full(SHAPE, 40, dtype)
    array[11:19, 10:22, 12:20] = waves((8, 12, 8), dtype)
    return array


def caster_of(context, array, function, integration, **tables):
    """A caster of the scene, as it is marched on this device."""
    scene = Scene(
        volume=array if isinstance(array, Volume) else Volume(array),
        transfer_function=function,
        image={"width": SIZE[0], "height": SIZE[1]},
        integration={"classification": "post", "early_termination": 0.0, **integration},
        **{"light": [SUN, HEAD], **tables},
    )
    return Raycaster(context, scene.resolve(), lanes=16)


def pictures(context, caster):
    """Frames by the march of the scene, and by that of all effects."""
    found = []
    for more in ({}, WITHOUT):
        caster.switches |= more
        found.append(caster.render(caster.resolved.camera, *SIZE))
    return found


def same(held, plain):
    assert np.array_equal(held.rgba, plain.rgba) and np.array_equal(held.depth, plain.depth)
    assert held.samples == plain.samples
    assert held.counters["lit_samples"] == plain.counters["lit_samples"] > 0
    assert held.counters["gradients"] <= plain.counters["gradients"]


CASES = {
    "a field of one value around": (island(), HAZE, {}, {}),
    "the same, pre-integrated": (island(), HAZE, {"classification": "preintegrated"}, {}),
    "peaks, anisotropic, precomputed gradients": (
        Volume(waves((21, 19, 23), np.uint8), spacing=(0.5, 1.0, 2.0)), PEAKS,
        {"classification": "preintegrated", "step": 0.6}, {"gradient": {"storage": "precomputed"}},
    ),
    "16 bits, clips, a cue": (
        waves((21, 19, 23), np.int16), HAZE, {},
        {"clip": [{"type": "plane", "point": [9.0, 9.0, 9.0], "normal": [1.0, 0.3, 0.2]},
                  {"type": "sphere", "center": [12.0, 9.0, 8.0], "radius": 3.0, "keep": "outside"}],
         "depth_cue": {"strength": 0.5}, "light": [SUN]},
    ),
    "a point light among others, highlights of two sizes": (
        waves((21, 19, 23), np.uint8), HAZE, {},
        {"light": [{"type": "point", "position": [30.0, -8.0, 4.0], "color": [0.2, 0.9, 1.0]}, SUN, HEAD],
         "material": {"shininess": 90.0, "specular": 0.6}},
    ),
    "two voxels thick, along the axes": (
        waves((21, 2, 23), np.uint8), HAZE, {},
        {"camera": {"projection": "orthographic", "height": 24.0, "position": [11.0, 0.5, -40.0],
                    "target": [11.0, 0.5, 10.0], "up": [0.0, 1.0, 0.0]}},
    ),
    "nearest, without light on one side, fading": (
        waves((21, 19, 23), np.uint8), HAZE, {"filter": "nearest"}, {"material": {"two_sided": False, "fade": 20.0}},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_it_changes_no_bit(context, name):
    array, function, integration, tables = CASES[name]
    caster = caster_of(context, array, function, integration, **tables)
    assert caster.switches["SEGMENT_OPACITIES"] and caster.switches["LIGHTING"]
    constant = "one value" in name or "the same" in name
    assert bool(caster.switches.get("CONSTANT_CELLS")) == constant
    assert bool(caster.switches["SKIP_EMPTY"]) != constant  # all of it is visible: nothing to leap over
    same(*pictures(context, caster))


@pytest.mark.parametrize("early_termination", (0.0, 0.5))
def test_rays_end_where_they_would(context, early_termination):
    dense = TransferFunction([0, 50, 100, 255], [0.004, 0.004, 0.5, 0.9], COLORS)
    caster = caster_of(context, island(), dense, {"early_termination": early_termination})
    same(*pictures(context, caster))


def test_what_is_constant_and_shows_nothing_is_leapt_over_as_before(context):
    function = TransferFunction([0, 50, 140, 255], [0.0, 0.0, 0.03, 0.3], COLORS)
    caster = caster_of(context, island(), function, {})
    assert not caster.switches.get("CONSTANT_CELLS")
    same(*pictures(context, caster))


def test_a_field_that_is_constant_but_for_a_corner_is_lit_there_alone(context):
    array = np.full(SHAPE, 40, np.uint8)
    array[:9, :9, :9] = 200
    caster = caster_of(context, array, HAZE, {})
    assert caster.switches["CONSTANT_CELLS"]
    held, plain = pictures(context, caster)
    same(held, plain)
    assert held.counters["gradients"] <= 0.5 * plain.counters["gradients"] or held.counters == plain.counters
