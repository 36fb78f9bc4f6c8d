"""The pyramid on a volume of blocks: [multiresolution] stepping = "pyramid"."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.block_scenes import SHOWN, block_picture, block_scene, picture_of, random_levels, resident, twin_of
from helpers.pyramid_scenes import CAMERA, map_distances, pyramid_picture, pyramid_scene
from helpers.small_scenes import rms, waves
from reference.pyramid import mapped_oracle, render_pyramid_twin

from clvol import Renderer, Volume
from clvol.integrators.pyramid.blocks import BlockPyramidCaster
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED

SHAPE = (40, 37, 45)


def scene_of(volume, levels=3, **more):
    more = {"classification": "preintegrated", "step": 0.7, "camera": CAMERA, **more}
    scene = block_scene(volume, width=40, height=36, settings={"stepping": "pyramid"}, **more)
    return replace(scene, pyramid=scene.pyramid.model_copy(update={"levels": levels}))


def twin_of_caster(caster, field):
    grid = caster.resolved.volume.grid
    to_index = grid.world_to_index()
    upper = np.array(grid.size) - 1.0

    def values(world):
        index = world @ to_index[:3, :3].T + to_index[:3, 3]
        return field(np.clip(index, 0.0, upper) + 0.5)

    oracle = mapped_oracle(caster.resolved, map_distances(caster), caster.march.asked.shift, 0.5)
    return render_pyramid_twin(caster.resolved, oracle, values)


@pytest.mark.parametrize(("edge", "dropped"), [(16, 0.0), (8, 0.3)])
def test_the_picture_is_the_twins(context, edge, dropped):
    volume = Volume(waves(SHAPE))
    levels = random_levels(BlockGrid(SHAPE, edge), 5, dropped)
    blocks = resident(context, volume, levels, edge)
    caster = BlockPyramidCaster(context, scene_of(volume), blocks)
    data, twin = picture_of(caster), twin_of_caster(caster, twin_of(volume, levels, edge))
    difference = np.abs(data.rgba - twin.rgba).max(axis=-1)
    # Between dropped blocks the field is not continuous: rounding decides which block has a place.
    assert np.quantile(difference, 0.99) < 3e-4 and difference.max() < 0.05
    assert twin.rgba[..., 3].max() > 0.3
    counted = data.counters["accumulations"]
    assert abs(counted - twin.accumulations) <= 2 + 0.01 * counted
    assert data.counters["blended_samples"] < data.samples <= data.counters["block_reads"]


def test_blocks_at_full_resolution_make_the_picture_of_voxels(context):
    volume = Volume(waves(SHAPE))
    grid = BlockGrid(SHAPE, 16)
    blocks = resident(context, volume, np.zeros(grid.count, np.uint8))
    by_blocks = picture_of(BlockPyramidCaster(context, scene_of(volume), blocks))
    scene = pyramid_scene(volume.data, SHOWN, oracle="minimum", early_termination=0.0)
    by_voxels = pyramid_picture(context, scene)
    assert rms(by_blocks.rgba, by_voxels.rgba) < 2e-3
    assert by_blocks.rgba[..., 3].max() > 0.3


def test_coarse_blocks_take_fewer_samples_across_rays_too(context):
    """Of the same blocks: fewer than even steps take, and about as good a picture as long steps."""
    volume = Volume(waves(SHAPE))
    grid = BlockGrid(SHAPE, 16)
    blocks = resident(context, volume, np.full(grid.count, 2, np.uint8))
    scene = scene_of(volume, camera={**CAMERA, "fov_degrees": 30.0})
    scene = replace(scene, image=scene.image.model_copy(update={"width": 96, "height": 96}))

    def along(stepping):
        asked = scene.multiresolution.model_copy(update={"stepping": stepping})
        return block_picture(context, replace(scene, multiresolution=asked), blocks)

    both, even, limited = picture_of(BlockPyramidCaster(context, scene, blocks)), along("full"), along("limited")
    assert both.samples < 0.2 * even.samples and both.samples < 0.5 * limited.samples
    assert rms(both.rgba, even.rgba) < 0.01


def test_work_items_that_share_a_tile_and_several_buffers(context):
    volume = Volume(waves(SHAPE, np.uint16, 0, 255))
    levels = random_levels(BlockGrid(SHAPE, 8), 3, 0.2)
    scene = scene_of(volume)
    one = resident(context, volume, levels, 8)
    many = resident(context, volume, levels, 8, largest_buffer=one.sample_bytes // 3)
    packets = picture_of(BlockPyramidCaster(context, scene, one))
    for blocks, how in ((many, {"lanes": 1, "workers": 16}), (one, {"tile": 64})):
        other = picture_of(BlockPyramidCaster(context, scene, blocks, **how))
        assert rms(other.rgba, packets.rgba) < 1e-4
    awake = picture_of(BlockPyramidCaster(context, scene, one, leap=False))
    assert rms(awake.rgba, packets.rgba) < 1e-3


def test_no_step_leads_over_a_hole(context):
    """Two values that show nothing, a layer of NaN between them: no segment goes from one to the other."""
    array = np.full(SHAPE, 20.0, np.float32)
    array[:, :, 23:] = 240.0
    array[:, :, 22] = np.nan
    between = SHOWN.__class__([0.0, 60.0, 100.0, 140.0, 255.0], [0.0, 0.0, 0.9, 0.0, 0.0], [[1, 1, 1]] * 5)
    volume = Volume(array)
    blocks = resident(context, volume, np.zeros(BlockGrid(SHAPE, 16).count, np.uint8))
    scene = scene_of(volume, function=between, step=1.3)
    data = picture_of(BlockPyramidCaster(context, scene, blocks))
    even = scene.multiresolution.model_copy(update={"stepping": "full"})
    expected = block_picture(context, replace(scene, multiresolution=even), blocks)
    assert not expected.rgba.any() and not data.rgba.any()


def test_trials_know_that_all_pixels_are_rendered(device):
    scene = scene_of(Volume(waves(SHAPE)))
    with Renderer(scene, [device]) as renderer:
        assert renderer._on_device.prepared.renders_all_pixels
    asked = scene.multiresolution.model_copy(update={"stepping": "limited"})
    with Renderer(replace(scene, multiresolution=asked), [device]) as renderer:
        assert not renderer._on_device.prepared.renders_all_pixels


def test_nothing_resident_shows_nothing(context):
    volume = Volume(waves(SHAPE))
    levels = np.full(BlockGrid(SHAPE, 16).count, DROPPED, np.uint8)
    data = picture_of(BlockPyramidCaster(context, scene_of(volume), resident(context, volume, levels)))
    assert data.samples == 0 and not data.rgba.any() and data.counters["block_reads"] == 0


def test_by_the_renderer_within_a_budget(device):
    volume = Volume(waves((64, 64, 64)))
    scene = block_scene(
        volume, classification="preintegrated", width=48, height=48,
        settings={"stepping": "pyramid", "memory": "200 KiB"},
    )  # fmt: skip
    with Renderer(scene, [device]) as renderer:
        first = renderer.render()
        levels = first.stats["blocks"]["levels"]
        assert sum(levels[1:]) > 0 and first.rgba[..., 3].max() > 0.2
        renderer.set_transfer_function(SHOWN.__class__([0.0, 255.0], [0.0, 0.0], [[1, 1, 1]] * 2))
        assert not renderer.render().rgba.any()
