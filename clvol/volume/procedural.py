"""Analytic fields with known line integrals, for tests and demonstrations.

A field is called with world coordinates ``field(x, y, z)`` (arrays that broadcast, float64) and
gives values of the same shape. ``field.line_integral(axis, lower, upper, x, y, z)`` is the exact
integral of the field along a line parallel to world axis ``axis`` (0, 1, 2 for x, y, z) from
coordinate ``lower`` to ``upper``; the line runs through (x, y, z), whose own coordinate on that
axis is ignored. ``sample`` puts a field on a grid. Samples are values at voxel centres, so a
trilinear reconstruction agrees with a field between samples only where the field is linear.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import DTypeLike

from clvol.errors import VolumeError
from clvol.volume.grid import Grid
from clvol.volume.volume import Volume, check_type

Triple = tuple[float, float, float]
_ZERO = np.zeros(())  # the start of sums of arrays


class Field(Protocol):
    """A field that ``sample`` can put on a grid, with the integrals that tests compare with."""

    def __call__(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Values at world positions."""

    def line_integral(
        self, axis: int, lower: float, upper: float, x: float, y: float, z: float
    ) -> np.ndarray:
        """Integral along ``axis`` from ``lower`` to ``upper`` through (x, y, z)."""


@dataclass(frozen=True)
class Constant:
    """f = value."""

    value: float = 1.0

    def __call__(self, x, y, z):
        return np.full(np.broadcast(x, y, z).shape, float(self.value))

    def line_integral(self, axis, lower, upper, x, y, z):
        return self.value * (upper - lower) + 0.0 * _zeros(x, y, z)


@dataclass(frozen=True)
class LinearRamp:
    """f = offset + gradient . p. Trilinear interpolation reproduces it exactly."""

    gradient: Triple = (1.0, 0.0, 0.0)
    offset: float = 0.0

    def __call__(self, x, y, z):
        gx, gy, gz = self.gradient
        return self.offset + gx * np.asarray(x, float) + gy * np.asarray(y) + gz * np.asarray(z)

    def line_integral(self, axis, lower, upper, x, y, z):
        point = [x, y, z]
        point[axis] = 0.5 * (lower + upper)
        return self(*point) * (upper - lower)


@dataclass(frozen=True)
class Step:
    """f = below where p[axis] < position, else above."""

    axis: int = 0
    position: float = 0.0
    below: float = 0.0
    above: float = 1.0

    def __call__(self, x, y, z):
        here = np.asarray((x, y, z)[self.axis])
        return np.where(here < self.position, self.below, self.above) + _zeros(x, y, z)

    def line_integral(self, axis, lower, upper, x, y, z):
        if axis != self.axis:
            return self(x, y, z) * (upper - lower)
        middle = min(max(self.position, lower), upper)
        total = self.below * (middle - lower) + self.above * (upper - middle)
        return total + _zeros(x, y, z)


@dataclass(frozen=True)
class NestedBoxes:
    """f = value of the innermost box |p - center| <= half (each axis) that holds p, else outside.

    ``halves`` are the half edges, outermost box first, each within the one before.
    """

    center: Triple = (0.0, 0.0, 0.0)
    halves: tuple[Triple, ...] = ((3.0, 3.0, 3.0), (2.0, 2.0, 2.0), (1.0, 1.0, 1.0))
    values: tuple[float, ...] = (0.25, 0.5, 1.0)
    outside: float = 0.0

    def __call__(self, x, y, z):
        value = np.full(np.broadcast(x, y, z).shape, float(self.outside))
        for half, inside in zip(self.halves, self.values):
            value = np.where(self._holds(half, (0, 1, 2), (x, y, z)), inside, value)
        return value

    def line_integral(self, axis, lower, upper, x, y, z):
        total = self.outside * (upper - lower) + _zeros(x, y, z)
        others = tuple(k for k in range(3) if k != axis)
        before = self.outside
        for half, inside in zip(self.halves, self.values):
            start = max(lower, self.center[axis] - half[axis])
            length = max(0.0, min(upper, self.center[axis] + half[axis]) - start)
            total = total + np.where(
                self._holds(half, others, (x, y, z)), (inside - before) * length, 0.0
            )
            before = inside
        return total

    def _holds(self, half: Triple, axes: Sequence[int], point: tuple) -> np.ndarray:
        held = np.array(True)
        for k in axes:
            held = held & (np.abs(np.asarray(point[k]) - self.center[k]) <= half[k])
        return held


