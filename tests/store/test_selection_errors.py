"""What a transfer function makes of blocks' statistics."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol import TransferFunction, Volume
from clvol.integrators.multiresolution import visible_error
from clvol.integrators.multiresolution.luv import delta_e_luv, linear_to_luv
from clvol.integrators.multiresolution.selection import exact_levels, level_costs, select_levels
from clvol.integrators.multiresolution.visible_error import ShownColors, block_errors, block_transmittances, transparent
from clvol.readers import load_volume
from clvol.store.resolutions import reduced
from clvol.store.source import BlockStatistics
from clvol.store.volume_blocks import VolumeBlocks
from clvol.transfer import preset

BRAIN = Path(__file__).parents[2] / "data" / "brainsmall.nrrd"
BLACK = np.zeros(3)
RAMP = TransferFunction([0.0, 255.0], [0.0, 0.5], [[0.1, 0.2, 0.3], [1.0, 0.9, 0.4]], 8.0)


def joined(source: VolumeBlocks) -> BlockStatistics:
    """All parts' statistics as one."""
    parts = list(source.statistics())
    found = {}
    for field in fields(BlockStatistics):
        arrays = [getattr(part, field.name) for part in parts]
        found[field.name] = 0 if field.name == "first" else np.concatenate(
            arrays, axis=0 if arrays[0].ndim == 1 else 1
        )  # fmt: skip
    return BlockStatistics(**found)


def statistics_of(array: np.ndarray, edge: int = 16) -> BlockStatistics:
    return joined(VolumeBlocks(Volume(array), edge))


def reaching(low, high) -> BlockStatistics:
    low, high = np.atleast_1d(np.float64(low)), np.atleast_1d(np.float64(high))
    n = len(low)
    none = np.zeros((5, n))
    return BlockStatistics(
        0, none, none, none, np.zeros((5, n, 8), np.float32), none, low, high, np.zeros(n, bool)
    )


def shown_directly(function, values, path, background) -> np.ndarray:
    """L*, u*, v* behind ``path`` of ``values``, without a table."""
    alpha = -np.expm1(-function.extinction(values) * path)[..., None]
    return linear_to_luv(function.color(values) * alpha + background * (1 - alpha))


def voxel_errors(statistics, function, path, background) -> np.ndarray:
    """[levels, n]: the voxels' part of ``block_errors``, before it counts a tenth."""
    parts = (getattr(statistics, name) for name in ("quantiles", "minimum", "maximum", "deviation"))
    return visible_error._estimate(*parts, ShownColors(function, path, background))


def mixed_directly(function, values, path, background) -> np.ndarray:
    """L*, u*, v* behind a sixteenth of ``path`` in the mean medium of all ``values``."""
    values = np.ravel(values)
    extinction = function.extinction(values)
    emission = (function.color(values) * extinction[:, None]).mean(axis=0)
    alpha = -np.expm1(-extinction.mean() * path / 16)
    shown = emission / extinction.mean() * alpha + np.asarray(background) * (1 - alpha)
    return linear_to_luv(shown)


@st.composite
def stepped_functions(draw):
    """Points at whole numbers, some of them twice, most of them transparent."""
    values = sorted(draw(st.lists(st.integers(0, 9), min_size=1, max_size=7)))
    values = [v for i, v in enumerate(values) if i < 2 or values[i - 2] != v]
    opacities = [draw(st.sampled_from([0.0, 0.0, 0.0, 0.5])) for _ in values]
    return TransferFunction(np.array(values, float), opacities, np.ones((len(values), 3)))


@settings(max_examples=400, deadline=None)
@given(stepped_functions(), st.integers(-2, 22), st.integers(0, 12))
def test_transparent_is_exact(function, low, span):
    low, high = low / 2, (low + span) / 2
    inside = np.linspace(low, high, 40 * span + 1)
    near = [np.nextafter(v, to) for v in function.values for to in (-np.inf, np.inf)]
    seen = np.concatenate([inside, function.values, near])
    seen = seen[(seen >= low) & (seen <= high)]
    expected = not (function.opacity(seen) > 0).any()
    if expected and low < high:
        # One float beside a point may be rounded to nothing, half a unit away is not.
        beside = np.clip(seen[:, None] + [-0.25, 0.25], low, high)
        expected = not (function.opacity(beside) > 0).any()
    assert bool(transparent(reaching(low, high), function)[0]) is expected


