"""Rays through blocks at different resolutions, by the kernels, against the plain twin and against
each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from block_scenes import (
    SHOWN,
    block_picture,
    block_scene,
    noise,
    picture_of,
    random_levels,
    resident,
    twin_of,
)
from reference.clip import kept_stretches
from reference.multiresolution import render_blocks_twin
from small_scenes import rms, waves

from clvol import Camera, TransferFunction, Volume
from clvol.integrators.multiresolution.caster import BlockCaster
from clvol.integrators.multiresolution.visible_error import transparent
from clvol.integrators.raycast.caster import Raycaster
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED
from clvol.store.volume_blocks import VolumeBlocks

SHAPE = (40, 33, 50)
CAMERA = Camera(position=(-55.0, -38.0, -61.0), target=(25.0, 16.0, 20.0), fov_degrees=28.0)
# Of post-classified pictures the tables' rounding, of preintegrated ones their interpolation.
CLOSE = {"post": 2e-5, "preintegrated": 2e-4}


def scene(volume=None, stepping="full", classification="post", interblock=True, **more):
    volume = noise(SHAPE) if volume is None else volume
    settings = {"stepping": stepping, "interblock": interblock}
    more = {"camera": CAMERA, "step": 0.83, **more}
    return block_scene(volume, settings=settings, classification=classification, **more)


def with_settings(resolved, **settings):
    return replace(resolved, multiresolution=resolved.multiresolution.model_copy(update=settings))


def check(data, twin, tolerance: float) -> None:
    """The same where rounding decides nothing: nearly everywhere."""
    assert np.isfinite(data.rgba).all()
    sure = twin.margin > 2e-4
    assert sure.mean() > 0.8
    difference = np.abs(data.rgba - twin.rgba).max(axis=-1)
    assert difference[sure].max() < tolerance
    assert difference.max() < 0.1
    assert abs(data.samples - twin.samples.sum()) <= 1 + 0.002 * data.samples + 40 * (~sure).sum()
    assert twin.rgba[..., 3].max() > 0.3


# ---- against the twin ----


@pytest.mark.parametrize("classification", ("post", "preintegrated"))
@pytest.mark.parametrize("stepping", ("full", "limited", "naive", "bounded"))
def test_pictures_are_the_twins(context, stepping, classification):
    resolved = scene(stepping=stepping, classification=classification)
    resolved = with_settings(resolved, step_error=0.5)
    levels = random_levels(BlockGrid(SHAPE), 3)
    caster = BlockCaster(context, resolved, resident(context, resolved.volume, levels), skip=False)
    most = caster.steps if stepping == "bounded" else None
    assert most is None or len(np.unique(most)) > 2
    twin = render_blocks_twin(resolved, twin_of(resolved.volume, levels), most_steps=most)
    check(picture_of(caster), twin, CLOSE[classification])


def test_without_interblock_interpolation_blocks_are_clamped(context):
    resolved = scene(stepping="limited", interblock=False)
    levels = random_levels(BlockGrid(SHAPE), 4)
    data = block_picture(context, resolved, resident(context, resolved.volume, levels), skip=False)
    twin = render_blocks_twin(resolved, twin_of(resolved.volume, levels))
    check(data, twin, CLOSE["post"])
    assert data.counters == {"block_reads": data.samples, "blended_samples": 0}


@pytest.mark.parametrize("edge", (8, 32))
def test_blocks_of_other_edges(first_device, contexts, edge):
    context = contexts(first_device)
    resolved = scene(stepping="limited", classification="preintegrated")
    levels = random_levels(BlockGrid(SHAPE, edge), 5)
    blocks = resident(context, resolved.volume, levels, edge)
    data = block_picture(context, resolved, blocks, skip=False)
    twin = render_blocks_twin(resolved, twin_of(resolved.volume, levels, edge))
    check(data, twin, CLOSE["preintegrated"])


@pytest.mark.parametrize(
    ("dtype", "holes"), [("int8", 0), ("uint16", 0), ("float32", 0.02), ("float64", 0)]
)
def test_other_types(first_device, contexts, dtype, holes):
    context = contexts(first_device)
    resolved = scene(noise(SHAPE, dtype, holes=holes))
    levels = random_levels(BlockGrid(SHAPE), 6)
    data = block_picture(context, resolved, resident(context, resolved.volume, levels), skip=False)
    twin = render_blocks_twin(resolved, twin_of(resolved.volume, levels))
    difference = np.abs(data.rgba - twin.rgba).max(axis=-1)
    assert twin.rgba[..., 3].max() > 0.02
    if not holes:
        assert difference.max() < CLOSE["post"]
    else:  # next to a hole a sample may or may not use it
        assert np.quantile(difference, 0.9) < CLOSE["post"] and difference.max() < 0.1


@pytest.mark.parametrize("shape", [(1, 30, 25), (25, 1, 1), (17, 16, 15)])
def test_thin_volumes(context, shape):
    volume = noise(shape)
    resolved = block_scene(volume, step=0.37, settings={"stepping": "full"})
    levels = random_levels(BlockGrid(shape), 2)
    data = block_picture(context, resolved, resident(context, volume, levels), skip=False)
    twin = render_blocks_twin(resolved, twin_of(volume, levels))
    np.testing.assert_allclose(data.rgba, twin.rgba, atol=CLOSE["post"])
    assert twin.rgba[..., 3].max() > 0.005


# ---- what changes nothing ----


@pytest.fixture(scope="module")
def sparse() -> Volume:
    """A rough ball in empty space."""
    z, y, x = np.indices((64, 48, 80))
    inside = (z - 30) ** 2 + (y - 22) ** 2 + (x - 45) ** 2 < 16**2
    return Volume(np.where(inside, noise((64, 48, 80)).data // 2 + 100, 0).astype(np.uint8))


BALL = TransferFunction(
    [0, 90, 140, 255],
    [0, 0, 0.08, 0.15],
    [[0.2, 0.5, 1.0], [0.2, 0.5, 1.0], [1.0, 0.8, 0.2], [1.0, 1.0, 1.0]],
)


def dropped_blocks(source) -> np.ndarray:
    return np.concatenate([transparent(part, BALL) for part in source.statistics()])


def ball_scene(sparse, **how):
    camera = Camera(position=(-75.0, -48.0, -81.0), target=(45.0, 22.0, 30.0), fov_degrees=22.0)
    return scene(sparse, function=BALL, camera=camera, **how)


@pytest.mark.parametrize("classification", ("post", "preintegrated"))
def test_leaping_over_empty_space_changes_no_bit_of_full_steps(context, sparse, classification):
    resolved = ball_scene(sparse, classification=classification)
    source = VolumeBlocks(sparse)
    dropped = dropped_blocks(source)
    assert 10 < dropped.sum() < len(dropped) - 10
    for seed in range(5):
        levels = random_levels(source.blocks, seed)
        # Coarse blocks reach far into their neighbours: half of those that could be dropped are
        # not.
        levels[dropped & (np.random.default_rng(seed).random(len(levels)) < 0.5)] = DROPPED
        blocks = resident(context, sparse, levels)
        leaps, walks = (
            block_picture(context, resolved, blocks, skip=skip) for skip in (True, False)
        )
        np.testing.assert_array_equal(leaps.rgba, walks.rgba)
        np.testing.assert_array_equal(leaps.depth, walks.depth)
        assert leaps.samples < 0.9 * walks.samples and leaps.rgba[..., 3].max() > 0.3


def test_leaping_changes_limited_steps_by_less_than_they_are_wrong(first_device, contexts, sparse):
    context = contexts(first_device)
    blocks = resident(context, sparse, random_levels(BlockGrid(sparse.shape), 2))
    full = block_picture(context, ball_scene(sparse), blocks)
    resolved = ball_scene(sparse, stepping="limited")
    leaps, walks = (block_picture(context, resolved, blocks, skip=skip) for skip in (True, False))
    wrong = rms(walks.rgba, full.rgba)
    assert 0 < wrong < 0.02
    assert rms(leaps.rgba, walks.rgba) < 1.5 * wrong and rms(leaps.rgba, full.rgba) < 1.5 * wrong


def test_transparent_blocks_that_are_dropped_do_not_show(context, sparse):
    """Whether there or not: with them all at full resolution what is beside them stays within their
    reach."""
    source = VolumeBlocks(sparse)
    shown = np.zeros(source.blocks.count, np.uint8)
    dropped = dropped_blocks(source)
    fewer = np.where(dropped, DROPPED, shown).astype(np.uint8)
    assert 10 < dropped.sum() < len(dropped)
    resolved = ball_scene(sparse)
    whole, less = (
        block_picture(context, resolved, resident(context, sparse, levels), skip=False)
        for levels in (shown, fewer)
    )
    np.testing.assert_allclose(less.rgba, whole.rgba, atol=1e-5)
    assert whole.rgba[..., 3].max() > 0.3


@pytest.mark.parametrize("classification", ("post", "preintegrated"))
def test_a_ray_in_each_lane_or_one_a_work_item(context, classification):
    resolved = scene(stepping="limited", classification=classification)
    levels = random_levels(BlockGrid(SHAPE), 3)
    blocks = resident(context, resolved.volume, levels)
    one, many = (block_picture(context, resolved, blocks, lanes=n) for n in (1, 16))
    np.testing.assert_allclose(one.rgba, many.rgba, atol=1e-5)
    assert one.samples == many.samples
    reads = one.counters["block_reads"], many.counters["block_reads"]
    assert abs(reads[0] - reads[1]) <= 1e-3 * reads[0]


@pytest.mark.parametrize("stepping", ("full", "limited"))
def test_pixels_are_the_same_in_any_tile_bit_for_bit(context, stepping):
    """Also where packets of rays meet regions of equal levels alone."""
    levels = random_levels(BlockGrid(SHAPE), 3)
    levels[: len(levels) // 2] = 1
    resolved = scene(stepping=stepping)
    blocks = resident(context, resolved.volume, levels)
    pictures = [
        block_picture(context, resolved, blocks, lanes=16, tile=tile)
        for tile in ((16, 16), (4, 12), (8, 100))
    ]
    for other in pictures[1:]:
        np.testing.assert_array_equal(other.rgba, pictures[0].rgba)
        np.testing.assert_array_equal(other.depth, pictures[0].depth)
        assert other.samples == pictures[0].samples and other.counters == pictures[0].counters


def test_several_buffers_give_the_same_picture(first_device, contexts):
    context = contexts(first_device)
    resolved = scene(noise(SHAPE, np.uint16), stepping="limited")
    levels = random_levels(BlockGrid(SHAPE), 8)
    one = resident(context, resolved.volume, levels)
    many = resident(context, resolved.volume, levels, largest_buffer=2 * 9 * 16**3 + 64)
    assert len(one.samples) == 1 and len(many.samples) == 4
    pictures = [block_picture(context, resolved, blocks) for blocks in (one, many)]
    np.testing.assert_allclose(pictures[0].rgba, pictures[1].rgba, atol=1e-6)


# ---- what is known ----


@pytest.mark.parametrize("classification", ("post", "preintegrated"))
def test_at_full_resolution_the_picture_is_the_plain_ray_casters(context, classification):
    volume = Volume(waves(SHAPE, np.uint8))
    resolved = scene(volume, classification=classification)
    blocks = resident(context, volume, np.zeros(BlockGrid(SHAPE).count, np.uint8))
    pictures = [block_picture(context, resolved, blocks)]
    plain = Raycaster(context, resolved).render(resolved.camera, 24, 20)
    np.testing.assert_allclose(pictures[0].rgba, plain.rgba, atol=1e-5)
    np.testing.assert_allclose(pictures[0].depth, plain.depth, rtol=1e-4)
    if classification == "preintegrated":
        # One table slice a power of two of steps more, the same entries.
        pictures += [block_picture(context, with_settings(resolved, stepping="limited"), blocks)]
        np.testing.assert_allclose(pictures[1].rgba, pictures[0].rgba, atol=1e-5)
        assert pictures[1].samples == pictures[0].samples


@pytest.mark.parametrize("classification", ("post", "preintegrated"))
@pytest.mark.parametrize("stepping", ("full", "limited", "naive", "bounded"))
def test_a_constant_mediums_opacity_is_right_for_segments_of_any_length(
    context, stepping, classification
):
    volume = Volume(np.full(SHAPE, 140, np.uint8))
    resolved = scene(volume, stepping, classification)
    levels = random_levels(BlockGrid(SHAPE), 9)
    data = block_picture(context, resolved, resident(context, volume, levels))
    rays = resolved.camera.world_rays(24, 20)
    kept = kept_stretches(volume.grid, (), *(part.reshape(-1, 3) for part in rays))
    hit = np.isfinite(kept.enter)
    length = np.zeros(hit.shape)
    length[hit] = kept.leave[hit] - kept.enter[hit]
    length = length.reshape(20, 24)
    expected = -np.expm1(length * np.log1p(-0.05))
    np.testing.assert_allclose(data.rgba[..., 3], expected, atol=5e-6)
    np.testing.assert_allclose(data.rgba[..., :3], expected[..., None] * SHOWN.colors[2], atol=5e-6)


@pytest.mark.parametrize(("stepping", "most"), [("full", 1.0), ("limited", 1.0), ("bounded", 1.0)])
def test_steps_go_no_farther_than_the_first_step_in_the_next_block(stepping, most):
    """Naive ones do."""
    resolved = scene(stepping=stepping)
    levels = random_levels(BlockGrid(SHAPE), 3)
    field = twin_of(resolved.volume, levels)
    steps = np.full(len(levels), 255)
    twin = render_blocks_twin(resolved, field, most_steps=steps)
    assert twin.overshoot.max() <= most + 1e-9
    assert render_blocks_twin(resolved, field, stepping="naive").overshoot.max() > 3.0


def test_coarse_blocks_take_fewer_samples(first_device, contexts):
    context = contexts(first_device)
    resolved, count = scene(classification="preintegrated"), BlockGrid(SHAPE).count
    taken: dict[str, list] = {name: [] for name in ("full", "limited", "naive")}
    for level in range(5):
        blocks = resident(context, resolved.volume, np.full(count, level, np.uint8))
        for stepping in taken:
            data = block_picture(
                context, with_settings(resolved, stepping=stepping), blocks, skip=False
            )
            reads, blended = data.counters["block_reads"], data.counters["blended_samples"]
            # At most seven others have a share in a sample.
            assert data.samples + blended <= reads <= data.samples + 7 * blended
            taken[stepping].append(data.samples)
    assert len(set(taken["full"])) == 1
    assert taken["limited"][0] == taken["naive"][0] == taken["full"][0]
    for fewer in ("limited", "naive"):
        assert (np.diff(taken[fewer]) < 0).all()
        assert taken[fewer][3] < 0.35 * taken[fewer][0]
    assert all(n <= m for n, m in zip(taken["naive"], taken["limited"]))
