"""Blocks with further volumes: masks, which let blocks go, labels, densities and colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.block_effects import LIT, SHAPE, rendered, scene, smooth, twin
from helpers.block_scenes import picture_of, random_levels
from helpers.small_scenes import waves

from clvol import Volume
from clvol.device.fields import field_bytes, kept_blocks
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.features import reduced
from clvol.integrators.multiresolution.blocked_volume import levels_of_fields
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.multiresolution.residency import bytes_of_fields, memory_of_blocks
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
    resolved = scene(smooth(), width=12, height=10, **fields())
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
    large = Volume((np.indices((64, 64, 64))[0] % 7).astype(np.uint8))
    with pytest.raises(SceneError, match="memory: got 1 MiB, of which the voxels of fields take 1.0 MiB"):
        tight = {"multiresolution": {"memory": "1 MiB"}}
        check_scene(scene(smooth(), field=[{"file": large, **LABELS}], **tight))


def test_unused_fields_compile_nothing_and_used_ones_are_explained():
    apart = ramp(origin=[500.0, 0.0, 0.0])
    idle = scene(smooth(), field=[{"file": apart, **DENSITY}])
    assert kernel_hash(idle) == kernel_hash(scene(smooth())) != kernel_hash(scene(smooth(), **fields()))
    told = {effect["name"] for effect in explain(scene(smooth(), **fields()))["effects"] if effect["called_for"]}
    assert {"label field", "density field", "mask field"} <= told


# ---- fields that do not fit ----


def coarse_ramp(level: int) -> tuple[Volume, Volume]:
    """A field over much more than the volume, and one of its samples at ``level``."""
    rng = np.random.default_rng(5)
    data = rng.random((48, 64, 64)).astype(np.float32) * 100.0 + np.indices((48, 64, 64))[2] * 2.0
    spacing, size = np.array([2.0, 2.0, 2.0]), 1 << level
    fine = Volume(data.astype(np.float32), spacing=spacing, origin=[-30.0, -40.0, -20.0])
    parts = data.reshape(48 // size, size, 64 // size, size, 64 // size, size)
    origin = np.asarray(fine.grid.origin) + (size - 1) / 2 * spacing
    return fine, Volume(parts.mean(axis=(1, 3, 5)).astype(np.float32), spacing=spacing * size, origin=origin)


def test_large_fields_are_held_coarser(context):
    """The picture is that of a field of the level's samples; a store's are read from it, and its voxels are not."""
    fine, coarse = coarse_ramp(1)
    tables = [{"field": [{"file": field, **MASK, "threshold": 105.0}]} for field in (fine, coarse)]
    small = {"multiresolution": {"memory": "1 MiB"}}
    resolved = [scene(smooth(), **each, **small) for each in tables]
    assert [levels_of_fields(reduced(each)) for each in resolved] == [[1], [0]]
    assert bytes_of_fields(resolved[0]) == bytes_of_fields(resolved[1]) == 24 * 32 * 32 * 4
    pictures = [rendered(context, each, LEVELS).rgba for each in resolved]
    np.testing.assert_allclose(pictures[0], pictures[1], atol=2e-4)
    whole = scene(smooth(), **tables[0], multiresolution={"memory": "8 MiB"})
    assert levels_of_fields(reduced(whole)) == [0]
    assert np.abs(pictures[0] - rendered(context, whole, LEVELS).rgba).max() > 0.01


def test_domains_end_where_they_did():
    """A coarser field ends where its voxels do: beyond that a mask removes everything."""
    field = Volume(np.full((16, 24, 20), 200, np.uint8), spacing=(1.1, 1.0, 1.3), origin=(9.0, -40.0, 20.7))
    mask = scene(smooth(), field=[{"file": field, **MASK}]).fields[0]
    grid = smooth().grid
    kept = [kept_blocks([(mask, level)], grid, (5, 5, 7), 8, 0.0) for level in (0, 1, 2)]
    assert not kept[0].any()  # it lies beside the volume
    moved = replace(mask, volume=replace_origin(field, (9.0, 4.0, 20.7)))
    kept = [kept_blocks([(moved, level)], grid, (5, 5, 7), 8, 0.0) for level in (0, 1, 2)]
    assert 10 < kept[0].sum() < 100
    for coarser in kept[1:]:
        np.testing.assert_array_equal(coarser, kept[0])


def replace_origin(volume: Volume, origin) -> Volume:
    return Volume(volume.data, spacing=volume.grid.spacing, origin=origin)
