"""Tiles cover a picture once, and launches cover the tiles once."""

from __future__ import annotations

import pytest

from clvol.schedule.tiles import bands, tiling


@pytest.mark.parametrize("size", [(1, 1), (512, 512), (513, 17), (8192, 3)])
def test_tiles_cover_the_picture_and_no_more_than_it_needs(size):
    cut = tiling(*size)
    assert cut.columns * cut.width >= size[0] > (cut.columns - 1) * cut.width
    assert cut.rows * cut.height >= size[1] > (cut.rows - 1) * cut.height
    assert cut.count == cut.columns * cut.rows


@pytest.mark.parametrize("tiles", [1, 2, 7, 1024])
@pytest.mark.parametrize("seconds", [0.0, 0.3, 3.0, 1e6])
def test_launches_cover_every_tile_once_and_in_order(tiles, seconds):
    launches = bands(tiles, seconds, 0.5)
    assert launches[0][0] == 0 and sum(count for _, count in launches) == tiles
    for (first, count), (following, _) in zip(launches, launches[1:]):
        assert first + count == following
    assert all(count >= 1 for _, count in launches)
    assert len(launches) == max(1, min(tiles, round(seconds / 0.5)))
