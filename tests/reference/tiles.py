"""The kernels of tiled pictures once more, pixel by pixel and ray by ray in double precision."""

from __future__ import annotations

import numpy as np

from clvol.device.view import RayFrame
from clvol.integrators.tiles.geometry import Resolution, TileGrid, lines
from clvol.store.geometry import BlockGrid

DROPPED_CODE = 15


class JoinTwin:
    """cl/tile_join.cl: what a picture shows between the rays of its tiles.

    ``paper``: the weights of Ljung 2006 (eq. 6) as they are, in which a tile across a corner counts even where
    the pixel's own tile has rays on all sides.
    """

    def __init__(self, grid: TileGrid, resolution: Resolution, *, paper: bool = False) -> None:
        self.grid, self.paper = grid, paper
        axes = [resolution.on_axis(grid, axis, np.arange(grid.count)) for axis in (0, 1)]
        self.lines = [[np.array(lines(*map(int, key))) for key in keys] for keys in axes]

    def is_ray(self) -> np.ndarray:
        """bool [height, width]: pixels that have a ray of their own."""
        mask = np.zeros((self.grid.height, self.grid.width), bool)
        for tile, (left, top) in enumerate(self.grid.origins):
            mask[np.ix_(top + self.lines[1][tile], left + self.lines[0][tile])] = True
        return mask

    def join(self, image: np.ndarray, depths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``image`` [height, width, ...] and ``depths`` [height, width] with all pixels filled from
        those that have a ray; the others' values are not read."""
        known = self.is_ray()
        colors = np.array(image, np.float64)
        joined, nearest = colors.copy(), np.array(depths)
        for y, x in np.argwhere(~known):
            parts = self.parts(x, y)
            total = sum(weight for weight, _ in parts)
            joined[y, x] = sum(weight * self._color(colors, t, x, y) for weight, t in parts) / total
            rays = [self._nearest(t, x, y) for weight, t in parts if weight > 0]
            best = min(rays, key=lambda ray: (ray[0] - x) ** 2 + (ray[1] - y) ** 2)
            nearest[y, x] = depths[best[1], best[0]]
        return joined, nearest

    def parts(self, x: int, y: int) -> list[tuple[float, int]]:
        """(weight, tile) of the four tiles around the corner nearest to a pixel, its own first; not
        yet divided by their sum."""
        grid = self.grid
        column, row = x // grid.size, y // grid.size
        tile = row * grid.columns + column
        columns, rows = grid.lengths[tile]
        after = (x - column * grid.size >= columns // 2, y - row * grid.size >= rows // 2)
        beside, beyond = column + (1 if after[0] else -1), row + (1 if after[1] else -1)
        meets = (0 <= beside < grid.columns, 0 <= beyond < grid.rows)
        beside, beyond = beside if meets[0] else column, beyond if meets[1] else row
        a, b = tile, row * grid.columns + beside
        c, d = beyond * grid.columns + column, beyond * grid.columns + beside
        ab = cd = ac = bd = 0.0
        if meets[0]:
            ab, cd = (self._edge(0, x, *pair, after[0]) for pair in ((a, b), (c, d)))
        if meets[1]:
            ac, bd = (self._edge(1, y, *pair, after[1]) for pair in ((a, c), (b, d)))
        weights = [(1 - ab) * (1 - ac), ab * (1 - bd), (1 - cd) * ac, cd * bd]
        if not self.paper:
            across = [
                max((1 - bd) * (1 - ab), (1 - cd) * (1 - ac)),
                max((1 - ac) * ab, cd * (1 - bd)),
                max((1 - ab) * ac, bd * (1 - cd)),
                max(ab * bd, ac * cd),
            ]
            weights = np.minimum(weights, across)
        return [(float(w), int(t)) for w, t in zip(weights, (a, b, c, d))]

    def _edge(self, axis: int, pixel: int, here: int, there: int, after: bool) -> float:
        """e of Ljung 2006, eq. 5, along ``axis``: 0 on tile ``here``'s outermost line, 1 on ``there``'s."""
        outermost = [self.grid.origins[t][axis] + self.lines[axis][t] for t in (here, there)]
        first = outermost[0][-1 if after else 0]
        second = outermost[1][0 if after else -1]
        return float(np.clip((pixel - first) / (second - first), 0.0, 1.0))

    def _color(self, image: np.ndarray, tile: int, x: int, y: int) -> np.ndarray:
        left, top = self.grid.origins[tile]
        along_x, along_y = (lines_of[tile] for lines_of in self.lines)
        rays = image[np.ix_(top + along_y, left + along_x)]
        for position, at in ((y - top, along_y), (x - left, along_x)):
            position = np.clip(position, at[0], at[-1])
            k = np.clip(np.searchsorted(at, position, side="right") - 1, 0, max(len(at) - 2, 0))
            share = (position - at[k]) / (at[k + 1] - at[k]) if len(at) > 1 else 0.0
            rays = rays[k] if share == 0 else rays[k] + share * (rays[k + 1] - rays[k])
        return rays

    def _nearest(self, tile: int, x: int, y: int) -> tuple[int, int]:
        """(column, row) of the tile's ray nearest to a pixel; of two as near, the first."""
        place = []
        for axis, pixel in enumerate((x, y)):
            at = self.grid.origins[tile][axis] + self.lines[axis][tile]
            place.append(int(at[np.argmin(np.abs(at - pixel))]))
        return place[0], place[1]


def corner_statistics_twin(
    index: np.ndarray, blocks: BlockGrid, frame: RayFrame, tiles: TileGrid, upper: np.ndarray
) -> np.ndarray:
    """cl/tile_statistics.cl: float64 [rows + 1, columns + 1, 4]. ``index`` int32 [blocks, 2];
    ``upper``: size of the lattice less 1, (x, y, z). Cuts each ray at all faces between blocks, and
    looks where the middle of each piece is."""
    codes = np.asarray(index)[:, 1] & 15
    scales = np.where(codes == DROPPED_CODE, 0.0, 2.0 ** (codes - 1.0) / blocks.edge)
    statistics = np.zeros((tiles.rows + 1, tiles.columns + 1, 4))
    for row, column in np.ndindex(statistics.shape[:2]):
        u = min(column * tiles.size, tiles.width) - 0.5 - frame.centre[0]
        v = min(row * tiles.size, tiles.height) - 0.5 - frame.centre[1]
        origin = frame.origin + u * frame.du + v * frame.dv
        direction = frame.forward + u * frame.ray_du + v * frame.ray_dv
        norm = np.sqrt(1 + (u * frame.lens[0]) ** 2 + (v * frame.lens[1]) ** 2)
        enter, leave = _inside(origin, direction / norm, upper, -frame.distance * norm)
        if leave > enter:
            met = scales[_blocks_along(origin, direction / norm, enter, leave, blocks)]
            statistics[row, column] = met.max(), met.mean(), np.sqrt(np.mean(met**2)), len(met)
    return statistics


def _inside(origin, direction, upper, start: float) -> tuple[float, float]:
    """Where a ray enters the box 0 ... ``upper``, and where it leaves."""
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = np.stack([-origin, upper - origin]) / direction
    parallel = direction == 0
    if np.any(parallel & ((origin < 0) | (origin > upper))):
        return 0.0, -1.0
    low = np.where(parallel, -np.inf, faces.min(axis=0))
    high = np.where(parallel, np.inf, faces.max(axis=0))
    return max(low.max(), start), high.min()


def _blocks_along(origin, direction, enter: float, leave: float, blocks: BlockGrid) -> np.ndarray:
    """The numbers of the blocks that a ray passes through."""
    cuts = [np.array([enter, leave])]
    for axis in range(3):
        if direction[axis]:
            faces = np.arange(1, blocks.counts[2 - axis]) * blocks.edge - 0.5
            cuts.append((faces - origin[axis]) / direction[axis])
    cuts = np.unique(np.concatenate(cuts))
    cuts = cuts[(cuts >= enter) & (cuts <= leave)]
    middles = origin + 0.5 * (cuts[1:] + cuts[:-1])[:, None] * direction
    places = np.floor((middles + 0.5) / blocks.edge).astype(int)[:, ::-1]
    return np.ravel_multi_index(tuple(places.T), blocks.counts)
