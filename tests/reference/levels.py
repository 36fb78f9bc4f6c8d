"""Levels of a volume, and what pixels that cover several voxels see of them, as cl/volume_levels.h has it."""

from __future__ import annotations

import numpy as np

from reference.field import GridSampler


def halved_lattice(array: np.ndarray, axis: int) -> np.ndarray:
    """Means of pairs along ``axis`` of [z, y, x, 2]: sums and counts of finite voxels. An odd last one counts twice."""
    n = array.shape[axis]
    if n % 2:
        array = np.concatenate([array, np.take(array, [n - 1], axis=axis)], axis=axis)
    return 0.5 * (np.take(array, range(0, n, 2), axis=axis) + np.take(array, range(1, n + n % 2, 2), axis=axis))


def halvings_of(spacing, size, level: int) -> tuple[int, ...]:
    """How often each axis (x, y, z) was halved at ``level``."""
    edge = min((s for s, n in zip(spacing, size) if n > 2), default=min(spacing))
    found = []
    for s, n in zip(spacing, size):
        wanted = max(int(np.floor(level - np.log2(s / edge) + 0.5)), 0)
        most = 0
        while -(-n // 2**most) > 2:
            most += 1
        found.append(min(wanted, most))
    return tuple(found)


def level_array(data: np.ndarray, spacing, level: int) -> tuple[np.ndarray, tuple[int, ...]]:
    """The voxels of a level, float64 [z, y, x], rounded to the type of ``data``, and the axes' halvings (x, y, z)."""
    halvings = halvings_of(spacing, data.shape[::-1], level)
    finite = np.isfinite(data)
    both = np.stack([np.where(finite, data, 0).astype(np.float64), finite.astype(np.float64)], axis=-1)
    for axis, count in enumerate(halvings[::-1]):
        for _ in range(count):
            both = halved_lattice(both, axis)
    sums, share = both[..., 0], both[..., 1]
    means = np.where(share >= 0.5, sums / np.where(share > 0, share, 1.0), np.nan)
    if not any(halvings):
        means = np.where(finite, data, np.nan).astype(np.float64)
    return (np.rint(means) if data.dtype.kind in "iu" else means.astype(data.dtype).astype(np.float64)), halvings


class LevelsField:
    """In the place of ``reference.field.Field``: samples of the two levels between whose voxels' edges a pixel's side
    lies, for pictures of ``camera`` with square pixels, ``height`` of them from top to bottom."""

    filter = "linear"

    def __init__(self, volume, camera, height: int, bias: float, levels: int = 10) -> None:
        grid = volume.grid
        self.grid, self.camera, self.height = grid, camera, height
        edges = [s for s, n in zip(grid.spacing, grid.size) if n > 2]
        self.edge = min(edges, default=grid.smallest_edge)
        self.bias = bias
        self.arrays, self.halvings = zip(*(level_array(volume.data, grid.spacing, k) for k in range(levels)))
        self.last = max(k for k in range(levels) if k == 0 or self.halvings[k] != self.halvings[k - 1])
        self._to_index = grid.world_to_index()

    def footprint(self, world: np.ndarray) -> np.ndarray:
        """A pixel's side [n] at world places [n, 3], times 2^bias, in voxels of level 0."""
        camera = self.camera
        forward = np.asarray(camera.target, float) - camera.position
        depth = (world - camera.position) @ (forward / np.linalg.norm(forward))
        side = camera.height if camera.projection == "orthographic" else None
        if side is None:
            side = 2.0 * np.tan(np.radians(camera.fov_degrees) / 2.0) * depth
        return side / self.height * 2.0**self.bias / self.edge + 0.0 * depth

    def value(self, world: np.ndarray) -> np.ndarray:
        return self._blend(world, self._of_level)

    def gradient(self, world: np.ndarray) -> np.ndarray:
        """Per world length [n, 3]: central differences over a voxel of the level to each side."""
        slopes = [
            self._blend(world, lambda level, index, axis=axis: self._slope(level, index, axis)) for axis in range(3)
        ]
        return np.stack(slopes, axis=-1) @ self._to_index[:3, :3]

    def _blend(self, world, of_level) -> np.ndarray:
        index = world @ self._to_index[:3, :3].T + self._to_index[:3, 3]
        size = np.clip(self.footprint(world), 1.0, 2.0**self.last)
        finer = np.floor(np.log2(size)).astype(int)
        share = size / 2.0**finer - 1.0
        found = np.full(len(world), np.nan)
        for level in range(self.last + 1):
            here = np.nonzero((finer == level) & (share == 0))[0]
            found[here] = of_level(level, index[here])
            between = np.nonzero((finer == level) & (share > 0))[0]
            if len(between):
                low, high = (of_level(k, index[between]) for k in (level, level + 1))
                found[between] = low + share[between] * (high - low)
        return found

    def _place(self, level: int, index: np.ndarray) -> np.ndarray:
        """Lattice places (x, y, z) of the level."""
        scale = 0.5 ** np.asarray(self.halvings[level], float)
        upper = np.asarray(self.arrays[level].shape[::-1]) - 1.0
        return np.clip((index + 0.5) * scale - 0.5, 0.0, upper)

    def _of_level(self, level: int, index: np.ndarray) -> np.ndarray:
        return _trilinear(self.arrays[level], self._place(level, index))

    def _slope(self, level: int, index: np.ndarray, axis: int) -> np.ndarray:
        at, upper = self._place(level, index), self.arrays[level].shape[2 - axis] - 1.0
        low, high = at.copy(), at.copy()
        low[:, axis], high[:, axis] = np.clip(at[:, axis] - 1, 0, upper), np.clip(at[:, axis] + 1, 0, upper)
        length = high[:, axis] - low[:, axis]
        change = _trilinear(self.arrays[level], high) - _trilinear(self.arrays[level], low)
        scale = 0.5 ** self.halvings[level][axis]
        return change / np.where(length > 0, length, 1.0) * scale


def _trilinear(array: np.ndarray, place: np.ndarray) -> np.ndarray:
    """[n] at lattice places (x, y, z) [n, 3] inside; what has no weight does not count."""
    from clvol.volume import Grid

    return GridSampler(array, Grid(array.shape))(place)
