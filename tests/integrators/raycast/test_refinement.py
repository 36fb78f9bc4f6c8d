"""Less step is never more error: narrow peaks, opacity 1 at a point, walls, many control points, the shipped scene."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.paths import DATA
from helpers.small_scenes import exact, make_scene, rms, waves

from clvol import Renderer, TransferFunction, load_scene

RED, GREEN, BLUE = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]
_random = np.random.default_rng(0)
FUNCTIONS = {
    # What tables with nodes at even values, or beside the peak, have a floor for.
    "opaque at one point": TransferFunction([60, 80, 100], [0, 1, 0], [RED, GREEN, BLUE], 10.0),
    "opaque at the end": TransferFunction([100, 255], [0, 1], [RED, BLUE], 10.0),
    "a peak of one grey level": TransferFunction([59, 60, 61], [0, 0.8, 0], [RED, GREEN, BLUE]),
    "a wall": TransferFunction([90, 120, 120, 130, 200], [0.01, 0.05, 1, 1, 0], [RED, RED, GREEN, GREEN, BLUE]),
    "forty points": TransferFunction(
        np.arange(40) * 6.5, _random.random(40) ** 3, _random.random((40, 3)), 3.0
    ),
}
STEPS = (1.0, 0.5, 0.25, 0.125, 0.0625)
RULES = {
    "pre-integrated": {},
    "post": {"classification": "post"},
    "cells": {"quadrature": "cells"},
    "blocks": {"method": "multiresolution"},
}
DEMO = DATA / "demo.toml"


def picture_of(device, resolved) -> np.ndarray:
    with Renderer(resolved, devices=[device]) as renderer:
        return renderer.render().rgba


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_error_never_grows_with_refinement(device, name, rule):
    array = waves((15, 16, 17), np.uint8)
    function = FUNCTIONS[name]
    reference = exact(device, make_scene(array, function))
    errors = [
        rms(picture_of(device, make_scene(array, function, step=step, **RULES[rule])), reference)
        for step in STEPS
    ]
    # Midpoints meet a peak of one grey level by chance until steps are shorter than the way through it.
    by_chance = rule == "post" and name == "a peak of one grey level"
    for coarse, fine in zip(errors[2 * by_chance :], errors[2 * by_chance + 1 :]):
        assert fine <= 1.02 * coarse + 3e-6, errors
    order = np.log2(errors[0] / errors[-1]) / (len(STEPS) - 1)
    assert order > (0.7 if rule == "post" else 1.3) or errors[-1] < 1e-5, errors


def test_opacity_1_at_one_point_is_no_wall(device):
    """uint8 voxels, 60 -> 80 -> 100 with opacities 0, 1, 0 over 10 lengths: nothing may turn opaque that passes 80."""
    array = waves((15, 16, 17), np.uint8)
    function = FUNCTIONS["opaque at one point"]
    reference = exact(device, make_scene(array, function))
    assert 0.2 < reference[..., 3].max() < 0.9
    for rule in RULES.values():
        rgba = picture_of(device, make_scene(array, function, step=0.25, **rule))
        assert np.abs(rgba[..., 3] - reference[..., 3]).max() < 0.01


def test_a_constant_field_of_opacity_1_is_opaque_at_once(device):
    for kind in ("pre", "post", "preintegrated"):
        scene = make_scene(np.full((5, 6, 7), 80, np.uint8), FUNCTIONS["opaque at one point"], classification=kind)
        rgba = picture_of(device, scene)
        shown = rgba[..., 3] > 0
        assert shown.any() and np.all(rgba[shown] == [0, 1, 0, 1])


def test_table_size_changes_nothing(device):
    array, function = waves((15, 16, 17), np.uint8), FUNCTIONS["a peak of one grey level"]
    pictures = [
        picture_of(device, make_scene(array, function, table_size=size)) for size in (16, 255, 256, 1024)
    ]
    assert all(np.array_equal(pictures[0], other) for other in pictures[1:])


def test_the_shipped_scene_converges_to_single_precision(device):
    def at(step):
        keys = ("integration.early_termination=0.0", "image.width=20", "image.height=20")
        return load_scene(DEMO, overrides=(f"integration.step={step}", *keys)).resolve()

    reference = exact(device, at(1.0))
    errors = [rms(picture_of(device, at(step)), reference) for step in (1.0, 0.25, 1 / 16, 1 / 32)]
    assert errors == sorted(errors, reverse=True) and errors[-1] < 1e-5, errors
