"""Shadows: how much of each light arrives, from each sample or at the points of a light volume."""

from __future__ import annotations

import numpy as np

from clvol.device.noise import noise_tile
from clvol.volume import Grid
from reference import classify
from reference.cell_crossings import medium_crossings
from reference.clip import kept_stretches
from reference.field import GridSampler
from reference.medium import Medium
from reference.noise import fractal_noise
from reference.shade import toward

CONE_DIRECTIONS = 13
_SUBDIVISIONS = 8  # within a step of a shadow ray


class Shadows:
    """Transmittance towards the lights of a resolved scene with a [shadow].

    ``step``: of rays to lights, in smallest voxel edges, where the [shadow] has none of its own; None: the
    scene's.
    """

    def __init__(self, resolved, medium: Medium, step: float | None = None) -> None:
        self.settings = resolved.shadow
        self.lights = resolved.lights
        self.clips = resolved.clips
        self.noise = resolved.attenuation_noise
        self.medium = medium
        self.isovalues = [s.value for s in resolved.isosurfaces]
        self.opacities = np.array([s.opacity for s in resolved.isosurfaces])
        step = self.settings.step or step or resolved.integration.step
        self.step = step * medium.grid.smallest_edge
        self._volumes: dict[int, GridSampler] = {}

    def transmittance(self, number, at, to_light, distance, weight, surface, gradient):
        """S [n, 3] of light ``number`` at world positions ``at`` [n, 3]; see ``Shader.lit``."""
        if self.settings.method == "volume":
            if number not in self._volumes:
                self._volumes[number] = self._light_volume(self.lights[number])
            if surface is not None:
                at = at + self._beyond_surface(gradient, to_light)
            return self._volumes[number](at)
        depth = np.zeros(len(at))
        cast = np.ones(len(at), bool) if weight is None else weight > self.settings.bound
        side = None
        if surface is not None and self.isovalues:
            # A ray leaves the surface that it starts on for the side that the light is on.
            outwards = np.where(np.sum(gradient * to_light, axis=1) > 0, 1, -1)
            is_it = surface[:, None] == np.arange(len(self.isovalues))
            side = np.where(is_it, outwards[:, None], 0)[cast]
        depth[cast] = self.optical_depth(at[cast], to_light[cast], distance[cast], side)
        return np.repeat(np.exp(-depth)[:, None], 3, axis=1)

    def optical_depth(self, at, direction, distance, known_side=None) -> np.ndarray:
        """[n] from ``at`` along ``direction`` as far as ``distance``: segments of one step each,
        the last one shorter, classified as the scene's; a surface counts with its opacity."""
        depth = np.zeros(len(at))
        kept = kept_stretches(self.medium.grid, self.clips, at, direction)
        for enter, leave in zip(kept.enter.T, kept.leave.T):
            leave = np.minimum(leave, distance)
            for i in range(self._count(enter, leave)):
                t0 = enter + i * self.step
                rays = np.nonzero(t0 < leave)[0]
                t0 = t0[rays]
                t1 = np.minimum(enter[rays] + (i + 1) * self.step, leave[rays])
                o, d = at[rays], direction[rays]
                start, end = o + t0[:, None] * d, o + t1[:, None] * d
                before = start - self.step * d
                depth[rays] += self.medium.segment(
                    start, end, d, before=before, curved=np.full(len(rays), i > 0),
                    steps=(t1 - t0) / self.step,
                ).depth  # fmt: skip
                if self.isovalues:
                    side = None if known_side is None else known_side[rays] * (t0 == 0)[:, None]
                    met = medium_crossings(
                        self.medium, o, d, t0, t1, self.isovalues,
                        known_side=side, subdivisions=_SUBDIVISIONS,
                    )  # fmt: skip
                    depth[rays] += self._surfaces_depth(met, o, d)
        return np.minimum(depth, classify.OPAQUE)

    def _beyond_surface(self, gradient, to_light) -> np.ndarray:
        """[n, 3]: from a plane surface to the nearest place whose light cell is all on its lit side."""
        grid = light_grid(self.medium.grid, self.settings.resolution)
        lit = np.where(np.sum(gradient * to_light, axis=1) > 0, 1.0, -1.0)
        normal = lit[:, None] * gradient / np.linalg.norm(gradient, axis=1)[:, None]
        across = np.abs(normal @ (grid.direction * grid.spacing)).sum(axis=1)
        return across[:, None] * normal

    def _surfaces_depth(self, met, origin, direction) -> np.ndarray:
        """Optical depth [n] of the surfaces met, but for those that a mask removes."""
        depth = np.zeros(len(origin))
        for t, surface in zip(met.t.T, met.surface.T):
            there = np.isfinite(t)
            at = origin + np.where(there, t, 0.0)[:, None] * direction
            opacity = np.where(there & self.medium.is_kept(at), self.opacities[surface], 0.0)
            with np.errstate(divide="ignore"):
                depth += np.minimum(-np.log1p(-opacity), classify.OPAQUE)
        return depth

    def _count(self, enter: np.ndarray, leave: np.ndarray) -> int:
        there = np.isfinite(enter)
        longest = np.max(leave[there] - enter[there], initial=0.0)
        return int(np.ceil(longest / self.step))

    def _light_volume(self, light) -> GridSampler:
        """S at points that span the domain, linear between them."""
        s, grid = self.settings, light_grid(self.medium.grid, self.settings.resolution)
        nz, ny, nx = grid.shape
        z, y, x = np.meshgrid(np.arange(nz), np.arange(ny), np.arange(nx), indexing="ij")
        index = np.stack([x.ravel(), y.ravel(), z.ravel(), np.ones(x.size)])
        at = (grid.index_to_world() @ index)[:3].T
        to_light, distance = toward(light, at, np.zeros_like(at))
        direct = np.exp(-self.optical_depth(at, to_light, distance))[:, None]
        share = direct * np.ones(3)
        if s.scattering > 0:
            scattered = np.zeros_like(at)
            less = self._attenuation(at, 1.0 - np.asarray(s.scatter_color, float))
            for local in cone_directions(s.cone_degrees):
                depth = self.optical_depth(at, turned(to_light, local), distance)
                scattered += np.exp(-depth[:, None] * less) / CONE_DIRECTIONS
            share = (1.0 - s.scattering) * share + s.scattering * scattered
        return GridSampler(share.reshape(nz, ny, nx, 3), grid)


    def _attenuation(self, at: np.ndarray, less: np.ndarray) -> np.ndarray:
        """Shares [n, 3] of the extinction that attenuate scattered light at world positions ``at`` [n, 3]."""
        shares = np.broadcast_to(less, at.shape).copy()
        for term in self.noise:
            tile = noise_tile(term.seed)
            shares += term.amplitude * fractal_noise(term, tile, self.medium.grid, at, self.medium.time)[:, :3]
        return np.clip(shares, 0.0, 1.0)


