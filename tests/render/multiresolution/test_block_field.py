"""The field of blocks at different resolutions: what interblock interpolation promises, in numpy
and by the kernels."""

from __future__ import annotations

import numpy as np
import pytest
from block_scenes import noise, random_levels, random_places, resident, twin_of, values_at
from reference.multiresolution import BlockField
from scipy.ndimage import map_coordinates

from clvol import Volume
from clvol.store.geometry import BlockGrid
from clvol.store.resolutions import region_level
from clvol.store.source import DROPPED
from clvol.store.volume_blocks import VolumeBlocks

SHAPES = [(40, 33, 50), (1, 35, 20), (17, 1, 33), (16, 32, 48)]
RANGE = 255.0


def level_samples(data, grid: BlockGrid, level: int) -> np.ndarray:
    return region_level(data, grid, level, (0, 0, 0), grid.counts).astype(np.float64)


# ---- the definition ----


@pytest.mark.parametrize("edge", (8, 16))
@pytest.mark.parametrize("shape", SHAPES)
def test_equal_levels_give_trilinear_interpolation_of_all_samples(shape, edge):
    volume, grid = noise(shape), BlockGrid(shape, edge)
    p = random_places(grid, 2000, 5).astype(np.float64)
    for level in range(grid.levels - 1):
        field = twin_of(volume, np.full(grid.count, level, np.uint8), edge)
        at = (p / (1 << level) - 0.5).T[::-1]
        samples = level_samples(volume.data, grid, level)
        expected = map_coordinates(samples, at, order=1, mode="nearest")
        np.testing.assert_allclose(field(p), expected, atol=1e-9)


@pytest.mark.parametrize("level", range(5))
def test_linear_ramps_stay_linear_inside_the_hull_of_all_samples(level):
    shape = (32, 48, 64)
    z, y, x = np.indices(shape) + 0.5
    volume = Volume(3.0 * x - 2.0 * y + 0.5 * z)
    grid = BlockGrid(shape)
    field = twin_of(volume, np.full(grid.count, level, np.uint8))
    half = 0.5 * (1 << level)
    rng = np.random.default_rng(1)
    p = half + rng.random((3000, 3)) * (np.array(shape[::-1]) - 2 * half)
    np.testing.assert_allclose(field(p), p @ [3.0, -2.0, 0.5], atol=1e-9)


def sides(field: BlockField, count: int, apart: float, seed: int, centres: bool):
    """Places [2, count, 3] ``apart`` from each other on either side of a block's face, edge or
    corner (``centres``: of the planes through blocks' centres), and elsewhere anywhere."""
    rng = np.random.default_rng(seed)
    grid = field.grid
    counts, upper = np.array(grid.counts[::-1]), np.array(grid.shape[::-1]) - 0.5
    p = 0.5 + rng.random((count, 3)) * (upper - 0.5)
    across = rng.random((count, 3)) < rng.choice([0.4, 0.9], (count, 1))
    if centres:
        plane = grid.edge * (rng.integers(0, counts, (count, 3)) + 0.5)
        across &= counts * grid.edge - grid.edge / 2 < upper
    else:
        plane = grid.edge * rng.integers(1, np.maximum(counts, 2), (count, 3)).astype(float)
        across &= counts > 1
    p = np.where(across, plane, p)
    away = 0.5 * apart * rng.choice([-1.0, 1.0], (count, 3)) * across
    return p - away, p + away


@pytest.mark.parametrize("centres", (False, True))
@pytest.mark.parametrize("edge", (8, 16))
def test_the_field_is_continuous_across_faces_edges_and_corners_of_any_levels(edge, centres):
    """Whatever the levels, values 1e-10 voxels apart differ by at most 1e-8 of the range (a slope
    of 100 ranges a voxel; the noise itself has 1): any seam would show. Without interpolation
    between blocks they do differ."""
    shape = (4 * edge, 3 * edge, 5 * edge)
    volume = noise(shape)
    for seed in range(4):
        field = twin_of(volume, random_levels(BlockGrid(shape, edge), seed), edge)
        a, b = sides(field, 4000, 1e-10, seed, centres)
        assert np.abs(field(a) - field(b)).max() < 1e-8 * RANGE
        if not centres:
            assert np.abs(field(a, False) - field(b, False)).max() > 0.5 * RANGE


def test_dropped_blocks_break_continuity_between_no_others():
    """Across faces of blocks that are not dropped, whatever is beside them. Next to a dropped one
    the field is as steep as 2^-15 of a block makes it."""
    shape = (64, 48, 80)
    volume = noise(shape)
    for seed in range(4):
        field = twin_of(volume, random_levels(BlockGrid(shape), seed, dropped=0.4))
        a, b = sides(field, 8000, 1e-10, seed, False)
        kept = [field.levels[field.number(field.block_at(p))] != DROPPED for p in (a, b)]
        kept = kept[0] & kept[1]
        assert kept.sum() > 1000
        assert np.abs(field(a) - field(b))[kept].max() < 1e-10 * 2**15 * RANGE


