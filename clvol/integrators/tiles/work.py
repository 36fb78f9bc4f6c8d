"""Lists of rays to cast: pixels in the order in which a kernel takes them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from clvol.integrators.tiles.geometry import Resolution, TileGrid, lines, unique_rows


@dataclass(frozen=True, eq=False)
class RayWork:
    """``pixels`` int32 [rays]: row * width + column of each ray; ``tiles`` int32 [rays]: its tile.
    A tile's rays are consecutive, with neighbours close together: packets stay narrow, and
    hold rays of several tiles where one has too few."""

    pixels: np.ndarray
    tiles: np.ndarray

    @property
    def count(self) -> int:
        return len(self.pixels)


def ray_work(grid: TileGrid, resolution: Resolution, tiles: np.ndarray) -> RayWork:
    """The rays that halve the gaps of ``tiles`` (numbers) once more; for tiles without rays, the planned ones."""
    halvings = resolution.halvings[tiles]
    keys = np.column_stack([grid.lengths[tiles], resolution.tau[tiles], halvings])
    different, inverse = unique_rows(keys)
    corners = grid.origins @ (1, grid.width)
    pixels, whose = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
    for group, key in enumerate(different):
        columns, rows, tau, before = map(int, key)
        row, column = _pattern(columns, rows, grid.size, tau, before)
        members = tiles[inverse == group]
        at = corners[members][:, None] + (row * grid.width + column)
        pixels.append(at.ravel().astype(np.int32))
        whose.append(np.repeat(members, len(row)).astype(np.int32))
    return RayWork(np.concatenate(pixels), np.concatenate(whose))


@lru_cache(maxsize=512)
def _pattern(
    columns: int, rows: int, size: int, tau: int, before: int
) -> tuple[np.ndarray, np.ndarray]:
    """(rows, columns) in the tile of the rays that one more halving adds, along a Z-curve."""
    wanted = np.zeros((rows, columns), bool)
    wanted[np.ix_(lines(rows, size, tau, before + 1), lines(columns, size, tau, before + 1))] = True
    cast = np.ix_(_array(rows, size, tau, before), _array(columns, size, tau, before))
    wanted[cast] = False
    row, column = np.nonzero(wanted)
    order = np.argsort(_spread(column) | _spread(row) << 1, kind="stable")
    found = row[order], column[order]
    for axis in found:
        axis.flags.writeable = False  # shared by all callers
    return found


def _array(length: int, size: int, tau: int, halvings: int) -> np.ndarray:
    return np.array(lines(length, size, tau, halvings), np.int64)


def _spread(numbers: np.ndarray) -> np.ndarray:
    """Numbers below 2^8 with a 0 before each bit."""
    spread = np.asarray(numbers, np.int64)
    for shift, mask in ((4, 0x0F0F), (2, 0x3333), (1, 0x5555)):
        spread = (spread | spread << shift) & mask
    return spread
