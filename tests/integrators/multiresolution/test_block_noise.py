"""Noise over blocks: values and places, against the plain twin and the ray caster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.block_effects import CLIPS, LIT, SHAPE, rendered, scene, smooth, twin
from helpers.block_scenes import SHOWN, picture_of, random_levels
from helpers.small_scenes import waves

from clvol import Volume
from clvol.explanation import explain, kernel_hash
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.multiresolution.scene_errors import effects_on_blocks
from clvol.integrators.raycast.caster import Raycaster
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED

LEVELS = random_levels(BlockGrid(SHAPE), 3)
NOISE = {
    "noise": [
        {"target": "value", "amplitude": 25.0, "frequency": 3.0, "octaves": 2, "seed": 4},
        {"target": "coordinate", "amplitude": 3.0, "frequency": 2.0, "seed": 5},
    ]
}
THIN = replace(SHOWN, opacities=np.array([0.0, 0.0, 0.05, 0.12]))


def edge_of_empty() -> Volume:
    """Empty in the third of the volume that has small x."""
    return Volume(np.where(np.indices(SHAPE)[2] < 18, 20, waves(SHAPE, np.uint8) // 2 + 100).astype(np.uint8))


@pytest.mark.slow  # the twin takes long
def test_pictures_are_the_twins_and_leaps_change_no_bit(context):
    resolved = scene(edge_of_empty(), **NOISE, transfer_function=THIN)
    data, expected = rendered(context, resolved, LEVELS), twin(resolved, LEVELS)
    np.testing.assert_allclose(data.rgba, expected, atol=1e-3)
    plain = twin(scene(edge_of_empty(), transfer_function=THIN), LEVELS)
    assert np.abs(expected - plain).max() > 0.05
    walks = rendered(context, resolved, LEVELS, skip=False)
    np.testing.assert_array_equal(walks.rgba, data.rgba)
    assert data.samples < walks.samples


def test_at_full_resolution_the_picture_is_the_ray_casters(context):
    """Blocks that are empty even with noise are left out, and those that clips remove for good."""
    tables = {**NOISE, "transfer_function": THIN, "clip": CLIPS[:1], "multiresolution": {"memory": "8 MiB"}}
    resolved = scene(edge_of_empty(), **tables)
    engine = MultiresolutionEngine(context, resolved)
    found = engine.render(resolved.camera, 24, 20)
    plain = picture_of(Raycaster(context, scene(edge_of_empty(), method="raycast", **tables)))
    np.testing.assert_allclose(found.rgba, plain.rgba, atol=2e-4)
    dropped = (engine.residency.blocks.levels == DROPPED).reshape(BlockGrid(SHAPE).counts)
    assert dropped[:, :, 0].all() and not dropped[:, :, 2:].all()


def test_noise_makes_blocks_visible(context):
    """Values that are transparent by little are held, since noise may show them."""
    volume = Volume(np.full(SHAPE, 50, np.uint8))
    held = [
        MultiresolutionEngine(context, scene(volume, transfer_function=THIN, **tables)).residency.blocks.levels
        for tables in ({"noise": [{"target": "value", "amplitude": 5.0}]}, NOISE | {"noise": [
            {"target": "value", "amplitude": 90.0}]})
    ]  # fmt: skip
    assert (held[0] == DROPPED).all() and (held[1] != DROPPED).all()


@pytest.mark.slow  # programs with gradients of noisy values, and of surfaces in them
def test_lit_surfaces_in_noise(context):
    surface = {"isosurface": [{"value": 150.0, "opacity": 0.6, "color": [0.8, 0.3, 0.2]}]}
    resolved = scene(smooth(), **NOISE, **LIT, **surface)
    data, expected = rendered(context, resolved, LEVELS), twin(resolved, LEVELS)
    far = np.abs(data.rgba - expected).max(axis=-1)
    assert np.quantile(far, 0.9) < 2e-3 and data.counters["surface_hits"] > 50


@pytest.mark.slow  # a program of its own
def test_noisy_maxima(context):
    resolved = scene(smooth(), integration={"compositing": "maximum"}, **NOISE)
    data, expected = rendered(context, resolved, LEVELS), twin(resolved, LEVELS)
    np.testing.assert_allclose(data.rgba, expected, atol=2e-3)
    np.testing.assert_array_equal(rendered(context, resolved, LEVELS, skip=False).rgba, data.rgba)


def test_unused_noise_compiles_nothing_and_used_noise_is_explained():
    none = {"noise": [{"target": "value", "amplitude": 0.0}]}
    assert kernel_hash(scene(smooth(), **none)) == kernel_hash(scene(smooth())) != kernel_hash(scene(smooth(), **NOISE))
    told = {effect["name"] for effect in explain(scene(smooth(), **NOISE))["effects"] if effect["called_for"]}
    assert "noise" in told
    found = effects_on_blocks(scene(smooth(), **NOISE))
    assert 2.0 < found.moves < 12.0 and found.reach == found.moves
