"""The positions of a tile's rays: arithmetic, without a device.

The picture is cut into tiles of ``size`` by ``size`` pixels, which are shorter at the right and lower edge.
The rays of a tile lie at the crossings of some of its columns and some of its rows of pixels: its
lines. Ljung (2006, section 4) renders a tile as a small picture of tau by tau pixels of its own,
at any tau. Here every ray goes through the centre of a pixel of the final picture, so that the
picture at full resolution equals the one without tiles, and rays are never cast again: with tau lines on an axis of
n pixels, line i is pixel floor((i + 1/2) n / tau). A shorter tile has a number of lines in proportion to its
length, rounded up.

Refining a tile halves the gaps between its lines by adding lines: one in the middle
of each gap, and one half-way from the outermost lines to the borders. (Positions of 2 tau lines by
the formula above would include none of the old ones, and the interpolation would lose a quarter of the
rays.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

SMALLEST, LARGEST = 2, 256  # pixels per edge of a tile


@dataclass(frozen=True)
class TileGrid:
    """Tiles of ``size`` pixels per edge that cover a picture of ``width`` by ``height``, numbered row by
    row."""

    width: int
    height: int
    size: int

    @property
    def columns(self) -> int:
        return -(-self.width // self.size)

    @property
    def rows(self) -> int:
        return -(-self.height // self.size)

    @property
    def count(self) -> int:
        return self.columns * self.rows

    @cached_property
    def lengths(self) -> np.ndarray:
        """int64 [tiles, 2]: pixels (columns, rows) of each tile."""
        left, top = self.origins.T
        ends = np.minimum(np.stack([left, top], axis=1) + self.size, (self.width, self.height))
        return ends - self.origins

    @cached_property
    def origins(self) -> np.ndarray:
        """int64 [tiles, 2]: the first (column, row) of each tile."""
        row, column = np.divmod(np.arange(self.count), self.columns)
        return np.stack([column, row], axis=1) * self.size

    @cached_property
    def pixels(self) -> np.ndarray:
        """int64 [tiles]: pixels of each tile."""
        return self.lengths.prod(axis=1)


@dataclass(eq=False)
class Resolution:
    """The resolution of each tile: ``tau`` (1 ... size), the planned number of lines, and ``halvings``, how often its
    gaps have been halved since; both int64 [tiles]. ``halvings`` -1: no rays yet."""

    tau: np.ndarray
    halvings: np.ndarray

    def on_axis(self, grid: TileGrid, axis: int, tiles: np.ndarray) -> np.ndarray:
        """int64 [k, 4]: (length, size, tau, halvings) of ``tiles`` on ``axis`` (0: columns, 1:
        rows), as ``lines`` takes them."""
        size = np.full(len(tiles), grid.size)
        keys = (grid.lengths[tiles, axis], size, self.tau[tiles], self.halvings[tiles])
        return np.stack(keys, axis=1)


@lru_cache(maxsize=8192)
def lines(length: int, size: int, tau: int, halvings: int) -> tuple[int, ...]:
    """The pixels, ascending, at which an axis of ``length`` pixels has its lines; none for -1
    halvings."""
    if halvings < 0:
        return ()
    if halvings == 0:
        count = -(-tau * length // size)
        return tuple((2 * i + 1) * length // (2 * count) for i in range(count))
    return halved(lines(length, size, tau, halvings - 1), length)


def halved(positions: tuple[int, ...], length: int) -> tuple[int, ...]:
    """``positions``, and those that halve the gaps between them and at both ends."""
    first, last = positions[0], length - 1 - positions[-1]  # pixels outside, on either side
    between = [(a + b) // 2 for a, b in zip(positions, positions[1:])]
    outside = [(2 * first + 1) // 4, length - 1 - (2 * last + 1) // 4]
    return tuple(sorted({*positions, *between, *outside}))


def each_axis(function: Callable[..., object], keys: np.ndarray) -> np.ndarray:
    """``function(length, size, tau, halvings)`` for each row of ``keys`` [k, 4], called once per
    distinct row; int64 [k]."""
    different, inverse = unique_rows(keys)
    values = np.array([function(*map(int, key)) for key in different], np.int64)
    return values[inverse]


def unique_rows(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distinct rows of ``keys`` int64 [k, m <= 5] (numbers from -1 to 4094), and the index of each row among
    them [k]. Rows are packed into one number each, since ``np.unique`` over an axis takes ten times as long."""
    packed = (keys + 1) @ (1 << 12 * np.arange(keys.shape[1], dtype=np.int64))
    _, first, inverse = np.unique(packed, return_index=True, return_inverse=True)
    return keys[first], inverse.ravel()


def ray_counts(grid: TileGrid, resolution: Resolution, tiles: np.ndarray) -> np.ndarray:
    """int64 [k]: rays that ``tiles`` have."""
    counts = [
        each_axis(lambda *key: len(lines(*key)), resolution.on_axis(grid, axis, tiles))
        for axis in (0, 1)
    ]
    return counts[0] * counts[1]


class LineTable:
    """For each pixel of an axis the lines between which it lies, for all sets of lines requested so
    far.

    ``array`` uint8 [entries, 2]: (low, high), the pixels of the nearest lines at or before and at
    or after this one; beyond the outermost line both are that line. The entries of a set are
    consecutive, one per pixel.
    """

    def __init__(self) -> None:
        self._offsets: dict[tuple[int, int, int, int], int] = {}
        self._parts: list[np.ndarray] = []
        self._entries = 0

    @property
    def array(self) -> np.ndarray:
        return np.concatenate(self._parts or [np.zeros((1, 2), np.uint8)])

    @property
    def entries(self) -> int:
        return self._entries

    def offset(self, length: int, size: int, tau: int, halvings: int) -> int:
        """The offset of the entries of ``lines`` with these arguments, which are added if they are new."""
        key = length, size, tau, halvings
        if key not in self._offsets:
            positions = np.array(lines(*key))
            at = np.arange(key[0])
            low = np.maximum(np.searchsorted(positions, at, side="right") - 1, 0)
            high = np.minimum(np.searchsorted(positions, at, side="left"), len(positions) - 1)
            self._parts.append(np.stack([positions[low], positions[high]], 1).astype(np.uint8))
            self._offsets[key] = self._entries
            self._entries += key[0]
        return self._offsets[key]

    def offsets(self, grid: TileGrid, resolution: Resolution) -> np.ndarray:
        """int32 [tiles, 2]: the offsets of the entries of each tile's columns and rows."""
        tiles = np.arange(grid.count)
        keys = (resolution.on_axis(grid, axis, tiles) for axis in (0, 1))
        return np.stack([each_axis(self.offset, key) for key in keys], axis=1).astype(np.int32)