@dataclass(frozen=True)
class Ball:
    """f = inside where |p - center| <= radius, else outside."""

    center: Triple = (0.0, 0.0, 0.0)
    radius: float = 1.0
    inside: float = 1.0
    outside: float = 0.0

    def __call__(self, x, y, z):
        within = _distance_squared((x, y, z), self.center, (0, 1, 2)) <= self.radius**2
        return np.where(within, self.inside, self.outside)

    def line_integral(self, axis, lower, upper, x, y, z):
        others = [k for k in range(3) if k != axis]
        left = self.radius**2 - _distance_squared((x, y, z), self.center, others)
        half = np.sqrt(np.maximum(left, 0.0))
        start = np.maximum(lower, self.center[axis] - half)
        length = np.maximum(0.0, np.minimum(upper, self.center[axis] + half) - start)
        return self.outside * (upper - lower) + (self.inside - self.outside) * length


@dataclass(frozen=True)
class RadialFall:
    """f = peak at the centre, falling linearly to 0 at the ellipsoid with the half axes ``radii``,
    and 0 outside: peak max(0, 1 - |(p - center) / radii|)."""

    center: Triple = (0.0, 0.0, 0.0)
    radii: Triple = (1.0, 1.0, 1.0)
    peak: float = 1.0

    def __call__(self, x, y, z):
        return self.peak * np.maximum(1.0 - np.sqrt(self._squared((x, y, z), (0, 1, 2))), 0.0)

    def line_integral(self, axis, lower, upper, x, y, z):
        near = self._squared((x, y, z), [k for k in range(3) if k != axis])
        reach = np.sqrt(np.maximum(1.0 - near, 0.0))
        ends = ((end - self.center[axis]) / self.radii[axis] for end in (lower, upper))
        start, stop = (np.clip(end, -reach, reach) for end in ends)
        whole = self._fallen(stop, near) - self._fallen(start, near)
        return self.peak * self.radii[axis] * np.where(near < 1.0, whole, 0.0)

    @staticmethod
    def _fallen(t: np.ndarray, near: np.ndarray) -> np.ndarray:
        """The integral of 1 - sqrt(near + t^2) from 0 to t."""
        off = np.sqrt(np.where(near > 0, near, 1.0))
        turned = np.where(near > 0, near * np.arcsinh(t / off), 0.0)
        return t - 0.5 * (t * np.sqrt(near + t * t) + turned)

    def _squared(self, point: tuple, axes: Sequence[int]) -> np.ndarray:
        squares = (((np.asarray(point[k], float) - self.center[k]) / self.radii[k]) ** 2 for k in axes)
        return sum(squares, start=_ZERO)


@dataclass(frozen=True)
class Smooth:
    """f = offset + sum_i amplitude_i * sin(wave_i . p + phase_i), waves in radians per unit."""

    waves: tuple[Triple, ...] = ((0.31, 0.0, 0.17), (0.0, 0.23, -0.29), (0.11, 0.19, 0.13))
    amplitudes: tuple[float, ...] = (0.2, 0.15, 0.1)
    phases: tuple[float, ...] = (0.3, 1.1, 2.0)
    offset: float = 0.5

    def __call__(self, x, y, z):
        value = self.offset + _zeros(x, y, z)
        for wave, amplitude, phase in self._terms():
            value = value + amplitude * np.sin(_dot(wave, (x, y, z)) + phase)
        return value

    def line_integral(self, axis, lower, upper, x, y, z):
        length = upper - lower
        point = [x, y, z]
        point[axis] = 0.5 * (lower + upper)
        total = self.offset * length + _zeros(x, y, z)
        for wave, amplitude, phase in self._terms():
            # The integral of a sine over an interval: its middle value times a sinc.
            middle = np.sin(_dot(wave, point) + phase)
            total = total + amplitude * middle * length * np.sinc(
                wave[axis] * length / (2.0 * np.pi)
            )
        return total

    def _terms(self):
        return zip(self.waves, self.amplitudes, self.phases)


