"""Blocks that stay on the device as codes: the pictures of decoded ones, bit for bit, whatever the pool holds."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.block_scenes import means_of
from helpers.coded_sources import RandomCodes
from helpers.small_scenes import make_scene

from clvol import TransferFunction
from clvol.errors import RenderError, SceneError
from clvol.integrators.multiresolution import loader
from clvol.integrators.multiresolution.caster import BlockCaster
from clvol.integrators.multiresolution.code_choices import choices_of, cut_sizes
from clvol.integrators.multiresolution.coded_caster import CodedBlockCaster
from clvol.integrators.multiresolution.coded_residency import CodedResidency
from clvol.integrators.multiresolution.coded_source import codes_at
from clvol.integrators.multiresolution.device_blocks import DeviceBlocks
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.multiresolution.resident_codes import ResidentCodes, Wanted
from clvol.scene.multiresolution import Multiresolution
from clvol.store.codecs.coded_blocks import WHOLE, CodedBlocks
from clvol.store.codecs.decode import decode_blocks
from clvol.store.source import DROPPED

AMPLE = 1 << 26
CAMERA = {"position": [90.0, 60.0, -80.0], "target": [24.0, 18.0, 20.0], "fov_degrees": 30.0}


def function_of(source) -> TransferFunction:
    finite = source.volume.data[np.isfinite(source.volume.data)].astype(float)
    low, middle, high = np.quantile(finite, [0.1, 0.5, 0.9])
    colors = [[0.1, 0.2, 0.8], [0.2, 0.9, 0.4], [0.9, 0.6, 0.2]]
    return TransferFunction([low, max(middle, low + 1e-3), max(high, low + 2e-3)], [0.0, 0.1, 0.4], colors)


def scene_of(source, memory=AMPLE, size=(70, 52), **settings):
    resolved = make_scene(source.volume, function_of(source), camera=CAMERA, width=size[0], height=size[1])
    return replace(resolved, multiresolution=Multiresolution(memory=memory, **settings))


def random_wanted(source, seed=3, full=0.5) -> Wanted:
    """Blocks at random levels and depths, some dropped."""
    rng, grid = np.random.default_rng(seed), source.blocks
    level = np.where(rng.random(grid.count) < full, 0, rng.integers(0, grid.levels, grid.count))
    level = np.where(rng.random(grid.count) < 0.1, DROPPED, level).astype(np.uint8)
    depth = np.where(level == 0, rng.integers(0, source.codebooks.stages + 2, grid.count), WHOLE)
    depth = np.where(depth > source.codebooks.stages, WHOLE, depth)
    size = np.zeros(grid.count, np.int64)
    for each in range(grid.levels - 1):
        own = np.flatnonzero(level == each)
        size[own] = codes_at(source, each, own).size
    stages = source.codebooks.stages
    cut = cut_sizes(source.read_codes(0, np.arange(grid.count)), grid.edge, source.codebooks, list(range(stages + 1)))
    is_cut = (level == 0) & (depth < WHOLE)
    size = np.where(is_cut, cut[np.minimum(depth, stages), range(grid.count)], size)
    return Wanted(level, depth, size)


class WithoutCodes:
    """A source that gives samples alone."""

    def __init__(self, source) -> None:
        for name in ("name", "grid", "blocks", "dtype", "value_range", "nan_count", "inf_count", "read", "statistics"):
            setattr(self, name, getattr(source, name))


def picture_of_samples(context, source, wanted, resolved):
    """By blocks of samples, which are cut as wanted."""
    source.depths = wanted.depth
    blocks = DeviceBlocks(context, WithoutCodes(source), AMPLE)
    blocks.load(wanted.level, means_of(source))
    blocks.commit()
    source.depths = None
    frame = BlockCaster(context, resolved, blocks).render(resolved.camera, resolved.image.width, resolved.image.height)
    blocks.close()
    return frame


def picture_of_codes(context, source, wanted, resolved, pool):
    blocks = ResidentCodes(context, source, AMPLE)
    blocks.set_codes(wanted, means_of(source), pool)
    caster = CodedBlockCaster(context, resolved, blocks)
    blocks.take_decoded()
    return caster.render(resolved.camera, resolved.image.width, resolved.image.height), blocks


def assert_same(frame, other):
    np.testing.assert_array_equal(frame.rgba, other.rgba)
    np.testing.assert_array_equal(frame.depth, other.depth)
    assert frame.samples == other.samples and frame.counters == other.counters


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
def test_every_type_on_every_device(contexts, each_device, dtype):
    context, source = contexts(each_device), RandomCodes((45, 38, 51), dtype)
    resolved, wanted = scene_of(source), random_wanted(source)
    frame, _ = picture_of_codes(context, source, wanted, resolved, AMPLE)
    assert_same(frame, picture_of_samples(context, source, wanted, resolved))
    assert np.ptp(frame.rgba[..., 3]) > 0.01


@pytest.mark.parametrize("stepping", ["full", "limited", "naive", "bounded"])
@pytest.mark.parametrize("interblock", [True, False])
def test_pools_of_every_size_give_the_same_picture(contexts, device, stepping, interblock):
    context, source = contexts(device), RandomCodes((60, 70, 90), "uint8", edge=8)
    resolved = scene_of(source, stepping=stepping, interblock=interblock, size=(140, 110))
    wanted = random_wanted(source, full=0.8)
    samples = picture_of_samples(context, source, wanted, resolved)
    whole = 0
    for share in (1.0, 0.6, 0.35):
        size = int(share * (whole or AMPLE))
        frame, blocks = picture_of_codes(context, source, wanted, resolved, size)
        whole = whole or int(blocks.sample_bytes(wanted.level).sum())
        assert blocks.pool_bytes <= size and blocks.used_bytes <= blocks.pool_bytes
        assert_same(replace(frame, counters=samples.counters), samples)
        assert blocks.take_decoded() > 0 or share == 1.0  # some of it again


@pytest.mark.parametrize("mode", ["maximum", "average"])
def test_projections(contexts, device, mode):
    """Rays look at the bounds of all blocks, which the pool does not hold at a time."""
    context, source = contexts(device), RandomCodes((60, 70, 90), "uint8", edge=8)
    resolved = scene_of(source, size=(140, 110))
    resolved = replace(resolved, integration=resolved.integration.model_copy(update={"compositing": mode}))
    wanted = random_wanted(source, full=0.8)
    samples = picture_of_samples(context, source, wanted, resolved)
    assert np.ptp(samples.rgba[..., 3]) > 0.01
    whole = 0
    for share in (1.0, 0.4):
        frame, blocks = picture_of_codes(context, source, wanted, resolved, int(share * (whole or AMPLE)))
        whole = int(blocks.sample_bytes(wanted.level).sum())
        assert_same(frame, samples)
        assert blocks.take_decoded() > 0 or share == 1.0


@pytest.mark.parametrize("shape", [(1, 38, 51), (33, 1, 51), (33, 38, 1), (17, 9, 33), (16, 16, 16)])
def test_blocks_repeat_the_volume_s_last_samples(contexts, device, shape):
    context, source = contexts(device), RandomCodes(shape, "uint8")
    wanted = replace(random_wanted(source), level=np.zeros(source.blocks.count, np.uint8))
    resolved = replace(scene_of(source), camera=make_scene(source.volume).camera)
    wanted = Wanted(wanted.level, np.full(source.blocks.count, WHOLE), np.full(source.blocks.count, 1 << 20))
    frame, _ = picture_of_codes(context, source, wanted, resolved, AMPLE)
    assert_same(frame, picture_of_samples(context, source, wanted, resolved))


def test_a_pool_too_small_for_a_tile_is_an_error(contexts, device):
    context, source = contexts(device), RandomCodes((60, 70, 90), "uint8", edge=8)
    wanted, resolved = random_wanted(source, full=1.0), scene_of(source, size=(16, 16))
    with pytest.raises(SceneError, match="multiresolution.memory: .* bytes of decoded blocks, where a tile needs"):
        picture_of_codes(context, source, wanted, resolved, 27 * 512 + 100)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
def test_blocks_of_samples_are_staged_as_codes(contexts, each_device, dtype):
    """What crosses the bus are codes; what is held are the samples that they stand for."""
    context, source = contexts(each_device), RandomCodes((45, 38, 51), dtype)
    resolved, levels = scene_of(source), random_wanted(source).level
    size = resolved.image.width, resolved.image.height
    frames = []
    for each in (source, WithoutCodes(source)):
        blocks = DeviceBlocks(context, each, AMPLE)
        blocks.load(levels, means_of(source))
        blocks.commit()
        frames.append(BlockCaster(context, resolved, blocks).render(resolved.camera, *size))
        blocks.close()
    assert_same(*frames)


def test_samples_of_levels_with_codes_are_not_read(contexts, device):
    source = RandomCodes((45, 38, 51), "uint8")
    blocks = DeviceBlocks(contexts(device), source, AMPLE)
    read, source.read = [], lambda level, numbers: pytest.fail("samples were read")
    source.read_codes = lambda level, numbers, own=source.read_codes: read.append(level) or own(level, numbers)
    levels = np.arange(source.blocks.count) % 3
    blocks.load(levels, means_of(WithoutCodes(source)))
    blocks.close()
    assert set(read) == {0, 1, 2}


def test_an_unknown_codec_is_an_error_and_writes_the_block(contexts, device, monkeypatch):
    context, source = contexts(device), WithoutCodes(RandomCodes((16, 16, 16), "uint8", seed=2))
    monkeypatch.setattr(loader, "RAW", 7)
    monkeypatch.setattr(loader, "CONSTANT", 7)
    blocks = DeviceBlocks(context, source, AMPLE)
    context.write(blocks.samples[0], np.full(blocks.samples[0].shape, 99, np.uint8))
    with pytest.raises(RenderError, match="blocks of codec 7"):
        blocks.load(np.zeros(1, np.uint8), np.zeros(1))
    assert (context.read(blocks.samples[0])[: 16**3] == 0).all()
    blocks.close()


# Choices


def test_bytes_and_deviations_of_depths_are_those_of_prefixes(contexts, device):
    source = RandomCodes((33, 20, 40), "int16", seed=5)
    found = choices_of(contexts(device), source, 1 << 15)
    blocks = np.arange(source.blocks.count)
    coded = source.read_codes(0, blocks)
    whole = decode_blocks(coded, 16, source.codebooks).astype(float)
    assert found.level.tolist() == [0] * 7 + [1, 2, 3, 4]
    assert found.depth.tolist() == [WHOLE, 5, 4, 3, 2, 1, 0] + [WHOLE] * 4
    for k, depth in enumerate(found.depth[:7]):
        cut = CodedBlocks(coded.data, coded.start, found.size[k])
        voxels = decode_blocks(cut, 16, source.codebooks, int(depth)).astype(float)  # needs no more bytes
        expected = np.sqrt(((voxels - whole) ** 2).mean(axis=(1, 2, 3)))
        np.testing.assert_allclose(found.deviation[k], expected, rtol=1e-5)
    assert (np.diff(found.size[:7], axis=0) <= 0).all()
    assert (found.size[-1] == 0).all() and (found.size[7:10] > 0).all()


# Residency


def test_a_budget_is_kept_and_more_memory_shows_more(contexts, device):
    context, source = contexts(device), RandomCodes((60, 70, 90), "uint8", stages=3)
    errors, least = [], least_memory(context, source)
    for memory in (least, 4 * least, 20 * least):
        resolved = scene_of(source, memory=memory, size=(140, 110))
        residency = CodedResidency(context, source, resolved)
        residency.ask(resolved)
        caster = CodedBlockCaster(context, resolved, residency.blocks)
        caster.render(resolved.camera, 140, 110)
        found = residency.describe()
        assert found["bytes_on_device"] + 3 * caster.distances.nbytes <= memory
        assert sum(found["levels"]) + found["dropped"] == source.blocks.count
        assert sum(found["depths"]) == found["levels"][0]
        errors.append(found["estimated_error"])
        assert not residency.ask(resolved)  # the same again
    assert errors[0] > errors[1] >= errors[2] >= 0.0


def test_another_view_has_the_picture_of_its_own_blocks(contexts, device):
    """Its samples are decoded into another pool."""
    context, source = contexts(device), RandomCodes((60, 70, 90), "uint8", stages=3)
    resolved = scene_of(source, memory=2 * least_memory(context, source), size=(140, 110))
    camera = resolved.camera.model_copy(update={"position": (-60.0, 90.0, 50.0)})
    engine = MultiresolutionEngine(context, resolved, CodedResidency(context, source, resolved))
    engine.render(resolved.camera, 140, 110)
    found = engine.render(camera, 140, 110)
    afresh = MultiresolutionEngine(context, resolved, CodedResidency(context, source, resolved))
    np.testing.assert_array_equal(found.rgba, afresh.render(camera, 140, 110).rgba)
    assert engine.residency.generation > 1


def least_memory(context, source) -> int:
    resolved = scene_of(source, memory=20_000, size=(140, 110))
    with pytest.raises(SceneError, match=r"multiresolution.memory: .* at least \d+ bytes") as raised:
        CodedResidency(context, source, resolved).ask(resolved)
    return int(re.search(r"at least (\d+) bytes", str(raised.value))[1])


def test_too_little_memory_says_how_much_would_do(contexts, device):
    context, source = contexts(device), RandomCodes((60, 70, 90), "uint8", stages=3)
    again = scene_of(source, memory=least_memory(context, source), size=(140, 110))
    residency = CodedResidency(context, source, again)
    residency.ask(again)
    CodedBlockCaster(context, again, residency.blocks).render(again.camera, 140, 110)