def test_constant_blocks_may_have_one_sample_beside_full_resolution():
    """With no others coarse nothing changes. P2's weights reach up to half a block from there."""
    data = noise((48, 48, 64)).data.copy()
    data[16:32, 16:32, 16:32], data[:16, 16:32, 48:] = 40, 200
    volume = Volume(data)
    levels = np.zeros(BlockGrid(data.shape).count, np.uint8)
    full = twin_of(volume, levels)
    constant = full.number(np.array([[1, 1, 1], [3, 1, 0]]))
    levels[constant] = 4
    coarse = twin_of(volume, levels)
    p = random_places(full.grid, 16000, 9).astype(np.float64)
    np.testing.assert_allclose(coarse(p), full(p), atol=1e-9)
    assert np.abs(coarse(p, "p2") - full(p, "p2")).max() > 0.1 * RANGE


@pytest.mark.parametrize("level", range(5))
def test_the_field_fades_to_a_dropped_blocks_value_before_its_face(level):
    """In the middle of the face: but for the 2^-15 of a block that stands for half its sample."""
    volume = noise((16, 16, 32))
    field = twin_of(volume, np.array([level, DROPPED], np.uint8))
    rest = np.full((9, 2), 8.0)
    rest[1:] += np.random.default_rng(1).uniform(-3, 3, (8, 2))
    face = np.column_stack([np.full(9, 16.0 - 1e-9), rest])
    share = 2.0**-15 * 2 * (16 >> level)
    assert np.abs(field(face) - field.means[1]).max() <= share * RANGE
    beyond = face + [1e-6, 0, 0]
    np.testing.assert_array_equal(field(beyond), field.means[1])


def test_inside_the_hull_of_its_samples_a_block_is_alone():
    volume, shape = noise((48, 48, 48)), (48, 48, 48)
    field = twin_of(volume, random_levels(BlockGrid(shape), 3, dropped=0.2))
    p = random_places(field.grid, 20000, 2).astype(np.float64)
    block = field.block_at(p)
    half = 0.5 * field.sample_edge[field.number(block)][:, None]
    inside = ((p - 16 * block >= half) & (p - 16 * block <= 16 - half)).all(axis=1)
    blocks, weights = field.weights(p[inside])
    assert inside.sum() > 1000
    np.testing.assert_array_equal(weights, np.broadcast_to(np.eye(8)[0], weights.shape))
    np.testing.assert_array_equal(field(p[inside]), field.in_block(block[inside], p[inside]))


def test_weights_are_shares_and_fall_to_0_at_the_own_hull():
    field = twin_of(noise((48, 48, 48)), random_levels(BlockGrid((48, 48, 48)), 4, dropped=0.2))
    p = random_places(field.grid, 20000, 3).astype(np.float64)
    for p2 in (False, True):
        blocks, weights = field.weights(p, p2)
        assert (weights >= 0).all()
        np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert (weights[:, 1:] > 0).any()


def test_p2_counts_a_coarse_block_inside_the_hull_of_a_fine_ones_samples_and_we_do_not():
    """A fine block and three coarse ones meet at an edge: there the one beyond the edge has weight
    by P2's product of the e from the other two to it, however far the place is inside the fine
    one's samples."""
    volume = noise((16, 32, 32))
    field = twin_of(volume, np.array([0, 4, 4, 4], np.uint8))
    place = np.array([[14.0, 14.0, 8.0]])  # a voxel and a half inside block 0's outermost samples
    _, ours = field.weights(place)
    _, theirs = field.weights(place, p2=True)
    assert ours[0, 3] == 0.0 and theirs[0, 3] > 0.05
    assert field(place)[0] == field(place, False)[0] != field(place, "p2")[0]


def test_p2s_weights_are_ours_where_all_levels_are_equal():
    volume, shape = noise((32, 48, 48)), (32, 48, 48)
    for level in range(5):
        field = twin_of(volume, np.full(BlockGrid(shape).count, level, np.uint8))
        p = random_places(field.grid, 2000, level).astype(np.float64)
        np.testing.assert_array_equal(field.weights(p)[1], field.weights(p, p2=True)[1])


# ---- the kernels ----

_TYPES = [("uint8", 0.0, 16), ("uint8", 0.0, 1), ("int16", 0.0, 16), ("float32", 0.02, 16),
          ("float32", 0.02, 1)]  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("dtype", "holes", "lanes"), _TYPES)