@dataclass(frozen=True)
class Gaussian:
    """f = amplitude * exp(-|p - center|^2 / (2 sigma^2))."""

    center: Triple = (0.0, 0.0, 0.0)
    sigma: float = 1.0
    amplitude: float = 1.0

    def __call__(self, x, y, z):
        return self._at((x, y, z), (0, 1, 2))

    def line_integral(self, axis, lower, upper, x, y, z):
        scale = self.sigma * math.sqrt(2.0)
        end = math.erf((upper - self.center[axis]) / scale)
        start = math.erf((lower - self.center[axis]) / scale)
        along = self.sigma * math.sqrt(math.pi / 2.0) * (end - start)
        return along * self._at((x, y, z), [k for k in range(3) if k != axis])

    def _at(self, point: tuple, axes: Sequence[int]) -> np.ndarray:
        squared = _distance_squared(point, self.center, axes)
        return self.amplitude * np.exp(-squared / (2.0 * self.sigma**2))


@dataclass(frozen=True)
class Checkerboard:
    """f = high where floor(x/cell) + floor(y/cell) + floor(z/cell) is even, else low."""

    cell: float = 4.0
    low: float = 0.0
    high: float = 1.0

    def __call__(self, x, y, z):
        parity = sum(np.floor(np.asarray(c) / self.cell) for c in (x, y, z)) % 2.0
        return np.where(parity == 0.0, self.high, self.low)

    def line_integral(self, axis, lower, upper, x, y, z):
        others = [c for k, c in enumerate((x, y, z)) if k != axis]
        parity = sum(np.floor(np.asarray(c) / self.cell) for c in others) % 2.0
        even = self.cell * (self._even_length(upper) - self._even_length(lower))
        high = np.where(parity == 0.0, even, (upper - lower) - even)
        return self.low * (upper - lower) + (self.high - self.low) * high

    def _even_length(self, end: float) -> float:
        """Length of the even cells between 0 and ``end``, in cells; negative below 0."""
        cells = end / self.cell
        pairs = math.floor(cells / 2.0)
        return pairs + min(cells - 2.0 * pairs, 1.0)


@dataclass(frozen=True)
class MarschnerLobb:
    """f = (1 - sin(pi z/2) + alpha (1 + cos(2 pi fm cos(pi r/2)))) / (2 (1 + alpha)), r = |(x, y)|.

    Meant for [-1, 1]^3 at 41^3 samples; values lie in [0, 1]. Marschner & Lobb, "An evaluation of
    reconstruction filters for volume rendering", Visualization '94, section 5. The integral along z
    is closed; along x and y it is Gauss-Legendre quadrature, exact to about 1e-13.
    """

    frequency: float = 6.0
    alpha: float = 0.25

    def __call__(self, x, y, z):
        return (
            1.0 - np.sin(0.5 * np.pi * np.asarray(z, float)) + self._rings(x, y)
        ) / (2.0 * (1.0 + self.alpha))

    def line_integral(self, axis, lower, upper, x, y, z):
        if axis == 2:
            end, start = math.cos(0.5 * math.pi * upper), math.cos(0.5 * math.pi * lower)
            length = upper - lower
            total = length + (end - start) * 2.0 / math.pi + self._rings(x, y) * length
            return total / (2.0 * (1.0 + self.alpha))
        nodes, weights = np.polynomial.legendre.leggauss(16)
        panels = max(64, math.ceil(64 * abs(upper - lower)))
        edges = np.linspace(lower, upper, panels + 1)
        half = 0.5 * (upper - lower) / panels
        total = _zeros(x, y, z)
        for middle in 0.5 * (edges[:-1] + edges[1:]):
            for node, weight in zip(nodes, weights):
                point = [x, y, z]
                point[axis] = middle + half * node
                total = total + weight * half * self(*point)
        return total

    def _rings(self, x, y) -> np.ndarray:
        r = np.hypot(np.asarray(x, float), y)
        wave = np.cos(2.0 * np.pi * self.frequency * np.cos(0.5 * np.pi * r))
        return self.alpha * (1.0 + wave)


