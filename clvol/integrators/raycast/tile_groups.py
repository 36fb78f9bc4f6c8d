"""Groups of tiles that are rendered one after another, where not everything that a frame needs fits on the device."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clvol.device.tile_ranges import Ranges


def room_of_tiles(ranges: Ranges, room: np.ndarray, columns: int, rows: int) -> np.ndarray:
    """int64 [rows, columns]: the sum of ``room`` int [n] over the boxes that each tile sees."""
    (x0, x1), (y0, y1) = ranges
    sums = np.zeros((rows + 1, columns + 1), np.int64)
    for y, x, sign in ((y0, x0, 1), (y0, x1, -1), (y1, x0, -1), (y1, x1, 1)):
        np.add.at(sums, (y, x), sign * room)
    return sums.cumsum(axis=0).cumsum(axis=1)[:rows, :columns]


def tile_groups(
    ranges: Ranges, room: np.ndarray, most: int, columns: int, rows: int
) -> Iterator[tuple[np.ndarray | None, np.ndarray]]:
    """(tiles, boxes): bool [rows * columns], or None for all tiles, and bool [n]: the boxes that they see, which take
    ``most`` of ``room`` together, except that a tile may take more alone."""
    (x0, x1), (y0, y1) = ranges
    seen = (x0 < x1) & (y0 < y1)
    if int(room[seen].sum()) <= most:
        yield None, seen
        return
    chosen, held = np.zeros(rows * columns, bool), np.zeros(len(room), bool)
    for row, column in along_curve(columns, rows):
        more = (x0 <= column) & (column < x1) & (y0 <= row) & (row < y1)
        if chosen.any() and int(room[held | more].sum()) > most:
            yield chosen, held
            chosen, held = np.zeros(rows * columns, bool), np.zeros(len(room), bool)
        chosen[row * columns + column] = True
        held = held | more
    yield chosen, held


def along_curve(columns: int, rows: int) -> list[tuple[int, int]]:
    """(row, column) of all tiles in Morton's order (1966): those that follow each other are close together."""
    row, column = (axis.ravel() for axis in np.mgrid[:rows, :columns])
    code = np.zeros(len(row), np.int64)
    for k in range(16):
        code |= (column >> k & 1) << 2 * k | (row >> k & 1) << 2 * k + 1
    order = np.argsort(code)
    return list(zip(row[order].tolist(), column[order].tolist()))
