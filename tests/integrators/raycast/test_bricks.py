"""Rays through bricks: the picture of a volume in one array, bit for bit, whatever the pool of bricks holds."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.effect_scenes import HAZE, blobs, scaled
from helpers.effect_scenes import scene as effect_scene
from helpers.small_scenes import make_scene, waves
from reference.random_codes import packed, random_codes

from clvol import Camera, TransferFunction, Volume
from clvol.device.brick_pool import CodedBricks, ReadBricks
from clvol.errors import SceneError
from clvol.integrators.raycast.bricks import BrickCaster, BrickVolume
from clvol.integrators.raycast.caster import Raycaster
from clvol.store.codecs.decode import decode_blocks
from clvol.store.geometry import BlockGrid
from clvol.store.volume_blocks import VolumeBlocks

SHAPE = (37, 26, 41)
AMPLE = 1 << 26
SIDE = {"position": [70.0, 45.0, -60.0], "target": [20.0, 12.0, 18.0], "fov_degrees": 30.0}
SHELL = TransferFunction([0.0, 150.0, 170.0, 255.0], [0.0, 0.0, 0.3, 0.6], [[0.9, 0.5, 0.2]] * 4)


def both(context, resolved, memory=AMPLE, edge=8, source=None, **layout):
    """The pictures of the volume in one array and in bricks, and the caster of the second."""
    source = source or ReadBricks(context, VolumeBlocks(resolved.volume, edge))
    caster = BrickCaster(context, resolved, BrickVolume(context, source, memory, **layout))
    image = resolved.image.width, resolved.image.height
    plain = Raycaster(context, resolved).render(resolved.camera, *image)
    return plain, caster.render(resolved.camera, *image), caster


def assert_same(plain, bricks):
    np.testing.assert_array_equal(bricks.rgba, plain.rgba)
    np.testing.assert_array_equal(bricks.depth, plain.depth)
    assert np.ptp(plain.rgba[..., 3]) > 0.01


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int16", "float32"])
@pytest.mark.parametrize("classification", ["pre", "post", "preintegrated"])
def test_every_type_is_the_plain_picture(contexts, each_device, dtype, classification):
    low, high = (-128, 127) if dtype == "int8" else (0, 255)
    function = TransferFunction(SHELL.values + low, SHELL.opacities, SHELL.colors)
    resolved = make_scene(
        waves(SHAPE, dtype, low, high), function, camera=SIDE, classification=classification, width=45, height=39
    )
    plain, bricks, _ = both(contexts(each_device), resolved)
    assert_same(plain, bricks)
    assert 0.5 * plain.samples < bricks.samples <= plain.samples  # none where nothing is visible


@pytest.mark.parametrize("edge", [4, 8, 16, 32])
@pytest.mark.parametrize("pairs", [True, False])
def test_every_edge_and_layout(contexts, device, edge, pairs):
    resolved = make_scene(waves(SHAPE, np.uint8), SHELL, camera=SIDE, width=45, height=39)
    assert_same(*both(contexts(device), resolved, edge=edge, pairs=pairs)[:2])


@pytest.mark.parametrize("shape", [(1, 26, 41), (37, 1, 41), (37, 26, 1), (1, 1, 41), (17, 9, 33), (16, 8, 32)])
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_axes_of_one_voxel_and_whole_bricks(contexts, device, shape, dtype):
    rng = np.random.default_rng(1)
    resolved = make_scene(rng.integers(0, 256, shape).astype(dtype), camera=None, width=45, height=39)
    assert_same(*both(contexts(device), resolved)[:2])


def test_voxels_that_are_not_finite(contexts, each_device):
    array = waves(SHAPE)
    array[3:20, 5:9, 7:30] = np.nan
    array[30, 20, 10], array[8:16, 8:16, 8:16] = np.inf, np.nan
    assert_same(*both(contexts(each_device), make_scene(array, camera=SIDE, width=45, height=39))[:2])


EFFECTS = {
    "nearest": {"integration": {"filter": "nearest"}},
    "catmull-rom": {"integration": {"filter": "catmull-rom"}},
    "cells": {"integration": {"quadrature": "cells", "classification": "preintegrated"}},
    "shaded": {"light": [{"type": "headlight"}], "gradient": {"storage": "on-the-fly"}},
    "sobel": {"light": [{"type": "headlight"}],
              "gradient": {"storage": "on-the-fly", "operator": "sobel"}},
    "surfaces": {"isosurface": [{"value": 120.0, "opacity": 0.5, "color": [1, 0.5, 0.2]}]},
    "clipped": {"clip": [{"type": "sphere", "center": [9, 9, 9], "radius": 9.0}]},
    "maximum": {"integration": {"compositing": "maximum"}},
    "sparse": {"spacing": 2},
}  # fmt: skip


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_effects_are_those_of_the_plain_picture(contexts, device, name, dtype):
    array = blobs((26, 30, 37), top=255, dtype=dtype)
    tables = dict(EFFECTS[name])
    spacing = tables.pop("spacing", 1)
    resolved = effect_scene(array, scaled(HAZE, 255.0), **tables)
    image = resolved.image.model_copy(update={"ray_spacing": spacing})
    resolved = replace(resolved, image=image)
    assert_same(*both(contexts(device), resolved)[:2])


def test_a_pool_that_is_too_small_for_the_frame_renders_groups_of_tiles(contexts, each_device):
    context = contexts(each_device)
    array = np.random.default_rng(2).integers(0, 256, (60, 70, 80)).astype(np.uint8)
    resolved = make_scene(array, width=180, height=140, camera={**SIDE, "position": [190.0, 145.0, -160.0]})
    plain, bricks, ample = both(context, resolved)
    assert_same(plain, bricks)
    assert len(ample.needed) == ample.volume.pool.blocks.count == 8 * 9 * 10
    for share in (0.8, 0.5):
        _, bricks, small = both(context, resolved, ample.volume.pool.memory_for(int(share * len(ample.needed))))
        pool = small.volume.pool
        assert pool.most == int(share * len(ample.needed))
        assert pool.device_bytes <= ample.volume.pool.memory_for(int(share * len(ample.needed)))
        assert_same(plain, bricks)


def test_a_pool_that_does_not_hold_one_tile_says_the_least_memory(contexts, device):
    context = contexts(device)
    array = np.random.default_rng(2).integers(0, 256, (60, 70, 80)).astype(np.uint8)
    resolved = make_scene(array, width=16, height=16)  # one tile
    ample = both(context, resolved)[2]
    memory = ample.volume.pool.memory_for(400)
    source = ReadBricks(context, VolumeBlocks(resolved.volume, 8))
    small = BrickCaster(context, resolved, BrickVolume(context, source, memory))
    with pytest.raises(SceneError, match="400 decoded blocks can be held where the rays of a tile need 720") as raised:
        small.render(resolved.camera, 16, 16)
    least = re.search(r"at least (\d+) bytes", str(raised.value))
    assert least is not None
    plain = Raycaster(context, resolved).render(resolved.camera, 16, 16)
    for memory in (int(least[1]) - ample.volume.pool.brick_bytes, int(least[1])):
        caster = BrickCaster(context, resolved, BrickVolume(context, source, memory))
        if memory == int(least[1]):
            assert_same(plain, caster.render(resolved.camera, 16, 16))
        else:
            with pytest.raises(SceneError):
                caster.render(resolved.camera, 16, 16)


@pytest.mark.parametrize("classification", ["pre", "post", "preintegrated"])
@pytest.mark.parametrize("step", [0.6, 1.2])
def test_blocks_that_show_nothing_need_not_be_there(contexts, device, classification, step):
    """In their place rays would find voxels of other blocks."""
    context = contexts(device)
    array = np.random.default_rng(4).integers(0, 140, (90, 70, 80)).astype(np.uint8)
    array[42:47, 32:37, 36:44] += 100
    resolved = make_scene(array, SHELL, classification=classification, step=step, width=100, height=80)
    plain, bricks, ample = both(context, resolved)
    count = ample.volume.pool.blocks.count
    assert len(ample.needed) < 0.6 * count
    for share in (1.0, 0.95):
        memory = ample.volume.pool.memory_for(int(share * len(ample.needed)))
        plain, bricks, caster = both(context, resolved, memory)
        absent = ~caster.volume.pool.resident(np.arange(count))
        assert absent.sum() >= 0.4 * count
        assert_same(plain, bricks)


def test_only_what_a_view_needs_is_filled_and_nothing_twice(contexts, device):
    context = contexts(device)
    array = np.zeros((64, 64, 64), np.uint8)
    array[4:8, 4:8, 4:8] = 200
    resolved = make_scene(array, SHELL, width=32, height=32)
    _, _, caster = both(context, resolved)
    pool = caster.volume.pool
    assert 0 < len(caster.needed) <= 27
    before = pool.filled_voxels
    caster.render(resolved.camera, 32, 32)
    assert pool.filled_voxels == before
    away = Camera(position=(32, 32, 300), target=(32, 32, 600), up=(0, 1, 0), fov_degrees=30)
    caster.render(away, 32, 32)
    assert pool.filled_voxels == before  # nothing of the volume is in front of the eye


@pytest.mark.parametrize(
    ("codec", "dtype", "shape"),
    [
        ("vq", "uint8", (30, 18, 41)), ("vq-mean", "int16", (30, 18, 41)), ("hvq", "float32", (30, 18, 41)),
        ("rvq", "uint8", (30, 1, 41)), ("rvq", "int16", (1, 18, 33)), ("rvq", "float32", (30, 17, 1)),
    ],
)  # fmt: skip
def test_codes_give_the_picture_of_the_decoded_voxels(contexts, device, codec, dtype, shape):
    context, grid = contexts(device), BlockGrid(shape, 16)
    blocks, codebooks = random_codes(7, codec, 16, dtype, grid.count)
    coded = packed(blocks)
    decoded = decode_blocks(coded, 16, codebooks)
    z, y, x = grid.counts
    array = decoded.reshape(z, y, x, 16, 16, 16).transpose(0, 3, 1, 4, 2, 5).reshape(16 * z, 16 * y, 16 * x)
    finite = array[np.isfinite(array)].astype(float)
    low, high = np.quantile(finite, [0.1, 0.9])
    function = TransferFunction([low, high], [0.0, 0.3], [[0.9, 0.5, 0.2], [0.2, 0.5, 0.9]])
    # What blocks hold beyond the volume is of no consequence.
    volume = Volume(np.ascontiguousarray(array[: shape[0], : shape[1], : shape[2]]))
    resolved = make_scene(volume, function, camera=SIDE, width=45, height=39)
    source = CodedBricks(context, volume, grid, codebooks, coded)
    plain, bricks, caster = both(context, resolved, source=source)
    np.testing.assert_array_equal(bricks.rgba, plain.rgba)
    assert caster.volume.pool.resident(caster.needed).all()
    assert source.nbytes < len(coded.data) + 2 * codebooks.nbytes + 10_000  # entries are held in 16 bits


def test_a_block_that_cannot_be_read_leaves_the_pool_usable(contexts, device):
    context = contexts(device)
    resolved = make_scene(waves(SHAPE, np.uint8), SHELL, camera=SIDE, width=45, height=39)
    inner = ReadBricks(context, VolumeBlocks(resolved.volume, 8))
    broken = SimpleNamespace(on=False)

    def put(blocks, target):
        if broken.on:
            raise OSError("the disk is gone")
        inner.put(blocks, target)

    source = SimpleNamespace(**{**vars(inner), "put": put, "nbytes": 0})
    plain, _, ample = both(context, resolved, source=source)
    caster = BrickCaster(context, resolved, BrickVolume(context, source, ample.volume.pool.memory_for(110)))
    broken.on = True
    with pytest.raises(OSError):
        caster.render(resolved.camera, 45, 39)
    broken.on = False
    assert_same(plain, caster.render(resolved.camera, 45, 39))
