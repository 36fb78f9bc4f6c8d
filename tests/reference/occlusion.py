"""Ambient occlusion: what of the light from all around arrives at a place, from points of a grid."""

from __future__ import annotations

import numpy as np

from reference import classify
from reference.cell_crossings import medium_crossings
from reference.clip import kept_stretches
from reference.field import GridSampler
from reference.medium import Medium
from reference.shadow import light_grid

_SUBDIVISIONS = 8


class Occlusion:
    """Of a resolved scene with an [ambient_occlusion]."""

    def __init__(self, resolved, medium: Medium) -> None:
        self.settings = resolved.ambient_occlusion
        self.clips = resolved.clips
        self.medium = medium
        self.isovalues = [s.value for s in resolved.isosurfaces]
        self.opacities = np.array([s.opacity for s in resolved.isosurfaces])
        self.step = self.settings.step * medium.grid.smallest_edge
        self.grid = light_grid(medium.grid, self.settings.resolution)
        self._points: GridSampler | None = None

    def share(self, at, normal=None, surface=False) -> np.ndarray:
        """[n]: what is left at world positions ``at`` of the light on a surface of ``normal``; None: of the surface
        that gets most. ``surface``: whether it is an iso-surface, which would take its own light."""
        if self._points is None:
            self._points = GridSampler(self.points(), self.grid)
        if surface:
            across = np.abs(normal @ (self.grid.direction * self.grid.spacing)).sum(axis=1)
            at = at + across[:, None] * normal
        found = self._points(at)
        mean, way = found[:, 0], found[:, 1:]
        along = np.linalg.norm(way, axis=1) if normal is None else np.sum(way * normal, axis=1)
        return 1.0 - self.settings.intensity * (1.0 - np.clip(mean + 2.0 * along, 0.0, 1.0))

    def points(self) -> np.ndarray:
        """[z, y, x, 4]: mean of what arrives, and of that times its direction; inside of matter what is around."""
        nz, ny, nx = self.grid.shape
        z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
        index = np.stack([x.ravel(), y.ravel(), z.ravel(), np.ones(x.size)])
        at = (self.grid.index_to_world() @ index)[:3].T
        seen, clear = np.zeros((len(at), 4)), np.zeros(len(at))
        near = 0.5 * np.linalg.norm(self.grid.spacing)
        for way in sphere(self.settings.directions):
            arrives, open_ = self.visibility(at, np.broadcast_to(way, at.shape), near)
            seen[:, 0] += arrives
            seen[:, 1:] += arrives[:, None] * way
            clear += open_
        count = self.settings.directions
        return inwards((seen / count).reshape(nz, ny, nx, 4), (clear / count).reshape(nz, ny, nx))

    def visibility(self, at, direction, near) -> tuple[np.ndarray, np.ndarray]:
        """(V, transmittance as far as ``near``) [n] from ``at`` along ``direction``: 1 less the fall of the
        transmittance, each part of it weighed by 1 - its distance / reach."""
        left, near_left, taken = (np.full(len(at), start) for start in (1.0, 1.0, 0.0))
        kept = kept_stretches(self.medium.grid, self.clips, at, direction)
        reach = self.settings.distance

        def fall(rays, depth, t):
            fallen = left[rays] * -np.expm1(-depth)
            taken[rays] += fallen * np.maximum(1.0 - t / reach, 0.0)
            left[rays] -= fallen
            near_left[rays] -= np.where(t < near, fallen, 0.0)

        for enter, leave in zip(kept.enter.T, kept.leave.T):
            leave = np.minimum(leave, reach)
            there = np.isfinite(enter)
            longest = np.max(leave[there] - enter[there], initial=0.0)
            for i in range(int(np.ceil(longest / self.step))):
                t0 = enter + i * self.step
                rays = np.nonzero(t0 < leave)[0]
                t0 = t0[rays]
                t1 = np.minimum(enter[rays] + (i + 1) * self.step, leave[rays])
                o, d = at[rays], direction[rays]
                start, end = o + t0[:, None] * d, o + t1[:, None] * d
                depth = self.medium.segment(
                    start, end, d, before=start - self.step * d, curved=np.full(len(rays), i > 0),
                    steps=(t1 - t0) / self.step,
                ).depth  # fmt: skip
                if self.isovalues:
                    met = medium_crossings(
                        self.medium, o, d, t0, t1, self.isovalues, subdivisions=_SUBDIVISIONS
                    )
                    for t, surface in zip(met.t.T, met.surface.T):
                        crosses = np.isfinite(t)
                        place = o + np.where(crosses, t, 0.0)[:, None] * d
                        opacity = np.where(crosses & self.medium.is_kept(place), self.opacities[surface], 0.0)
                        with np.errstate(divide="ignore"):
                            fall(rays, np.minimum(-np.log1p(-opacity), classify.OPAQUE), np.where(crosses, t, 0.0))
                fall(rays, depth, 0.5 * (t0 + t1))
        return 1.0 - taken, near_left


def sphere(count: int) -> np.ndarray:
    """Unit vectors [count, 3]: a spiral of equal areas over half a sphere, and their opposites."""
    half = count // 2
    k = np.arange(half)
    z = (k + 0.5) / half
    angle = k * np.pi * (3.0 - np.sqrt(5.0))
    upper = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=1)
    return np.concatenate([upper, -upper])


def inwards(seen: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """``seen`` [z, y, x, 4], where points whose neighbourhood is not ``clear`` take the mean of the 27 around them."""
    weight = np.minimum(2.0 * clear, 1.0)[..., None] ** 4
    out = seen.copy()
    shape = clear.shape
    for z, y, x in np.ndindex(*shape):
        around = tuple(slice(max(c - 1, 0), c + 2) for c in (z, y, x))
        total = weight[around].sum()
        if total > 1e-6:
            mean = (weight[around] * seen[around]).sum(axis=(0, 1, 2)) / total
            out[z, y, x] = weight[z, y, x] * seen[z, y, x] + (1 - weight[z, y, x]) * mean
    return out
