"""Regular grids: shape, spacing, origin and direction.

Indices are continuous, in voxels, ordered (x, y, z); arrays are ordered [z, y, x]. A sample sits at
its voxel's centre, so ``world = origin + direction @ (spacing * index)`` and index (0, 0, 0) is the
first voxel's centre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.triples import Triple, triple

# Headers write directions with about six digits; a unit vector may be off by that much.
_UNIT_TOLERANCE = 1e-3
# Unit axes with a smaller determinant count as lying in one plane.
_SINGULAR = 1e-6


class GridFloats(NamedTuple):
    """A grid's numbers as Python's floats, for whoever computes with single points: a call of numpy costs more.

    ``linear``: rows of the matrix from world vectors to index vectors; ``columns``: those of ``Grid.direction``.
    ``middle`` of the domain in indices, ``centre`` in world units; ``half``: half its lengths along its own axes, in
    world units.
    """

    linear: tuple[Triple, Triple, Triple]
    columns: tuple[Triple, Triple, Triple]
    middle: Triple
    centre: Triple
    half: Triple


@dataclass(frozen=True, eq=False, init=False)
class Grid:
    """A regular grid of nx * ny * nz samples in the world.

    ``shape`` is (nz, ny, nx), each at least 1. ``spacing`` is (sx, sy, sz) > 0 in world units.
    ``origin`` is the world position (x, y, z) of voxel [0, 0, 0]. ``direction`` is 3x3 float64;
    column k is the unit world direction of index axis k (x, y, z); None means the identity. Axes may be
    flipped or oblique and need not be orthogonal (a tilted CT gantry), but must span space.

    Raises VolumeError for anything else: a zero, negative or non-finite spacing, a singular or
    non-finite direction, a column that is not a unit vector to three digits.
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: np.ndarray = field(default_factory=lambda: np.eye(3))

    def __init__(
        self,
        shape: Sequence[int],
        spacing: Sequence[float] | np.ndarray = (1.0, 1.0, 1.0),
        origin: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
        direction: np.ndarray | None = None,
    ) -> None:
        object.__setattr__(self, "shape", _shape(shape))
        object.__setattr__(self, "spacing", _triple(spacing, "spacing"))
        if min(self.spacing) <= 0.0:
            raise VolumeError("spacing", _show(self.spacing), "three lengths above zero")
        object.__setattr__(self, "origin", _triple(origin, "origin"))
        matrix = np.eye(3) if direction is None else _matrix(direction, "direction")
        object.__setattr__(self, "direction", _unit_axes(matrix))
        if not np.isfinite(self.world_corners()).all():
            raise VolumeError("spacing and origin", "the grid reaches infinity", "finite corners")

    @classmethod
    def from_steps(
        cls, shape: Sequence[int], steps: np.ndarray, origin: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)
    ) -> Grid:
        """The grid whose index axis k steps by the world vector ``steps[:, k]`` (3x3, world units).

        Spacing is the steps' lengths; signs and rotations go into the direction.
        """
        steps = _matrix(steps, "voxel steps")
        lengths = np.linalg.norm(steps, axis=0)
        if not np.isfinite(lengths).all() or lengths.min() <= 0.0:
            raise VolumeError("spacing", _show(lengths), "three lengths above zero")
        return cls(shape, lengths, origin, steps / lengths)

    @property
    def size(self) -> tuple[int, int, int]:
        """Voxels along (x, y, z)."""
        nz, ny, nx = self.shape
        return nx, ny, nz

    @property
    def smallest_edge(self) -> float:
        """The shortest voxel edge, world units."""
        return min(self.spacing)

    @cached_property
    def _index_to_world(self) -> np.ndarray:
        matrix = np.eye(4)
        matrix[:3, :3] = self.direction * np.asarray(self.spacing)
        matrix[:3, 3] = self.origin
        return matrix

    def index_to_world(self) -> np.ndarray:
        """4x4 float64: continuous index (x, y, z, 1) to world (x, y, z, 1)."""
        return self._index_to_world.copy()

    def world_to_index(self) -> np.ndarray:
        """4x4 float64: the inverse of ``index_to_world``."""
        return self._world_to_index.copy()

    @cached_property
    def _world_to_index(self) -> np.ndarray:
        matrix = np.eye(4)
        matrix[:3, :3] = np.linalg.inv(self.direction) / np.asarray(self.spacing)[:, None]
        matrix[:3, 3] = -(matrix[:3, :3] @ np.asarray(self.origin))
        return matrix

    def index_bounds(self) -> np.ndarray:
        """(2, 3) float64: lower and upper index (x, y, z) of the domain.

        The domain is the hull of the voxel centres, [0, n - 1]; an axis with one voxel is a slab
        one voxel thick, [-0.5, 0.5].
        """
        size = np.asarray(self.size, dtype=np.float64)
        thin = size == 1
        return np.stack([np.where(thin, -0.5, 0.0), np.where(thin, 0.5, size - 1.0)])

    @cached_property
    def in_floats(self) -> GridFloats:
        """``GridFloats`` of this grid."""
        lower, upper = self.index_bounds()
        middle = 0.5 * (lower + upper)
        centre = (self._index_to_world @ np.append(middle, 1.0))[:3]
        half = 0.5 * (upper - lower) * np.asarray(self.spacing)
        rows = self._world_to_index[:3, :3], self.direction.T
        linear, columns = ((triple(x), triple(y), triple(z)) for x, y, z in rows)
        return GridFloats(linear, columns, triple(middle), triple(centre), triple(half))

    def world_corners(self) -> np.ndarray:
        """(8, 3) float64: the domain's corners in world space, x changing fastest, then y, z."""
        return self._world_corners.copy()

    @cached_property
    def _world_corners(self) -> np.ndarray:
        bounds = self.index_bounds()
        corner = np.arange(8)
        pick = np.stack([corner & 1, (corner >> 1) & 1, corner >> 2], axis=1)
        index = np.take_along_axis(bounds, pick, axis=0)
        with np.errstate(over="ignore", invalid="ignore"):
            return index @ self._index_to_world[:3, :3].T + self._index_to_world[:3, 3]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Grid):
            return NotImplemented
        return (self.shape, self.spacing, self.origin) == (
            other.shape,
            other.spacing,
            other.origin,
        ) and np.array_equal(self.direction, other.direction)

    def __hash__(self) -> int:
        return hash((self.shape, self.spacing, self.origin, tuple(self.direction.ravel())))


