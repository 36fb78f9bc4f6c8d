"""Divides a picture into tiles, and the tiles into successive kernel launches."""

from __future__ import annotations

import logging
from dataclasses import dataclass

_log = logging.getLogger(__name__)
TILE = 16  # pixels per edge


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

    Launches are short so that progress can be reported and Ctrl-C takes effect between them. A picture that is
    rendered within ``band_seconds`` takes one launch.
    """
    count = max(1, min(tiles, round(expected_seconds / band_seconds)))
    _log.info("tiles: %d, kernel launches: %d", tiles, count)
    edges = [tiles * k // count for k in range(count + 1)]
    return [(a, b - a) for a, b in zip(edges, edges[1:])]
