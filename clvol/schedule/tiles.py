"""A picture cut into tiles, and tiles into launches that follow one another."""

from __future__ import annotations

import logging
from dataclasses import dataclass

_log = logging.getLogger(__name__)
TILE = 16  # pixels an edge


@dataclass(frozen=True)
class Tiling:
    """``columns`` by ``rows`` tiles of ``width`` by ``height`` pixels cover the picture."""

    width: int
    height: int
    columns: int
    rows: int

    @property
    def count(self) -> int:
        return self.columns * self.rows


def tiling(image_width: int, image_height: int, width: int = TILE, height: int = TILE) -> Tiling:
    return Tiling(width, height, -(-image_width // width), -(-image_height // height))


def bands(tiles: int, expected_seconds: float, band_seconds: float) -> list[tuple[int, int]]:
    """(first tile, number of tiles) of launches that take about ``band_seconds`` each.

    Short enough for a progress report and for Ctrl-C; one launch where all is quick.
    """
    count = max(1, min(tiles, round(expected_seconds / band_seconds)))
    _log.info("tiles: %d, kernel launches: %d", tiles, count)
    edges = [tiles * k // count for k in range(count + 1)]
    return [(a, b - a) for a, b in zip(edges, edges[1:])]
