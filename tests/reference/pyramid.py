"""The numpy reference of cl/pyramid.cl: Kraus et al. 2007, fig. 4, slice by slice over the whole picture, in double.

No tiles, no chunks, nothing is leapt over. What differs from the paper is in the head of cl/pyramid.h.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from clvol.device.view import ray_frame
from clvol.integrators.pyramid.slices import SlicePlan, slice_plan
from clvol.scene.resolve import ResolvedScene
from reference.classify import MovedFunction, of_chord
from reference.clip import kept_stretches
from reference.field import Field
from reference.medium import Medium, _factor, _finite_norm
from reference.multiresolution import shifted_chord
from reference.pyramid_surfaces import PixelSurfaces, cued
from reference.shade import Shader

SLACK, WITHIN = 0.5, 1.6  # of cl/pyramid.h
CHUNK = 8

Oracle = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Distances [n] in smallest edges at world positions [n, 3] with so much light left [n]."""
Values = Callable[[np.ndarray], np.ndarray]
"""Values [n] at world positions [n, 3]."""


@dataclass
class PyramidPicture:
    """``rgba`` [h, w, 4]. ``samples`` (of data), ``oracle_samples``, ``syntheses``, ``accumulations``: how many, of all
    levels. ``stale``: pixels that were synthesised from what no sample of their slice stands behind."""

    rgba: np.ndarray
    samples: int
    oracle_samples: int
    syntheses: int
    accumulations: int
    stale: int


def mapped_oracle(
    resolved: ResolvedScene, distances: np.ndarray, shift: int, margin: float = 0.0
) -> Oracle:
    """Of a map: distances [z, y, x] of cells of 2^shift lattice cells, which begin ``margin`` below 0."""
    grid = resolved.volume.grid
    to_index = grid.world_to_index()
    upper = np.maximum(np.array(grid.size), 2) - 1.0
    thin = np.array([n == 1 for n in grid.size])  # held twice: from the voxel's centre on

    def distance(world: np.ndarray, left: np.ndarray) -> np.ndarray:
        index = world @ to_index[:3, :3].T + to_index[:3, 3] + np.where(thin, 0.5, 0.0)
        cell = (np.clip(index, 0.0, upper) + margin).astype(np.int64) >> shift
        x, y, z = np.minimum(cell, np.array(distances.shape[::-1]) - 1).T
        return distances[z, y, x]

    return distance


def render_pyramid_twin(
    resolved: ResolvedScene, oracle: Oracle, values: Values | None = None
) -> PyramidPicture:
    """The picture of ``resolved`` by the method "pyramid" with ``oracle``, whatever its settings name.
    ``values``: instead of the scene's volume.

    Segments are integrated exactly; their colour is that of a longer one with these ends, as tables have it:
    of the next power of two of steps, from a quarter to 2^levels.
    """
    return _March(resolved, oracle, values).run()