def sample(
    field: Field,
    shape: Sequence[int],
    spacing: Sequence[float] = (1.0, 1.0, 1.0),
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    direction: np.ndarray | None = None,
    dtype: DTypeLike = np.float32,
    name: str | None = None,
) -> Volume:
    """A volume with the field's values at the voxel centres; ``shape`` is (nz, ny, nx).

    For an integer ``dtype`` values are rounded to the nearest; VolumeError where they do not fit.
    """
    native = check_type(np.dtype(dtype), "dtype")
    grid = Grid(shape, spacing, origin, direction)
    nz, ny, nx = grid.shape
    data = sample_box(field, grid, native, (slice(0, nz), slice(0, ny), slice(0, nx)))
    return Volume(data, grid.spacing, grid.origin, grid.direction, name, frame="world")


def sample_box(
    field: Field, grid: Grid, dtype: np.dtype, box: tuple[slice, slice, slice]
) -> np.ndarray:
    """The voxels in ``box`` [z, y, x] of the volume that ``sample`` would make, without any others."""
    along_z, along_y, along_x = (np.arange(s.start, s.stop, dtype=np.float64) for s in box)
    matrix = grid.index_to_world()[:3]
    i, j = along_x, along_y[:, None]
    data = np.empty((len(along_z), len(along_y), len(along_x)), dtype=dtype)
    for layer, k in zip(data, along_z):
        x, y, z = (row[0] * i + row[1] * j + (row[2] * k + row[3]) for row in matrix)
        values = field(x, y, z)
        if dtype.kind in "iu":
            values = np.rint(values)
            limits = np.iinfo(dtype)
            if values.min() < limits.min or values.max() > limits.max:
                raise VolumeError("dtype", f"values outside {dtype}", "a type that holds them")
        layer[...] = values
    return data


MIDDLE = 128.0  # of the range of a byte, so that noise of either sign can be added


def scene_field(
    kind: str, size: Sequence[int], spacing: Sequence[float] = (1.0, 1.0, 1.0)
) -> Volume:
    """The volume that [volume] field = ``kind`` stands for: ``size`` (nx, ny, nz) uint8 voxels, origin at 0.

    "radial": 255 in the middle, falling linearly to 0 at the distance of the nearest face.
    "ellipsoid": likewise, to 0 at the ellipsoid that touches all faces. "constant": MIDDLE.
    """
    field, grid = placed_field(kind, size, spacing)
    return sample(field, grid.shape, spacing, dtype=np.uint8, name=kind)


def placed_field(
    kind: str, size: Sequence[int], spacing: Sequence[float] = (1.0, 1.0, 1.0)
) -> tuple[Field, Grid]:
    """The field and the grid of ``scene_field``, without its voxels."""
    grid = Grid(tuple(size)[::-1], tuple(spacing))
    lower, upper = grid.index_bounds() * np.asarray(spacing)
    center, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    field: Field = Constant(MIDDLE)
    if kind != "constant":
        radii = half if kind == "ellipsoid" else np.full(3, half.min())
        field = RadialFall(tuple(center), tuple(radii), 255.0)
    return field, grid


def unit_box(shape: Sequence[int]) -> tuple[Triple, Triple]:
    """Spacing and origin that put a grid's domain on [-1, 1]^3; ``shape`` (nz, ny, nx) > 1."""
    nz, ny, nx = shape
    return (2.0 / (nx - 1), 2.0 / (ny - 1), 2.0 / (nz - 1)), (-1.0, -1.0, -1.0)


def _zeros(x, y, z) -> np.ndarray:
    return np.zeros(np.broadcast(x, y, z).shape)


def _dot(wave: Triple, point: Sequence) -> np.ndarray:
    return sum((k * np.asarray(c, float) for k, c in zip(wave, point)), start=_ZERO)


def _distance_squared(point: Sequence, center: Triple, axes: Sequence[int]) -> np.ndarray:
    return sum(((np.asarray(point[k], float) - center[k]) ** 2 for k in axes), start=_ZERO)
