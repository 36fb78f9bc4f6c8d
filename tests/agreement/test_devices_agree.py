"""Devices agree: what the first device renders, every other one renders too, within single precision's rounding.

The other device's programs are compiled as users get them, optimisations included. Between them the scenes use
every rendering method, filter, classification and effect, every kind of program once: what one program computes in
hard cases is tested on the first device alone. Refraction is left out: Intel's compiler takes five minutes and more to
optimise its kernel. It is compared with its numpy reference on the first device.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import HAZE, blobs, scaled
from helpers.effect_tables import Place, by_name, with_tables

from clvol import Renderer, Scene, Volume

pytestmark = pytest.mark.slow  # compilers that optimise take seconds to a minute for each of these

SHAPE = (15, 17, 19)
SIZE = {"width": 16, "height": 12}
CAMERA = {"position": [34.0, 22.0, -27.0], "target": [9.0, 8.0, 7.0], "fov_degrees": 32.0}
LIMIT = 2e-3  # of a value in any channel, from 0 to 1 and a little more where light is bright


def volume_of(dtype, holes=0.0) -> Volume:
    voxels = blobs(SHAPE, top=255, dtype=dtype)
    if holes:
        voxels[np.random.default_rng(5).random(SHAPE) < holes] = np.nan
    return Volume(voxels)


BYTES = volume_of(np.uint8)


def effects(*names):
    """``tables(place)`` of the effects together."""

    def tables(place: Place):
        made = {}
        for name in names:
            made = with_tables(made, by_name(name).tables(place))
        return made

    return tables


def nothing(place: Place):
    return {}


def half_angle(place: Place):
    return {
        "light": [{"type": "directional", "direction": [0.3, -0.5, 0.6]}], "slicing": {"geometry": "half-angle"},
        "shadow": {"resolution": 24, "scattering": 0.5},
        "clip": [{"point": [9.0, 8.0, 7.0], "normal": [1.0, 0.2, 0.3]}],
    }  # fmt: skip


# name: (volume, tables of effects, keys of [integration])
SCENES = {
    "post": (BYTES, nothing, {}),
    "pre-integrated, float64 with holes": (volume_of(np.float64, 0.02), nothing, {"classification": "preintegrated"}),
    "pre-classified, nearest, int16": (volume_of(np.int16), nothing, {"classification": "pre", "filter": "nearest"}),
    "Sobel gradients, opacity by gradient": (
        BYTES, effects("three lights", "Sobel, on the fly", "gradient opacity", "directional opacity"), {}),
    "precomputed gradients of float32": (
        volume_of(np.float32), effects("gradients precomputed", "two-value function"), {}),
    "prefiltered cubic, lit": (BYTES, effects("cubic, lit"), {"prefilter": True}),
    "Catmull-Rom": (BYTES, nothing, {"filter": "catmull-rom"}),
    "shadow rays": (BYTES, effects("shadow rays"), {}),
    "scattering": (BYTES, effects("scattering"), {}),
    "environment of a cube": (BYTES, effects("environment, cube"), {}),
    "fields and clips": (BYTES, effects("label field", "density field", "mask field", "clip box", "clip sphere"), {}),
    "noise, cycling colours, depth cue": (BYTES, effects("noise, 4 octaves", "colour cycle", "depth cue"), {}),
    "maximum": (BYTES, effects("maximum"), {}),
    "average": (BYTES, effects("average"), {}),
    "attenuated maximum": (BYTES, effects("attenuated maximum"), {}),
    "cells": (BYTES, nothing, {"quadrature": "cells", "classification": "preintegrated"}),
    "reference": (BYTES, nothing, {"method": "reference"}),
    "pyramid": (BYTES, nothing, {"method": "pyramid", "classification": "preintegrated"}),
    "multiresolution": (BYTES, nothing, {"method": "multiresolution"}),
    "maximum of blocks": (BYTES, effects("maximum"), {"method": "multiresolution"}),
    "blocks, masked and noisy": (
        BYTES, effects("mask field", "noise, 4 octaves", "clip box"), {"method": "multiresolution"}),
    "slicing": (BYTES, nothing, {"method": "slicing"}),
    "half-angle slices": (BYTES, half_angle, {"method": "slicing"}),
}  # fmt: skip


def frame_on(device, name: str, place: Place):
    volume, tables, integration = SCENES[name]
    integration = {"table_size": 64, "classification": "post", **integration}
    settings = {
        "volume": volume, "camera": CAMERA, "image": SIZE, "transfer_function": scaled(HAZE, 255.0),
        "integration": integration,
    }  # fmt: skip
    scene = Scene(**with_tables(settings, tables(place)))
    with Renderer(scene, devices=[device]) as renderer:
        return renderer.render()


# Whose kernels Intel's compiler takes most of a minute and more to optimise.
LONG = {"shadow rays", "environment of a cube", "scattering", "multiresolution", "fields and clips",
        "Sobel gradients, opacity by gradient", "half-angle slices", "maximum of blocks",
        "blocks, masked and noisy"}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.exhaustive] * (name in LONG)) for name in SCENES]
)
def test_devices_agree(device, other_device, name, tmp_path):
    assert device != other_device
    place = Place(BYTES, tmp_path)
    ours, theirs = (frame_on(one, name, place) for one in (device, other_device))
    assert 0.01 < ours.rgba[..., 3].max() <= 1
    np.testing.assert_allclose(theirs.rgba, ours.rgba, rtol=0, atol=LIMIT)
    # Where opacity reaches one half: a ray that ends close to that has a depth, or not, by rounding.
    hit = np.isfinite(ours.depth), np.isfinite(theirs.depth)
    assert np.mean(hit[0] != hit[1]) < 0.01
    both = hit[0] & hit[1]
    np.testing.assert_allclose(theirs.depth[both], ours.depth[both], rtol=0, atol=0.05)
    assert theirs.stats["samples"] == pytest.approx(ours.stats["samples"], rel=0.01)