def test_kernels_give_the_definitions_values(context, dtype, holes, lanes, shape):
    """Where a place's own block, or one that is blended in, has a hole that is used, both are
    NaN."""
    volume = noise(shape, dtype, holes=holes)
    for edge, seed in ((16, 1), (8, 2)):
        levels = random_levels(BlockGrid(shape, edge), seed, dropped=0.15)
        blocks, field = resident(context, volume, levels, edge), twin_of(volume, levels, edge)
        p = random_places(field.grid, 8192, seed)
        for interblock in (False, True):
            found, _ = values_at(context, blocks, p, interblock, lanes)
            expected = field(p.astype(np.float64), interblock)
            np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
            np.testing.assert_allclose(found, expected, atol=1e-5 * RANGE)


@pytest.mark.parametrize("buffers", (2, 4))
def test_kernels_find_blocks_in_any_buffer(context, buffers):
    shape = (48, 48, 64)
    volume = noise(shape, np.uint16)
    levels = random_levels(BlockGrid(shape), 5, dropped=0.1)
    levels[::3] = 0
    bytes_a_buffer = 2 * 16**3 * -(-36 // buffers) + 64
    blocks = resident(context, volume, levels, largest_buffer=bytes_a_buffer)
    assert len(blocks.samples) == buffers
    used = context.read(blocks.index)[:, 1]
    assert set(used[used & 15 > 1][used[used & 15 > 1] & 15 < 15] >> 4 & 3) >= {0, 1}
    field = twin_of(volume, levels)
    p = random_places(field.grid, 8192, 1)
    found, _ = values_at(context, blocks, p)
    np.testing.assert_allclose(found, field(p.astype(np.float64)), atol=1e-5 * RANGE)


def test_constants_are_exact_at_any_levels(context):
    shape = (40, 33, 50)
    volume = Volume(np.full(shape, 77, np.uint8))
    for seed in range(3):
        levels = random_levels(BlockGrid(shape), seed, dropped=0.2)
        p = random_places(BlockGrid(shape), 8192, seed)
        np.testing.assert_allclose(twin_of(volume, levels)(p.astype(np.float64)), 77.0, rtol=1e-15)
        found, _ = values_at(context, resident(context, volume, levels), p)
        np.testing.assert_array_equal(found, 77.0)


@pytest.mark.parametrize("lanes", (1, 16))
def test_kernels_count_what_they_read(context, lanes):
    volume, shape = noise((40, 33, 50)), (40, 33, 50)
    levels = random_levels(BlockGrid(shape), 7, dropped=0.1)
    blocks, field = resident(context, volume, levels), twin_of(volume, levels)
    p = random_places(field.grid, 8192, 4)
    own = field.levels[field.number(field.block_at(p.astype(np.float64)))] == DROPPED
    _, weights = field.weights(p.astype(np.float64))
    others = (weights[:, 1:] > 0).sum(axis=1) * ~own
    _, (reads, blended) = values_at(context, blocks, p, lanes=lanes)
    # A weight next to 0 may be rounded to it.
    assert abs(int(reads) - len(p) - others.sum()) <= 1e-3 * others.sum()
    assert abs(int(blended) - np.count_nonzero(others)) <= 1e-3 * len(p)
    _, (reads, blended) = values_at(context, blocks, p, interblock=False, lanes=lanes)
    assert (reads, blended) == (len(p), 0)


@pytest.mark.parametrize("seed", range(2))
def test_the_kernels_field_has_no_seams(context, seed):
    """Places 1e-3 apart across faces: no more than a slope of 10 ranges a voxel allows, and
    float32's rounding."""
    shape = (64, 48, 80)
    volume, levels = noise(shape), random_levels(BlockGrid(shape), seed)
    field = twin_of(volume, levels)
    a, b = (p.astype(np.float32) for p in sides(field, 4096, 1e-3, seed, False))
    blocks = resident(context, volume, levels)
    found = [values_at(context, blocks, p)[0] for p in (a, b)]
    apart = np.abs(a - b).astype(np.float64).sum(axis=1)
    assert (np.abs(found[0] - found[1]) <= RANGE * (10.0 * apart + 1e-5)).all()


def test_a_block_source_and_plain_arrays_make_the_same_field():
    volume, shape = noise((33, 20, 40)), (33, 20, 40)
    levels = random_levels(BlockGrid(shape), 1)
    source = VolumeBlocks(volume)
    by_level = [source.read(k, np.flatnonzero(levels == k)) for k in range(4)]
    means = [volume.data[:16, :16, :16].mean()]
    means += list(BlockField.of(source, levels).means[1:])
    p = random_places(source.blocks, 512, 1).astype(np.float64)
    a, b = BlockField.of(source, levels), BlockField(source.blocks, levels, by_level, means)
    np.testing.assert_array_equal(a(p), b(p))
