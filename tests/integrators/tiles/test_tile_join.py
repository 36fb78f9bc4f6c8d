"""Intertile interpolation: the kernel, its twin, and what both promise."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.tile_pictures import GRIDS, joined, random_resolution, rays_only
from reference.tiles import JoinTwin

from clvol.integrators.tiles.geometry import Resolution, TileGrid

LEVELS = (1, 2, 3, 5, 8, 9, 13, 16)


def random_picture(grid: TileGrid, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Colours, and depths that are all different."""
    rng = np.random.default_rng(seed)
    shape = (grid.height, grid.width)
    depths = rng.permutation(shape[0] * shape[1]).reshape(shape).astype(np.float32)
    return rng.random((*shape, 4)).astype(np.float32), depths


def of_levels(tau: list[list[int]]) -> Resolution:
    flat = np.array(tau).ravel()
    return Resolution(flat, np.zeros_like(flat))


def ramp(grid: TileGrid, across: float, down: float) -> np.ndarray:
    y, x = np.mgrid[: grid.height, : grid.width]
    return np.repeat((across * x + down * y)[..., None], 4, axis=2) / 64.0


@pytest.mark.parametrize("halvings", [0, 2])
@pytest.mark.parametrize(("width", "height", "size"), GRIDS)
def test_kernel_and_twin_agree(context, width, height, size, halvings):
    grid = TileGrid(width, height, size)
    resolution = random_resolution(grid, width, halvings)
    image, depths = random_picture(grid, 7)
    twin = JoinTwin(grid, resolution).join(rays_only(grid, resolution, image), depths)
    kernel = joined(context, grid, resolution, image, depths)
    np.testing.assert_allclose(kernel[0], twin[0], atol=1e-6)
    np.testing.assert_array_equal(kernel[1], twin[1])


def test_every_ray_is_shown_as_it_was_cast_beside_any_tiles(context):
    grid = TileGrid(70, 66, 16)
    for seed in range(8):
        resolution = random_resolution(grid, seed, most_halvings=seed % 3)
        image, depths = random_picture(grid, seed)
        known = JoinTwin(grid, resolution).is_ray()
        shown = joined(context, grid, resolution, image, depths)
        assert 0 < known.sum() < known.size
        np.testing.assert_array_equal(shown[0][known], image[known])
        np.testing.assert_array_equal(shown[1][known], depths[known])


def test_a_constant_picture_stays_constant_to_the_last_bit(context):
    grid = TileGrid(70, 66, 16)
    image = np.broadcast_to(np.float32([0.1, 0.7, 1 / 3, 0.9]), (66, 70, 4))
    for seed in range(4):
        shown, _ = joined(context, grid, random_resolution(grid, seed), image)
        np.testing.assert_array_equal(shown, image)


def test_no_value_leaves_the_range_of_the_rays(context):
    grid = TileGrid(70, 66, 16)
    for seed in range(4):
        resolution = random_resolution(grid, seed)
        image, _ = random_picture(grid, seed)
        known = JoinTwin(grid, resolution).is_ray()
        shown, _ = joined(context, grid, resolution, image)
        low, high = image[known].min(axis=0), image[known].max(axis=0)
        assert (shown >= low - 1e-6).all() and (shown <= high + 1e-6).all()


@pytest.mark.parametrize("stacked", [False, True])
def test_a_ramp_is_exact_across_the_border_of_tiles_of_any_two_resolutions(context, stacked):
    """Between the outermost rays of the picture: beyond them it stays as it is there."""
    shape = (16, 32) if stacked else (32, 16)
    grid = TileGrid(*shape, 16)
    image = ramp(grid, 0.0, 1.0) if stacked else ramp(grid, 1.0, 0.0)
    for a in LEVELS:
        for b in LEVELS:
            resolution = of_levels([[a], [b]])
            shown, _ = joined(context, grid, resolution, image)
            known = JoinTwin(grid, resolution).is_ray()
            inside = np.flatnonzero(known.any(axis=1 if stacked else 0))
            between = slice(inside[0], inside[-1] + 1)
            part = (between, slice(None)) if stacked else (slice(None), between)
            np.testing.assert_allclose(shown[part], image[part], atol=1e-6)


