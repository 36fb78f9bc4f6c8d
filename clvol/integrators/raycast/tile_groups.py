"""Groups of tiles that are rendered one after another, where not everything that a frame needs fits on the device."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clvol.device.tile_ranges import Ranges


def tile_groups(
    ranges: Ranges, room: np.ndarray, most: int, columns: int, rows: int, tiles: np.ndarray | None = None
) -> Iterator[tuple[np.ndarray | None, np.ndarray]]:
    """(tiles, boxes): groups of ``tiles`` (numbers; None: all), and bool [n]: the boxes that they see, which take
    ``most`` of ``room`` together, except that a tile may take more alone."""
    (x0, x1), (y0, y1) = ranges
    wanted = np.ones((rows, columns), bool)
    if tiles is not None:
        wanted[...] = False
        wanted.ravel()[tiles] = True
    sums = np.pad(wanted.astype(np.int64), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    seen = (x0 < x1) & (y0 < y1) & (sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0] > 0)
    if int(room[seen].sum()) <= most:
        yield tiles, seen
        return
    chosen: list[int] = []
    held = np.zeros(len(room), bool)
    for row, column in along_curve(columns, rows):
        if not wanted[row, column]:
            continue
        more = (x0 <= column) & (column < x1) & (y0 <= row) & (row < y1)
        if chosen and int(room[held | more].sum()) > most:
            yield np.array(chosen, np.int64), held
            chosen, held = [], np.zeros(len(room), bool)
        chosen.append(row * columns + column)
        held = held | more
    yield np.array(chosen, np.int64), held


def along_curve(columns: int, rows: int) -> list[tuple[int, int]]:
    """(row, column) of all tiles in Morton's order (1966): those that follow each other are close together."""
    row, column = (axis.ravel() for axis in np.mgrid[:rows, :columns])
    code = np.zeros(len(row), np.int64)
    for k in range(16):
        code |= (column >> k & 1) << 2 * k | (row >> k & 1) << 2 * k + 1
    order = np.argsort(code)
    return list(zip(row[order].tolist(), column[order].tolist()))