def _show(values: Sequence[float] | np.ndarray) -> str:
    return "(" + ", ".join(f"{float(value):g}" for value in values) + ")"


def _shape(shape: Sequence[int]) -> tuple[int, int, int]:
    try:
        nz, ny, nx = numbers = tuple(int(n) for n in shape)
        whole = all(n == m and n >= 1 for n, m in zip(numbers, shape))
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole:
        raise VolumeError("shape", str(shape), "three sizes (nz, ny, nx) of at least 1")
    return nz, ny, nx


def _triple(values: Sequence[float] | np.ndarray, name: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(value) for value in values)
    except (TypeError, ValueError):
        if np.ndim(values) == 0 and not isinstance(values, (str, bytes)):
            expected = f"three numbers (x, y, z), such as ({values}, {values}, {values})"
            raise VolumeError(name, f"got {values!r}"[:80], expected) from None
        x = y = z = math.nan
    if not all(math.isfinite(number) for number in (x, y, z)):
        raise VolumeError(name, str(values), "three finite numbers (x, y, z)")
    return x, y, z


def _matrix(values: object, name: str) -> np.ndarray:
    try:
        matrix = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise VolumeError(name, str(values), "a 3x3 matrix of finite numbers")
    return matrix


def _unit_axes(direction: np.ndarray) -> np.ndarray:
    """``direction`` with columns of exactly unit length, read-only.

    Raises VolumeError if a column is not a unit vector to three digits, or if the columns do not span space.
    """
    lengths = np.linalg.norm(direction, axis=0)
    if np.abs(lengths - 1.0).max() > _UNIT_TOLERANCE:
        raise VolumeError("direction", f"columns of length {_show(lengths)}", "columns of length 1")
    direction = direction / lengths
    if abs(np.linalg.det(direction)) < _SINGULAR:
        rows = "; ".join(_show(row) for row in direction)
        raise VolumeError("direction", f"singular matrix [{rows}]", "three axes that span space")
    direction.flags.writeable = False
    return direction