def test_the_sides_of_a_step_count_where_they_are_reached():
    function = TransferFunction([1.0, 1.0, 2.0, 2.0], [0.0, 0.5, 0.5, 0.0], np.ones((4, 3)))
    low, high = [0, 0, 1, 1.5, 2, 2, 1], [0.5, 1, 1, 1.5, 2, 9, 2]
    expected = [True, False, False, False, True, True, False]
    assert transparent(reaching(low, high), function).tolist() == expected


def test_blocks_without_a_finite_voxel_are_transparent():
    opaque = TransferFunction([0.0], [1.0], np.ones((1, 3)))
    array = np.ones((16, 16, 48), np.float32)
    array[:, :, 15:] = np.nan  # the middle block's reach holds finite ones, the last block's none
    array[:, :, 15:32] = 1.0
    array[:, :, 31:] = np.nan
    assert transparent(statistics_of(array), opaque).tolist() == [False, False, True]


def test_a_block_is_kept_for_what_interpolation_reaches():
    function = TransferFunction([10.0, 20.0], [0.0, 0.5], np.ones((2, 3)))
    array = np.zeros((16, 16, 48), np.uint8)
    array[3, 3, 16] = 11
    assert transparent(statistics_of(array), function).tolist() == [False, False, True]


def test_errors_start_at_0_and_rise_with_the_level():
    rng = np.random.default_rng(1)
    array = rng.integers(0, 256, (32, 40, 50), np.uint8)
    errors = block_errors(statistics_of(array), RAMP, 16.0, BLACK)
    assert errors.dtype == np.float32 and errors.shape == (5, 2 * 3 * 4)
    assert (errors[0] == 0).all() and (np.diff(errors, axis=0) >= 0).all()
    assert (errors[1] > 0).all() and np.isfinite(errors).all()


@pytest.mark.parametrize("background", [BLACK, np.ones(3), np.array([0.2, 0.9, 0.0])])
def test_of_one_sample_both_parts_are_exact(background):
    rng = np.random.default_rng(2)
    groups = rng.integers(0, 256, 8)  # each quantile group holds one value
    array = rng.permuted(np.repeat(groups, 512)).reshape(16, 16, 16).astype(np.uint8)
    statistics = statistics_of(array)
    values = array.astype(float)
    mean = np.rint(values.mean())
    of_voxels = delta_e_luv(
        shown_directly(RAMP, values, 16.0, background), shown_directly(RAMP, mean, 16.0, background)
    ).mean()
    mixture = delta_e_luv(
        mixed_directly(RAMP, values, 16.0, background), mixed_directly(RAMP, mean, 16.0, background)
    )
    voxels = voxel_errors(statistics, RAMP, 16.0, background)
    assert voxels[-1, 0] == pytest.approx(of_voxels, rel=1e-3)
    errors = block_errors(statistics, RAMP, 16.0, background)
    assert errors[-1, 0] == pytest.approx(mixture + 0.1 * of_voxels, rel=1e-3)


def test_values_that_change_places_alone_do_not_show_in_the_mixture():
    """Every 2^3 voxels hold the same eight values: level 1 keeps their mean alone, and where
    extinction and emission are linear in the value, the mean medium is the same."""
    eight = np.arange(8).reshape(2, 2, 2) * 4 + 100
    statistics = statistics_of(np.tile(eight, (8, 8, 8)).astype(np.uint8))
    white = TransferFunction([0.0, 255.0], [0.0, 1e-4], np.ones((2, 3)), 8.0)
    errors = block_errors(statistics, white, 16.0, BLACK)[:, 0]
    voxels = voxel_errors(statistics, white, 16.0, BLACK)[:, 0]
    np.testing.assert_allclose(errors[1:], 0.1 * voxels[1:], rtol=0.02)
    assert voxels[1] > 0


