"""Slices through bricks: the picture of a volume in one array, bit for bit, whatever the pool of bricks holds."""

from __future__ import annotations

import re

import numpy as np
import pytest
from helpers.pyramid_scenes import SHELL, pyramid_scene, rendered
from helpers.small_scenes import waves

from clvol import TransferFunction
from clvol.device.brick_pool import ReadBricks
from clvol.device.volume import DeviceVolume
from clvol.device.voxel_boxes import box_bytes, box_places
from clvol.errors import SceneError
from clvol.integrators.pyramid.bricks import BrickPyramidCaster
from clvol.integrators.pyramid.caster import PyramidCaster
from clvol.integrators.raycast.bricks import BrickVolume
from clvol.store.volume_blocks import VolumeBlocks

SHAPE = (37, 26, 41)
AMPLE = 1 << 26
LARGE = {"width": 170, "height": 150, "camera": {"position": (-75.0, -58.0, -81.0), "target": (30.0, 35.0, 28.0)}}


def bricks_of(context, resolved, memory=AMPLE, edge=8, **layout) -> BrickVolume:
    return BrickVolume(context, ReadBricks(context, VolumeBlocks(resolved.volume, edge)), memory, **layout)


def both(context, resolved, memory=AMPLE, edge=8, **how):
    """The frames of the volume in one array and in bricks, and the caster of the second."""
    caster = BrickPyramidCaster(context, resolved, bricks_of(context, resolved, memory, edge), **how)
    return rendered(PyramidCaster(context, resolved, **how)), rendered(caster), caster


def assert_same(plain, bricks) -> None:
    np.testing.assert_array_equal(bricks.rgba, plain.rgba)
    np.testing.assert_array_equal(bricks.depth, plain.depth)
    assert bricks.samples == plain.samples and bricks.counters == plain.counters
    assert np.ptp(plain.rgba[..., 3]) > 0.01


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int16", "float32"])
def test_every_type_is_the_plain_picture(contexts, each_device, dtype):
    low, high = (-128, 127) if dtype == "int8" else (0, 255)
    function = TransferFunction(SHELL.values + low, SHELL.opacities, SHELL.colors)
    assert_same(*both(contexts(each_device), pyramid_scene(waves(SHAPE, dtype, low, high), function))[:2])


@pytest.mark.parametrize(
    "asked",
    [
        {"oracle": "minimum"}, {"oracle": "visible"}, {"oracle": "opacity-gradient"}, {"oracle": "bandwidth"},
        {"filter": "cubic"}, {"filter": "catmull-rom", "levels": 1}, {"levels": 0}, {"step": 3.0},
        {"grid": {"spacing": (1.0, 1.7, 2.3)}, "camera": None},
        {"camera": {"position": (20.0, 12.0, 18.0), "target": (40.0, 20.0, 30.0), "fov_degrees": 70.0}},
        {"camera": {"projection": "orthographic", "height": 50.0, "position": (-60.0, -40.0, -60.0),
                    "target": (20.0, 12.0, 18.0)}},
    ],
)  # fmt: skip
def test_every_oracle_filter_and_view(contexts, device, asked):
    assert_same(*both(contexts(device), pyramid_scene(waves(SHAPE, np.uint8), SHELL, **asked))[:2])


@pytest.mark.parametrize("shape", [(1, 26, 41), (37, 1, 41), (37, 26, 1), (17, 9, 33), (16, 8, 32)])
def test_axes_of_one_voxel_and_whole_bricks(contexts, device, shape):
    array = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint16)
    assert_same(*both(contexts(device), pyramid_scene(array, camera=None))[:2])


@pytest.mark.parametrize("oracle", ["error", "opacity-gradient", "bandwidth"])
def test_voxels_that_are_not_finite(contexts, device, oracle):
    array = waves(SHAPE)
    array[3:20, 5:9, 7:30] = np.nan
    array[30, 20, 10], array[8:16, 8:16, 8:16] = np.inf, np.nan
    assert_same(*both(contexts(device), pyramid_scene(array, camera=None, oracle=oracle))[:2])


