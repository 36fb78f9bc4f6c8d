"""Where the rays of tiles are, which are cast, and how many."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.tile_pictures import random_resolution

from clvol.integrators.tiles.geometry import LineTable, Resolution, TileGrid, halved, lines, ray_counts
from clvol.integrators.tiles.join import around
from clvol.integrators.tiles.work import ray_work

GRIDS = [(7, 5, 16), (7, 5, 3), (1, 1, 16), (33, 20, 8), (64, 48, 16), (5, 300, 256), (9, 9, 2)]


@pytest.mark.parametrize(("width", "height", "size"), GRIDS)
def test_tiles_cover_the_picture_once(width, height, size):
    grid = TileGrid(width, height, size)
    covered = np.zeros((height, width), int)
    for (left, top), (columns, rows) in zip(grid.origins, grid.lengths):
        assert columns > 0 and rows > 0
        covered[top : top + rows, left : left + columns] += 1
    assert (covered == 1).all() and grid.pixels.sum() == width * height


@pytest.mark.parametrize("size", [2, 3, 16, 17, 256])
def test_a_whole_tile_has_tau_lines_in_the_middles_of_equal_parts(size):
    for tau in range(1, size + 1):
        positions = lines(size, size, tau, 0)
        assert positions == tuple(int((i + 0.5) * size / tau) for i in range(tau))
        assert len(set(positions)) == tau and 0 <= positions[0] and positions[-1] < size


def test_a_tile_cut_short_has_its_share_of_lines_and_at_full_resolution_all():
    for length in range(1, 17):
        counts = [len(lines(length, 16, tau, 0)) for tau in range(1, 17)]
        assert counts == [int(np.ceil(tau * length / 16)) for tau in range(1, 17)]
        assert counts[-1] == length


def holes(positions: tuple[int, ...], length: int) -> list[int]:
    """Runs of pixels between lines, and beside them."""
    return [int(gap) - 1 for gap in np.diff([-1, *positions, length])]


@pytest.mark.parametrize("size", [2, 3, 7, 16, 64])
def test_halving_keeps_lines_halves_holes_and_ends_with_all(size):
    for length in {1, 2, size // 2 + 1, size - 1, size}:
        for tau in range(1, size + 1):
            positions = lines(length, size, tau, 0)
            for _ in range(int(np.ceil(np.log2(size))) + 1):
                finer = halved(positions, length)
                assert set(positions) <= set(finer)
                assert max(holes(finer, length)) <= max(holes(positions, length)) // 2
                positions = finer
            assert positions == tuple(range(length))


def test_the_middle_of_a_tile_is_never_beyond_its_outermost_lines():
    for size in (2, 5, 16, 31):
        for length in range(1, size + 1):
            for tau in range(1, size + 1):
                positions = lines(length, size, tau, 0)
                assert positions[0] <= length // 2 <= positions[-1]


def test_the_line_table_holds_the_nearest_lines_on_either_side():
    table = LineTable()
    for key in ((16, 16, 3, 0), (5, 16, 7, 0), (16, 16, 3, 1), (1, 2, 1, 0)):
        at, positions = table.offset(*key), lines(*key)
        for pixel, (low, high) in enumerate(table.array[at : at + key[0]]):
            assert low == max([p for p in positions if p <= pixel], default=positions[0])
            assert high == min([p for p in positions if p >= pixel], default=positions[-1])
    assert table.offset(16, 16, 3, 0) == 0  # kept, not added once more


@pytest.mark.parametrize(("width", "height", "size"), GRIDS)
def test_rays_are_the_plans_and_refining_adds_only_new_ones(width, height, size):
    grid = TileGrid(width, height, size)
    resolution = random_resolution(grid, 3)
    resolution.halvings[:] = -1
    tiles = np.arange(grid.count)
    known = np.zeros(width * height, bool)
    while not known.all():
        work = ray_work(grid, resolution, tiles)
        assert work.count and not known[work.pixels].any()  # none is cast twice
        assert len(np.unique(work.pixels)) == work.count
        known[work.pixels] = True
        row, column = np.divmod(work.pixels, width)
        whose = row // size * grid.columns + column // size
        np.testing.assert_array_equal(work.tiles, whose)
        resolution.halvings += 1
        counts = np.bincount(
            (np.flatnonzero(known) // width) // size * grid.columns
            + np.flatnonzero(known) % width // size,
            minlength=grid.count,
        )
        np.testing.assert_array_equal(ray_counts(grid, resolution, tiles), counts)
    assert ray_work(grid, resolution, tiles).count == 0


def test_the_rays_of_a_tile_follow_one_another_and_stay_close():
    grid = TileGrid(64, 64, 16)
    resolution = Resolution(np.full(16, 16), np.full(16, -1))
    work = ray_work(grid, resolution, np.array([5, 10]))
    assert list(work.tiles) == [5] * 256 + [10] * 256
    packets = work.pixels.reshape(-1, 16)
    assert (np.ptp(packets % 64, axis=1) == 3).all() and (np.ptp(packets // 64, axis=1) == 3).all()


def test_what_shows_something_of_a_tile_is_all_that_touch_it():
    grid = TileGrid(40, 30, 8)  # 5 by 4 tiles
    assert list(around(grid, np.array([0]))) == [0, 1, 5, 6]
    assert list(around(grid, np.array([7, 19]))) == [1, 2, 3, 6, 7, 8, 11, 12, 13, 14, 18, 19]