def test_few_voxels_that_show_are_not_lost_in_their_groups_mean():
    rng = np.random.default_rng(6)
    array = rng.integers(0, 30, (16, 16, 16)).astype(np.uint8)
    function = TransferFunction([100.0, 101.0], [0.0, 0.9], np.ones((2, 3)), 16.0)
    sparse = array.copy()
    sparse.ravel()[rng.choice(4096, 40, replace=False)] = 250
    assert statistics_of(sparse).quantiles[0, 0].max() < 100
    voxels = voxel_errors(statistics_of(sparse), function, 16.0, BLACK)[:, 0]
    full = delta_e_luv(linear_to_luv(np.full(3, 0.9)), linear_to_luv(np.zeros(3)))
    expected = full * 40 / 4096
    assert expected / 3 < voxels[-1] < 3 * expected and voxels[1] > 0.1 * expected
    errors = block_errors(statistics_of(sparse), function, 16.0, BLACK)[:, 0]
    mixture = delta_e_luv(mixed_directly(function, sparse, 16.0, BLACK), linear_to_luv(np.zeros(3)))
    assert mixture / 3 < errors[-1] - 0.1 * voxels[-1] < 3 * mixture
    assert (block_errors(statistics_of(array), function, 16.0, BLACK) == 0).all()
    mirrored = TransferFunction([154.0, 155.0], [0.9, 0.0], np.ones((2, 3)), 16.0)
    low = block_errors(statistics_of(255 - sparse), mirrored, 16.0, BLACK)[:, 0]
    np.testing.assert_allclose(low, errors, rtol=0.2)


def test_what_looks_alike_has_no_error():
    rng = np.random.default_rng(3)
    statistics = statistics_of(rng.integers(0, 256, (16, 16, 32), np.uint8))
    flat = TransferFunction([0.0, 255.0], [0.3, 0.3], np.full((2, 3), 0.5), 8.0)
    on_white = TransferFunction([0.0, 255.0], [0.0, 0.9], np.ones((2, 3)), 8.0)
    nothing = TransferFunction([0.0, 255.0], [0.0, 0.0], [[1, 0, 0], [0, 1, 0]], 8.0)
    for function, background in ((flat, BLACK), (on_white, np.ones(3)), (nothing, BLACK)):
        assert block_errors(statistics, function, 16.0, background).max() < 1e-3
    constant = statistics_of(np.full((16, 16, 16), 77, np.uint8))
    assert (block_errors(constant, RAMP, 16.0, BLACK) == 0).all()


def test_only_opacity_per_path_counts():
    statistics = statistics_of(np.random.default_rng(4).integers(0, 256, (16, 16, 32), np.uint8))
    one = block_errors(statistics, RAMP, 16.0, BLACK)
    small = replace(RAMP, opacity_unit=RAMP.opacity_unit * 1e-20)
    np.testing.assert_allclose(block_errors(statistics, small, 16e-20, BLACK), one, rtol=1e-4)
    shorter = block_errors(statistics, RAMP, 1.0, BLACK)
    assert (shorter[1:] < one[1:]).all() and (shorter[1:] > 0).all()


def test_features_much_narrower_than_the_range_are_resolved():
    values = [-1e9, 100.0, 101.0, 101.0, 102.0, 1e9]
    function = TransferFunction(values, [0, 0, 0.9, 0, 0, 0], np.ones((6, 3)))
    shown = ShownColors(function, 4.0, BLACK)
    at = np.array([-2e9, 99.0, 100.25, 100.5, 100.999, 101.0, 101.5, 3e9, np.nan])
    expected = shown_directly(function, np.nan_to_num(at), 4.0, BLACK)
    np.testing.assert_allclose(np.stack(shown.luv(shown.places(at)), -1), expected, atol=0.05)