def light_grid(grid: Grid, resolution: int) -> Grid:
    """The points of a light volume: ``resolution`` along the domain's longest axis, at its ends
    too, and as dense, at least 2, along the others."""
    lower, upper = grid.index_bounds()
    edges = (upper - lower) * grid.spacing
    counts = np.maximum(np.round(edges / edges.max() * (resolution - 1)).astype(int) + 1, 2)
    corner = grid.index_to_world()[:3] @ np.append(lower, 1.0)
    return Grid(tuple(counts[::-1]), tuple(edges / (counts - 1)), tuple(corner), grid.direction)


def cone_directions(degrees: float, count: int = CONE_DIRECTIONS) -> np.ndarray:
    """Unit vectors [count, 3] about +z, evenly over the solid angle of a cone of this half angle: a
    spiral of equal areas."""
    k = np.arange(count)
    cosine = 1.0 - (k + 0.5) / count * (1.0 - np.cos(np.radians(degrees)))
    sine, angle = np.sqrt(1.0 - cosine**2), k * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack([sine * np.cos(angle), sine * np.sin(angle), cosine], axis=1)


def turned(axes: np.ndarray, local: np.ndarray) -> np.ndarray:
    """``local`` [3], stated about +z, about each of the unit ``axes`` [n, 3]."""
    other = np.where(np.abs(axes[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(other, axes)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(axes, u)
    return local[0] * u + local[1] * v + local[2] * axes