def test_any_ramp_is_exact_between_equal_tiles(context):
    grid = TileGrid(48, 48, 16)
    for tau in LEVELS:
        image = ramp(grid, 0.7, -0.4)
        resolution = of_levels([[tau] * 3] * 3)
        shown, _ = joined(context, grid, resolution, image)
        rays = np.argwhere(JoinTwin(grid, resolution).is_ray())
        (top, left), (bottom, right) = rays.min(axis=0), rays.max(axis=0)
        part = (slice(top, bottom + 1), slice(left, right + 1))
        np.testing.assert_allclose(shown[part], image[part], atol=1e-6)


def steepest(context, grid: TileGrid, resolution: Resolution) -> float:
    """The greatest change from one pixel to the next, where tiles next to each other are black and
    white."""
    image = np.zeros((grid.height, grid.width, 4), np.float32)
    for tile, (left, top) in enumerate(grid.origins):
        image[top : top + grid.size, left : left + grid.size] = tile % 2 ^ tile // grid.columns % 2
    shown, _ = joined(context, grid, resolution, image)
    return max(np.abs(np.diff(shown, axis=axis)).max() for axis in (0, 1))


def test_the_picture_is_continuous_across_borders_and_corners(context):
    """The same resolutions on finer and finer pixels: where the picture is continuous the greatest
    change from pixel to pixel shrinks with them."""
    rng = np.random.default_rng(5)
    for _ in range(12):
        tau = rng.integers(1, 6, 9)
        changes = []
        for size in (30, 60, 120):
            grid = TileGrid(3 * size, 3 * size, size)
            changes.append(steepest(context, grid, Resolution(tau, np.zeros(9, np.int64))))
        assert changes[1] < 0.6 * changes[0] and changes[2] < 0.6 * changes[1], (tau, changes)


def test_p2s_weights_do_not_show_a_fine_tiles_own_rays_and_ours_do():
    grid = TileGrid(32, 32, 16)
    resolution = of_levels([[16, 1], [1, 1]])
    image, depths = random_picture(grid, 1)
    ours, paper = (JoinTwin(grid, resolution, paper=form) for form in (False, True))
    known = ours.is_ray()
    counts = {form: 0 for form in ("ours", "paper")}
    for form, twin in (("ours", ours), ("paper", paper)):
        for y, x in np.argwhere(known[:16, :16]):
            parts = twin.parts(x, y)
            counts[form] += any(weight > 0 for weight, tile in parts if tile != 0)
    assert counts["ours"] == 0 and counts["paper"] > 16


def test_p2s_weights_and_ours_are_the_same_between_equal_tiles():
    grid = TileGrid(32, 32, 16)
    for tau in LEVELS:
        both = [JoinTwin(grid, of_levels([[tau] * 2] * 2), paper=form) for form in (False, True)]
        for y, x in np.ndindex(32, 32):
            ours, theirs = (twin.parts(x, y) for twin in both)
            np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_the_weights_never_vanish_together():
    for seed in range(6):
        grid = TileGrid(40, 37, 9)
        twin = JoinTwin(grid, random_resolution(grid, seed))
        for y, x in np.ndindex(37, 40):
            parts = twin.parts(x, y)
            assert parts[0][0] > 0 and all(0 <= weight <= 1 for weight, _ in parts)


@pytest.mark.parametrize("rows_an_item", [1, 3, 9])
def test_how_work_is_cut_changes_nothing(context, rows_an_item):
    grid = TileGrid(40, 35, 9)
    resolution = random_resolution(grid, 8)
    image, depths = random_picture(grid, 3)
    whole = joined(context, grid, resolution, image, depths)
    cut = joined(context, grid, resolution, image, depths, rows_an_item=rows_an_item)
    for ours, theirs in zip(cut, whole):
        np.testing.assert_array_equal(ours, theirs)


def test_joining_some_tiles_leaves_the_others_alone(context):
    grid = TileGrid(40, 35, 8)
    resolution = random_resolution(grid, 3)
    image, depths = random_picture(grid, 3)
    whole, _ = joined(context, grid, resolution, image, depths)
    part, _ = joined(context, grid, resolution, image, depths, np.array([6, 24]))
    for tile, (left, top) in enumerate(grid.origins):
        place = (slice(top, top + 8), slice(left, left + 8))
        if tile in (6, 24):
            np.testing.assert_array_equal(part[place], whole[place])
        else:
            expected = rays_only(grid, resolution, image)[place]
            np.testing.assert_array_equal(part[place], expected)
