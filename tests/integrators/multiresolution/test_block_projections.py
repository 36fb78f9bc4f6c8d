"""Projections of blocks: by the kernels, against the plain twin, the ray caster and what statistics say of levels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.block_effects import CLIPS, SHAPE, rendered, scene, smooth, twin
from helpers.block_scenes import SHOWN, noise, picture_of, random_levels
from helpers.small_scenes import waves

from clvol import Volume
from clvol.explanation import explain, kernel_hash
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.multiresolution.projection_errors import projection_errors, shows_nothing
from clvol.integrators.multiresolution.scene_errors import effects_on_blocks
from clvol.integrators.raycast.caster import Raycaster
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED
from clvol.store.volume_blocks import VolumeBlocks

MODES = ("maximum", "minimum", "average", "attenuated-maximum")
STRONG = replace(SHOWN, opacities=np.array([0.0, 0.1, 0.5, 0.9]))


def projected(mode, volume=None, method="multiresolution", **tables):
    integration = {"compositing": mode} | tables.pop("integration", {})
    return scene(volume, method=method, integration=integration, **{"transfer_function": STRONG, **tables})


@pytest.mark.parametrize("mode", MODES)
def test_pictures_are_the_twins(context, mode):
    resolved = projected(mode, clip=CLIPS)
    levels = random_levels(BlockGrid(SHAPE), 3)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    # A ray that just enters or misses a clip takes a sample more or less.
    far = np.abs(data.rgba - expected).max(axis=-1)
    assert np.quantile(far, 0.95) < 2e-4
    assert expected[..., 3].max() > 0.3 and data.counters["block_reads"] >= data.samples


@pytest.mark.parametrize("mode", MODES)
def test_at_full_resolution_the_picture_is_the_ray_casters(context, mode):
    volume = smooth()
    data = rendered(context, projected(mode, volume), np.zeros(BlockGrid(SHAPE).count, np.uint8))
    plain = picture_of(Raycaster(context, projected(mode, volume, "raycast")))
    np.testing.assert_allclose(data.rgba, plain.rgba, atol=1e-4)
    assert data.rgba[..., 3].max() > 0.3


@pytest.mark.parametrize("mode", ("maximum", "minimum"))
def test_leaps_change_no_bit_and_save_samples(context, mode):
    resolved = projected(mode, smooth())
    levels = random_levels(BlockGrid(SHAPE), 7, dropped=0.2)
    first, walks = rendered(context, resolved, levels), rendered(context, resolved, levels, skip=False)
    np.testing.assert_array_equal(first.rgba, walks.rgba)
    np.testing.assert_array_equal(first.depth, walks.depth)
    assert first.samples < walks.samples


@pytest.mark.parametrize("mode", MODES)
def test_what_is_dropped_changes_nothing(context, mode):
    """Blocks that show nothing take no memory, and the picture is that of all voxels."""
    data = np.where(np.indices(SHAPE)[2] < 24, 40, waves(SHAPE, np.uint8)).astype(np.uint8)
    if mode == "minimum":
        data = 255 - data
    opacities = [0.0, 0.0, 0.5, 0.9] if mode != "minimum" else [0.9, 0.5, 0.1, 0.0]
    function = replace(STRONG, opacities=np.array(opacities))
    if mode == "minimum":
        function = replace(function, values=np.array([0.0, 60.0, 140.0, 200.0]))
    tables = {"transfer_function": function, "clip": CLIPS[:1], "multiresolution": {"memory": "8 MiB"}}
    engine = MultiresolutionEngine(context, projected(mode, Volume(data), **tables))
    resolved = engine.resolved
    found = engine.render(resolved.camera, 24, 20)
    plain = picture_of(Raycaster(context, projected(mode, Volume(data), "raycast", **tables)))
    np.testing.assert_allclose(found.rgba, plain.rgba, atol=1e-4)
    dropped = (engine.residency.blocks.levels == DROPPED).reshape(BlockGrid(SHAPE).counts)
    assert dropped[:, :, 0].all() == (mode in ("maximum", "minimum"))
    assert found.rgba[..., 3].max() > 0.3


def test_another_selection_has_other_bounds(context):
    """Blocks that become finer raise maxima: rays may no longer leap over them."""
    volume = noise(SHAPE)
    tight = projected("maximum", volume, multiresolution={"memory": "8 MiB"})
    engine = MultiresolutionEngine(context, tight)
    grid = BlockGrid(SHAPE)
    coarse = np.full(grid.count, grid.levels - 1, np.uint8)
    means = np.concatenate([part.mean[-1] for part in VolumeBlocks(volume).statistics()])
    pictures = []
    for levels in (coarse, np.zeros(grid.count, np.uint8)):
        engine.residency.blocks.load(levels, means)
        engine.caster.set_resident()
        pictures.append(picture_of(engine.caster).rgba)
        np.testing.assert_allclose(pictures[-1], twin(tight, levels), atol=2e-4)
    assert pictures[1][..., 3].max() > pictures[0][..., 3].max() + 0.1


@pytest.mark.slow  # programs of other types
@pytest.mark.parametrize(("dtype", "holes"), [("float32", 0.02), ("int8", 0.0), ("float64", 0.0)])
def test_other_types_and_holes(context, dtype, holes):
    resolved = projected("maximum", noise(SHAPE, dtype, holes=holes))
    levels = random_levels(BlockGrid(SHAPE), 6)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    far = np.abs(data.rgba - expected).max(axis=-1)
    assert np.quantile(far, 0.8 if holes else 0.98) < 2e-4 and expected[..., 3].max() > 0.1


@pytest.mark.parametrize("shape", [(1, 30, 25), (17, 16, 15)])
def test_thin_volumes(context, shape):
    resolved = projected("maximum", noise(shape))
    levels = random_levels(BlockGrid(shape), 2)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    assert np.quantile(np.abs(data.rgba - expected).max(axis=-1), 0.98) < 2e-4


# ---- the choice of blocks ----


def test_errors_fall_with_resolution_and_see_extremes():
    """One bright voxel in an even block matters to a maximum, less to a mean, and to a minimum not at all."""
    data = np.full((16, 16, 32), 100, np.uint8)
    data[8, 8, 8] = 255
    source, black = VolumeBlocks(Volume(data)), np.zeros(3)
    found = {mode: projection_errors(source, STRONG, black, mode).errors for mode in MODES}
    for errors in found.values():
        assert (np.diff(errors, axis=0) >= 0).all() and not errors[0].any() and not errors[:, 1].any()
    assert found["maximum"][-1, 0] > 10 * found["minimum"][-1, 0]
    assert found["maximum"][-1, 0] > 2 * found["average"][-1, 0] > 0


def test_only_extremes_let_blocks_go():
    source = VolumeBlocks(Volume(np.where(np.indices((16, 16, 48))[2] < 30, 20, 200).astype(np.uint8)))
    function = replace(STRONG, opacities=np.array([0.0, 0.0, 0.5, 0.9]))
    part = next(iter(source.statistics()))
    gone = {mode: shows_nothing(part, function, mode).tolist() for mode in MODES}
    assert gone["maximum"] == [True, False, False]
    assert not any(any(gone[mode]) for mode in MODES[1:])
    upside_down = replace(function, opacities=np.array([0.9, 0.5, 0.0, 0.0]))
    assert shows_nothing(part, upside_down, "minimum").tolist() == [False, False, True]


def test_unused_effects_compile_nothing_and_used_ones_are_explained():
    volume = smooth()
    assert kernel_hash(projected("maximum", volume)) != kernel_hash(scene(volume))
    idle = replace(STRONG, opacities=np.zeros(4))
    assert kernel_hash(projected("maximum", volume, transfer_function=idle)) == kernel_hash(
        scene(volume, transfer_function=idle)
    )
    told = {effect["name"] for effect in explain(projected("average", volume))["effects"] if effect["called_for"]}
    assert "projection" in told
    assert effects_on_blocks(projected("average", volume)).compositing == "average"