def test_a_pool_that_is_too_small_for_the_frame_renders_groups_of_tiles(contexts, each_device):
    context = contexts(each_device)
    array = waves((60, 70, 80), np.uint8) // 2 + np.random.default_rng(2).integers(0, 120, (60, 70, 80), np.uint8)
    for asked in ({}, {"levels": 1, "step": 2.0}, {"filter": "cubic"}):
        resolved = pyramid_scene(array, SHELL, **LARGE, **asked)
        plain, bricks, ample = both(context, resolved)
        assert_same(plain, bricks)
        pool = ample.volume.pool
        assert pool.blocks.count == len(ample.needed) == 8 * 9 * 10
        memory = pool.memory_for(int(0.75 * pool.blocks.count))
        plain, bricks, small = both(context, resolved, memory)
        assert_same(plain, bricks)
        pool = small.volume.pool
        assert pool.device_bytes <= memory and pool.filled_voxels > array.size  # some of it twice


def test_what_a_tile_does_not_see_is_not_used(contexts, device):
    """Bricks that are not resident are where the pool's first one is, and that is full of other voxels."""
    context = contexts(device)
    array = np.random.default_rng(4).integers(0, 256, (60, 70, 80)).astype(np.uint8)
    resolved = pyramid_scene(array, **LARGE)
    plain, _, ample = both(context, resolved)
    pool = ample.volume.pool
    memory = pool.memory_for(int(0.7 * pool.blocks.count))
    caster = BrickPyramidCaster(context, resolved, bricks_of(context, resolved, memory))
    held = []
    hold = caster.volume.pool.hold
    caster.volume.pool.hold = lambda blocks: (held.append(len(blocks)), hold(blocks))[1]
    assert_same(plain, rendered(caster))
    assert len(held) > 1 and max(held) <= caster.volume.pool.most < pool.blocks.count


def test_a_pool_that_does_not_hold_one_tile_says_the_least_memory(contexts, device):
    context = contexts(device)
    resolved = pyramid_scene(waves((60, 70, 80), np.uint8), SHELL, width=16, height=16)
    ample = both(context, resolved)[2]
    memory = ample.volume.pool.memory_for(400)
    with pytest.raises(SceneError, match="400 decoded blocks can be held where the rays of a tile need 720") as raised:
        both(context, resolved, memory)
    least = re.search(r"at least (\d+) bytes", str(raised.value))
    assert least is not None
    assert_same(*both(context, resolved, int(least[1]))[:2])


def test_maps_are_made_within_the_memory_of_the_pool(contexts, device, monkeypatch):
    """In boxes that are decoded one after another, while the pool holds nothing."""
    context = contexts(device)
    array = waves((120, 130, 33), np.uint16)
    resolved = pyramid_scene(array, SHELL, levels=1, camera=None)
    pool = bricks_of(context, resolved, edge=16).pool
    memory = pool.memory_for(60)
    boxes = []
    inner = BrickVolume.boxes

    def noted(self, halo):
        for box in inner(self, halo):
            boxes.append((halo, box.voxels.nbytes + self.pool.device_bytes, box.place))
            yield box

    monkeypatch.setattr(BrickVolume, "boxes", noted)
    caster = BrickPyramidCaster(context, resolved, bricks_of(context, resolved, memory, edge=16))
    monkeypatch.undo()
    plain = PyramidCaster(context, resolved, volume=DeviceVolume(context, resolved.volume))
    np.testing.assert_array_equal(context.read(caster.march.map), context.read(plain.march.map))
    np.testing.assert_array_equal(context.read(caster.march.free), context.read(plain.march.free))
    assert len(boxes) > 4 and max(nbytes for _, nbytes, _ in boxes) <= memory
    with pytest.raises(SceneError, match=r"compression.memory: got \d+ bytes, expected at least \d+ bytes for finding"):
        BrickPyramidCaster(context, resolved, bricks_of(context, resolved, pool.memory_for(6), edge=16))


@pytest.mark.parametrize("most", [0, 5_000, 40_000, 10**9])
@pytest.mark.parametrize("halo", [(0, 0), (3, 1), (32, 20)])
def test_boxes_hold_every_voxel_once(most, halo):
    size, row = (70, 113), 24
    seen = np.zeros(size, int)
    least = box_bytes(size, halo, row, 16)
    for place in box_places(size, halo, row, most):
        (y0, z0), (y1, z1), first, last = place.begin, place.end, place.first, place.last
        seen[y0:y1, z0:z1] += 1
        assert (last[0] - first[0]) * (last[1] - first[1]) * row <= max(most, least)
        for axis in range(2):
            assert first[axis] % 16 == 0 and place.begin[axis] % 16 == 0
            assert first[axis] <= max(place.begin[axis] - halo[axis], 0)
            assert last[axis] == min(place.end[axis] + halo[axis], size[axis])
    assert (seen == 1).all()