class _March:
    def __init__(self, resolved: ResolvedScene, oracle: Oracle, values: Values | None) -> None:
        image, integration = resolved.image, resolved.integration
        self.resolved, self.oracle = resolved, oracle
        self.width, self.height = image.width, image.height
        self.plan: SlicePlan = slice_plan(resolved, resolved.camera, image.width, image.height)
        self.step = integration.step
        self.unit = resolved.volume.grid.smallest_edge
        self.values = values
        if values is None:
            field = Field(resolved.volume, integration.filter, prefilter=integration.prefilter)
            self.values = field.value
        self.function = MovedFunction(resolved.transfer_function)
        self.shader = Shader(resolved, None, None)
        self.factors = resolved.gradient_opacity, resolved.directional_opacity
        self.needs_gradients = self.shader.lights_anything or any(f is not None for f in self.factors)
        self.medium = Medium(resolved) if self.needs_gradients or resolved.isosurfaces else None
        self.stop = 1.0 - integration.early_termination
        frame = ray_frame(resolved.camera, resolved.volume.grid, image.width, image.height)
        self.first_slice = frame.distance  # edges from the eye
        self.levels = self.plan.levels + self.plan.oversampling
        self.period = max(CHUNK, 1 << self.plan.levels)
        whole = 1 << self.levels
        self.side = [-(-max(self.width, self.height) // whole) * whole >> level for level in range(self.levels + 1)]
        self.samples = self.oracle_samples = self.syntheses = self.accumulations = self.stale = 0
        self._make_levels()
        self._make_pixels()

    def _make_levels(self) -> None:
        """Pixels of level l > 0: one more all around."""
        self.distance, self.value, self.fresh = [None], [None], [None]
        self.rays = [None]
        for level in range(1, self.levels + 1):
            n = self.side[level] + 2
            at = (np.arange(n) - 1 + 0.5) * (1 << level) - 0.5
            self.rays.append(self._world_rays(*np.meshgrid(at, at)))
            self.distance.append(np.zeros((n, n)))
            self.value.append(np.zeros((n, n)))
            self.fresh.append(np.zeros((n, n), bool))

    def _world_rays(self, columns: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and unit directions [..., 3] through the picture at (columns, rows), in pixels."""
        camera = self.resolved.camera
        forward, right, up = camera.basis()
        x = (columns + 0.5 - self.width / 2)[..., None] * right
        across = x - (rows + 0.5 - self.height / 2)[..., None] * up
        eye = np.asarray(camera.position, np.float64)
        if camera.projection == "orthographic":
            return eye + camera.height / self.height * across, np.broadcast_to(forward, across.shape)
        tangent = 2.0 * math.tan(math.radians(camera.fov_degrees) / 2) / self.height
        directions = forward + tangent * across
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(eye, directions.shape), directions

    def _make_pixels(self) -> None:
        n = self.side[0]
        shape = (n, n)
        columns, rows = np.meshgrid(np.arange(n, dtype=float), np.arange(n, dtype=float))
        self.origin, self.direction = self._world_rays(columns, rows)
        kept = kept_stretches(
            self.resolved.volume.grid, self.resolved.clips, self.origin.reshape(-1, 3), self.direction.reshape(-1, 3)
        )
        enter, leave = kept.enter[:, 0].reshape(shape), kept.leave[:, 0].reshape(shape)
        self.alive = np.isfinite(enter) & (columns < self.width) & (rows < self.height)
        slices = [(np.where(self.alive, t, 0.0) / self.unit - self.first_slice) / self.step for t in (enter, leave)]
        self.enter, self.leave = slices
        self.cut_normal = np.where(self.alive[..., None], kept.normal[:, 0].reshape(*shape, 3), 0.0)
        self.pixel_distance = np.zeros(shape)
        self.value1, self.value2, self.t1, self.t2 = (np.zeros(shape) for _ in range(4))
        self.first, self.second = np.ones(shape, bool), np.ones(shape, bool)
        self.rgba = np.zeros((*shape, 4))
        self.surfaces = None
        if self.resolved.isosurfaces:
            self.surfaces = PixelSurfaces(self.resolved, self.medium, self.shader, self.origin, self.direction)
            ends = [(self.first_slice + t * self.step) * self.unit for t in (self.enter, self.leave)]
            self.surfaces.find(self.alive, *ends)

    def run(self) -> PyramidPicture:
        if self.alive.any():
            begin = max(float(self.enter[self.alive].min()), 0.0)
            k = int(begin) // self.period * self.period
            while self.alive.any():
                self._slice(k)
                k += 1
        rgba = self.rgba[: self.height, : self.width].copy()
        rgba[..., 3] = np.minimum(rgba[..., 3], 1.0)
        return PyramidPicture(rgba, self.samples, self.oracle_samples, self.syntheses, self.accumulations, self.stale)

    def _slice(self, k: int) -> None:
        most = self.plan.levels
        zeros = (k & -k).bit_length() - 1 if k else most
        along = min(zeros, most)
        top = along + self.plan.oversampling
        spacing = self.plan.spacing + k * self.plan.growth
        for level in range(top, 0, -1):
            self._update(level, top, k, along, spacing * (1 << level))
        self._pixels(k, along, top, spacing)

    def _update(self, level: int, top: int, k: int, along: int, spacing: float) -> None:
        distance, value = self.distance[level], self.value[level]
        part = distance < self._reach(along, spacing)
        sampled = part
        fresh = part.copy()
        if level < top:
            wanted, made = self._synthesised(level, 1)
            distance[part], value[part] = wanted[part], made[part]
            sampled = part & ((distance < WITHIN * spacing) | ~np.isfinite(value))
            fresh &= sampled | self._made_of_fresh(level, 1)
            self.syntheses += np.count_nonzero(part)
        self.fresh[level] = fresh
        if sampled.any():
            origin, direction = (a[sampled] for a in self.rays[level])
            place = origin + (self.first_slice + k * self.step) * self.unit * direction
            distance[sampled] = self.oracle(place, np.ones(len(place)))
            needed = self._needs_value(level, k, spacing)[sampled]
            value[sampled] = np.where(needed, self.values(place), value[sampled])
            self.oracle_samples += len(place)
            self.samples += np.count_nonzero(needed)

    def _needs_value(self, level: int, k: int, spacing: float) -> np.ndarray:
        """Pixels from which others may be synthesised, now or before they are sampled again."""
        distance = self.distance[level]
        around = np.pad(distance, 1, mode="edge")
        largest = sliding_window_view(around, (3, 3)).max(axis=(2, 3))
        least = max(level - self.plan.oversampling, 0)
        return (largest >= 0.499 * WITHIN * spacing) | (distance >= self._reach(least, spacing))

    def _reach(self, along: int, spacing: float) -> float:
        """How far a pixel may look that takes part on a slice: reach_of() of cl/pyramid_levels.h."""
        return math.inf if along == self.plan.levels else (2 << along) * self.step + SLACK * spacing

    def _synthesised(self, level: int, around: int) -> tuple[np.ndarray, np.ndarray]:
        """Distance and value of all pixels of a level (and ``around`` more) from the next one (Kraus et al. 2007,
        fig. 7)."""
        n = self.side[level]
        x = np.arange(n + 2 * around) - around
        low = np.floor((x - 1) / 2).astype(int) + 1  # that one counts from the pixel around
        share = np.where(x % 2 == 0, 0.75, 0.25)  # of the pixel behind it
        found = []
        for a in (self.distance[level + 1], self.value[level + 1]):
            rows = a[low] + share[:, None] * (a[low + 1] - a[low])
            found.append(rows[:, low] + share * (rows[:, low + 1] - rows[:, low]))
        return found[0], found[1]

    def _made_of_fresh(self, level: int, around: int) -> np.ndarray:
        n = self.side[level]
        x = np.arange(n + 2 * around) - around
        low = np.floor((x - 1) / 2).astype(int) + 1
        fresh = self.fresh[level + 1]
        rows = fresh[low] & fresh[low + 1]
        return rows[:, low] & rows[:, low + 1]

    def _pixels(self, k: int, along: int, top: int, spacing: float) -> None:
        most = self.plan.levels
        part = self.alive & (self.enter < k + (1 if along < most else 1 << most))
        if along < most:
            part &= self.pixel_distance < (2 << along) * self.step
        if not part.any():
            return
        t = np.clip(float(k), self.enter, self.leave)
        value = np.zeros_like(t)
        sampled = part
        if top > 0:
            wanted, value = self._synthesised(0, 0)
            self.pixel_distance[part] = wanted[part]
            sampled = part & ((self.pixel_distance < WITHIN * spacing) | ~np.isfinite(value))
            self.stale += np.count_nonzero(part & ~sampled & ~self._made_of_fresh(0, 0))
            self.syntheses += np.count_nonzero(part)
        if sampled.any():
            way = (self.first_slice + t[sampled] * self.step) * self.unit
            place = self.origin[sampled] + way[:, None] * self.direction[sampled]
            value[sampled] = self.values(place)
            self.pixel_distance[sampled] = self.oracle(place, 1.0 - self.rgba[sampled, 3])
            self.samples += len(place)
            self.oracle_samples += len(place)
        self._close(part, t, value)

    def _close(self, part: np.ndarray, t: np.ndarray, value: np.ndarray) -> None:
        closes = part & ~self.first & (t > self.t1)
        self.accumulations += np.count_nonzero(closes)
        whole = closes
        if self.surfaces is not None:
            meets = closes & (self.surfaces.next <= self._world(t))
            self._close_at_surfaces(meets, t, value)
            whole = closes & ~meets
        if whole.any():
            length = (t - self.t1)[whole]
            before = np.where(self.second, np.nan, self.value2)[whole]
            a = np.where(self.second, 1.0, self.t1 - self.t2)[whole]
            front, back = shifted_chord(before, self.value1[whole], value[whole], a, length)
            color, depth = of_chord(self.function, front, back, length * self.step * self.unit)
            color, depth = self._look(whole, t - 0.5 * (t - self.t1), color, depth)
            self._composite(whole, color, -np.expm1(-depth))
        self.value2[closes], self.t2[closes] = self.value1[closes], self.t1[closes]
        self.second &= ~closes
        self.value1[part], self.t1[part] = value[part], t[part]
        self.first &= ~part
        self.alive &= ~(part & ((t >= self.leave) | (self.rgba[..., 3] >= self.stop)))

    def _world(self, t: np.ndarray) -> np.ndarray:
        """World lengths along rays, of slices ``t``."""
        return (self.first_slice + t * self.step) * self.unit

    def _composite(self, pixels: np.ndarray, color: np.ndarray, opacity: np.ndarray) -> None:
        weight = (1.0 - self.rgba[pixels, 3]) * opacity
        self.rgba[pixels] += weight[:, None] * np.column_stack([color, np.ones(len(color))])

    def _close_at_surfaces(self, meets: np.ndarray, t: np.ndarray, value: np.ndarray) -> None:
        """Closes segments that surfaces cut: sampled on every slice in between, and cut there as by the ray caster."""
        start, front, before = self.t1.copy(), self.value1.copy(), np.where(self.second, np.nan, self.value2)
        way = np.where(self.second, 1.0, self.t1 - self.t2)
        going = meets.copy()
        while going.any():
            end, back = np.minimum(np.floor(start) + 1.0, t), value.copy()
            refined = going & (end < t)
            if refined.any():
                place = self.origin[refined] + self._world(end)[refined][:, None] * self.direction[refined]
                back[refined] = self.values(place)
                self.samples += len(place)
            ends = shifted_chord(before[going], front[going], back[going], way[going], (end - start)[going])
            color, depth = of_chord(self.function, *ends, np.full(len(ends[0]), self.step * self.unit))
            color, depth = self._look(going, 0.5 * (start + end), color, depth)
            self._cut(going, start, end, color, depth)
            before[going], front[going], way[going] = front[going], back[going], (end - start)[going]
            start = np.where(going, end, start)
            going &= (end < t) & (self.rgba[..., 3] < self.stop)

    def _cut(
        self, pixels: np.ndarray, start: np.ndarray, end: np.ndarray, color: np.ndarray, depth: np.ndarray
    ) -> None:
        """Composites ``pixels`` from slices ``start`` to ``end``, of which a step looks like ``color`` [n, 3] and
        ``depth`` [n], with their surfaces in between."""
        at, until = self._world(start), self._world(end)
        here = pixels.copy()
        while True:
            crosses = here & (self.surfaces.next <= until)
            to = np.where(crosses, self.surfaces.next, until)
            share = (to - at)[pixels] / (self.step * self.unit)
            self._composite(pixels, color, np.where(here[pixels], -np.expm1(-depth * share), 0.0))
            if not crosses.any():
                return
            self._composite(crosses, *self.surfaces.pass_next(crosses, 1.0 - self.rgba[crosses, 3]))
            at = np.where(crosses, to, at)
            here = crosses & (self.rgba[..., 3] < self.stop)

    def _look(self, closes: np.ndarray, middle: np.ndarray, color: np.ndarray, depth: np.ndarray):
        """(colour [n, 3], lit and cued, optical depth [n]) of segments whose middles are on slices ``middle``."""
        scene, direction = self.resolved, self.direction[closes]
        way = self._world(middle)[closes]
        place = self.origin[closes] + way[:, None] * direction
        if self.needs_gradients:
            gradient = self.medium.gradient(place)
            along = np.abs(np.sum(np.where(np.isfinite(gradient), gradient, 0.0) * direction, axis=1))
            for factor, of in zip(self.factors, (_finite_norm(gradient), along)):
                depth = depth if factor is None else depth * _factor(factor, of)
            normal = self.cut_normal[closes]
            share = np.clip(1.0 - (middle - self.enter)[closes] * self.step, 0.0, 1.0)
            share = np.where(np.any(normal != 0, axis=1), share, 0.0)
            color = self.shader.lit(color, place, gradient, direction, cut_normal=normal, cut_share=share)
        return cued(scene.depth_cue, color, way), depth