def test_holes_and_extreme_values_stay_finite():
    rng = np.random.default_rng(5)
    array = rng.normal(0, 1, (16, 16, 64)).astype(np.float32)
    array[rng.random(array.shape) < 0.3] = np.nan
    array[:, :, 40:] = np.nan
    huge = rng.uniform(-1, 1, (16, 16, 32)) * 1.7e308
    large = rng.uniform(-1, 1, (16, 16, 32)).astype(np.float32) * np.float32(1e38)
    small = rng.uniform(0, 1e-30, (16, 16, 32)).astype(np.float32)
    ranges = (array, -3, 3), (large, -1e38, 1e38), (small, 0, 1e-30), (huge, -1.7e308, 1.7e308)
    for data, low, high in ranges:
        function = TransferFunction([low, high], [0.0, 0.8], [[0, 0, 1], [1, 1, 0]], 16.0)
        with np.errstate(over="ignore"):
            statistics = statistics_of(data)
        with np.errstate(all="raise", under="ignore"):
            errors = block_errors(statistics, function, 16.0, BLACK)
            clear = block_transmittances(statistics, ShownColors(function, 16.0, BLACK))
        assert np.isfinite(errors).all() and errors[-1, 0] > 0
        assert ((clear >= 0) & (clear <= 1)).all()


def test_transmittance_is_the_mean_of_the_values():
    array = np.repeat(np.array([0, 200], np.uint8), 2048).reshape(16, 16, 16)
    clear = block_transmittances(statistics_of(array), ShownColors(RAMP, 16.0, BLACK))
    expected = np.exp(-RAMP.extinction([0.0, 200.0]) * 16.0).mean()
    assert clear[0] == pytest.approx(expected, rel=1e-3)


@pytest.fixture(scope="module")
def brain() -> Volume:
    data = load_volume(BRAIN).data
    box = tuple(slice(max(0, n // 2 - 48), n // 2 + 48) for n in data.shape)
    return Volume(np.ascontiguousarray(data[box]))


def true_errors(volume: Volume, function: TransferFunction, path: float) -> np.ndarray:
    """[levels, n]: mean over voxels of Delta-E between the voxel and the level's sample there."""
    blocks = VolumeBlocks(volume).blocks
    full = shown_directly(function, volume.data, path, BLACK)
    out = np.zeros((blocks.levels, blocks.count))
    for level in range(1, blocks.levels):
        coarse = reduced(volume.data, level)
        for axis, n in enumerate(volume.shape):
            coarse = np.repeat(coarse, 1 << level, axis=axis).take(np.arange(n), axis=axis)
        found = delta_e_luv(full, shown_directly(function, coarse, path, BLACK))
        for k, place in enumerate(blocks.places(np.arange(blocks.count))):
            box = tuple(slice(16 * b, 16 * b + 16) for b in place)
            out[level, k] = found[box].mean()
    return out


@pytest.mark.parametrize("name", ["grayscale", "surface", "translucent"])
def test_estimates_are_near_the_errors_of_real_blocks(brain, name):
    function = preset(name, brain.value_range, 3.0)
    statistics = joined(VolumeBlocks(brain))
    estimated = voxel_errors(statistics, function, 16.0, BLACK)
    true = true_errors(brain, function, 16.0)
    inner = slice(1, 4)
    assert np.corrcoef(estimated[inner].ravel(), true[inner].ravel())[0, 1] > 0.85
    assert 0.8 < estimated[inner].sum() / true[inner].sum() < 1.2
    # One sample is compared with the histogram alone.
    assert 0.9 < estimated[4].sum() / true[4].sum() < 1.1


def test_on_real_blocks_the_greedy_is_near_the_best(brain):
    source = VolumeBlocks(brain)
    statistics = joined(source)
    function = preset("surface", brain.value_range, 3.0)
    errors = block_errors(statistics, function, 16.0, BLACK)
    dropped = transparent(statistics, function)
    cost = level_costs(source.blocks, source.dtype)
    whole = int(cost[0]) * int((~dropped).sum())
    ratios = []
    for share in (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5):
        got = select_levels(errors, cost, dropped, int(share * whole), 0.0)
        best = exact_levels(errors, cost, dropped, int(share * whole))
        assert got.bound <= best.error * (1 + 1e-6)
        ratios.append(got.error / best.error)
    assert max(ratios) < 1.05 and np.mean(ratios) < 1.01, ratios


def test_pieces_do_not_matter(brain, monkeypatch):
    statistics = joined(VolumeBlocks(brain))
    whole = block_errors(statistics, RAMP, 16.0, BLACK)
    monkeypatch.setattr(visible_error, "_PIECE", 7)
    np.testing.assert_allclose(block_errors(statistics, RAMP, 16.0, BLACK), whole, rtol=1e-5)
