"""Blocks with further volumes: masks, which let blocks go, labels, densities and colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.block_effects import LIT, SHAPE, rendered, scene, smooth, twin
from helpers.block_scenes import picture_of, random_levels
from helpers.small_scenes import waves

from clvol import Volume
from clvol.device.fields import field_bytes
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.multiresolution.residency import memory_of_blocks
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.registry import check_scene
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED

LEVELS = random_levels(BlockGrid(SHAPE), 3)
ON_DEVICE = {"multiresolution": {"memory": "8 MiB"}}


def ramp(shape=(12, 10, 14), **grid) -> Volume:
    """Values along x, over the whole volume and a little more."""
    spacing = [(n + 1.0) / (m - 1.0) for n, m in zip(SHAPE[::-1], shape[::-1])]
    placed = {"spacing": spacing, "origin": [-1.0, -1.0, -1.0], **grid}
    return Volume((np.indices(shape)[2] * (255.0 / (shape[2] - 1))).astype(np.float32), **placed)


MASK = {"role": "mask", "threshold": 120.0}
LABELS = {
    "role": "label",
    "labels": [{"label": 2, "color": [1.0, 0.1, 0.1], "opacity": 0.6}, {"label": 5, "color": [0.1, 0.4, 1.0]}],
}
DENSITY = {
    "role": "density",
    "points": [
        {"value": 0.0, "opacity": 0.0, "color": [0.9, 0.9, 0.1]},
        {"value": 100.0, "opacity": 0.0, "color": [0.9, 0.9, 0.1]},
        {"value": 255.0, "opacity": 0.15, "color": [0.9, 0.4, 0.1]},
    ],
}


def fields(*, masks=True):
    labels = Volume((np.indices((9, 8, 11))[0] % 7).astype(np.uint8), spacing=[5.0, 4.6, 4.9])
    found = [{"file": labels, **LABELS}, {"file": ramp((5, 6, 7)), **DENSITY}]
    return {"field": [*found, {"file": ramp(), **MASK, "keep": "below"}] if masks else found}


def test_pictures_are_the_twins(context):
    resolved = scene(smooth(), **fields())
    data, expected = rendered(context, resolved, LEVELS), twin(resolved, LEVELS)
    far = np.abs(data.rgba - expected).max(axis=-1)
    assert np.quantile(far, 0.97) < 3e-4 and far.max() < 0.05
    assert data.counters["field_samples"] > 0 and expected[..., 3].max() > 0.3
    small = twin(scene(smooth(), width=6, height=5, **fields()), LEVELS)
    for left_out in range(3):
        fewer = [field for k, field in enumerate(fields()["field"]) if k != left_out]
        assert np.abs(twin(scene(smooth(), width=6, height=5, field=fewer), LEVELS) - small).max() > 0.03


def test_at_full_resolution_the_picture_is_the_ray_casters(context):
    """With blocks that the volume shows nothing of, and that the mask removes, left out."""
    data = np.where(np.indices(SHAPE)[1] < 18, 10, waves(SHAPE, np.uint8)).astype(np.uint8)
    tables = {**fields(), **ON_DEVICE}
    function = replace(scene().transfer_function, opacities=np.array([0.0, 0.0, 0.05, 0.12]))
    resolved = scene(Volume(data), transfer_function=function, **tables)
    engine = MultiresolutionEngine(context, resolved)
    found = engine.render(resolved.camera, 24, 20)
    plain = picture_of(Raycaster(context, scene(Volume(data), transfer_function=function, method="raycast", **tables)))
    np.testing.assert_allclose(found.rgba, plain.rgba, atol=1e-4)
    held = (engine.residency.blocks.levels != DROPPED).reshape(BlockGrid(SHAPE).counts)
    assert not held[:, 0].any() and not held[:, :, 3].any() and held[:, 1:, 0].all()


@pytest.mark.slow  # a program of its own
def test_lit_masks_and_leaps(context):
    resolved = scene(smooth(), **fields(), **LIT)
    data = rendered(context, resolved, LEVELS)
    np.testing.assert_array_equal(data.rgba, rendered(context, resolved, LEVELS, skip=False).rgba)
    far = np.abs(data.rgba - twin(resolved, LEVELS)).max(axis=-1)
    assert np.quantile(far, 0.97) < 5e-4


@pytest.mark.slow  # a program of its own
def test_masks_cut_projections(context):
    resolved = scene(smooth(), integration={"compositing": "maximum"}, field=fields()["field"][2:])
    data, expected = rendered(context, resolved, LEVELS), twin(resolved, LEVELS)
    assert np.quantile(np.abs(data.rgba - expected).max(axis=-1), 0.95) < 3e-4


@pytest.mark.parametrize("keep", ["above", "below"])
def test_blocks_outside_a_mask_are_dropped_and_no_other(context, keep):
    tables = {"field": [{"file": ramp((6, 5, 52)), **MASK, "keep": keep}], **ON_DEVICE}
    resolved = scene(smooth(), **tables)
    held = MultiresolutionEngine(context, resolved).residency.blocks.levels.reshape(BlockGrid(SHAPE).counts) != DROPPED
    # The border is at x = 120 / 255 * 51 - 1, which is 23, in the second of four blocks.
    wanted = [False, True, True, True] if keep == "above" else [True, True, False, False]
    assert held.any(axis=(0, 1)).tolist() == wanted


def test_fields_take_their_bytes_from_the_blocks(context):
    resolved = scene(smooth(), **fields(), **ON_DEVICE)
    assert memory_of_blocks(resolved) == 8 * 2**20 - field_bytes(resolved) < 8 * 2**20
    engine = MultiresolutionEngine(context, resolved)
    assert engine.residency.blocks.device_bytes + field_bytes(resolved) <= 8 * 2**20
    large = Volume(np.random.default_rng(1).random((64, 64, 64)).astype(np.float32))
    with pytest.raises(SceneError, match="memory: got 1 MiB, of which the voxels of fields take 1.0 MiB"):
        tight = {"multiresolution": {"memory": "1 MiB"}}
        check_scene(scene(smooth(), field=[{"file": large, **MASK, "threshold": 0.5}], **tight))


def test_unused_fields_compile_nothing_and_used_ones_are_explained():
    apart = ramp(origin=[500.0, 0.0, 0.0])
    idle = scene(smooth(), field=[{"file": apart, **DENSITY}])
    assert kernel_hash(idle) == kernel_hash(scene(smooth())) != kernel_hash(scene(smooth(), **fields()))
    told = {effect["name"] for effect in explain(scene(smooth(), **fields()))["effects"] if effect["called_for"]}
    assert {"label field", "density field", "mask field"} <= told
