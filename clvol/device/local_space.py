"""The space in which kernels compute lighting, clips and gradients."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clvol.volume import Grid


class LocalSpace:
    """A space with the axes of the world, its origin in the middle of the volume, and the smallest voxel edge as unit.

    ``matrix`` float64 [3, 3] and ``shift`` [3] map lattice points to local ones. ``inverse_transpose``
    maps derivatives per lattice unit to derivatives per edge.
    """

    def __init__(self, grid: Grid, size: tuple[int, int, int]) -> None:
        self.unit = grid.smallest_edge
        self.matrix = np.asarray(grid.direction) * (np.asarray(grid.spacing) / self.unit)
        self.shift = -self.matrix @ (0.5 * (np.asarray(size, np.float64) - 1.0))
        self.inverse_transpose = np.linalg.inv(self.matrix).T
        lower, upper = grid.index_bounds()
        self._to_world = grid.index_to_world()
        self.centre = (self._to_world @ np.append(0.5 * (lower + upper), 1.0))[:3]

    def point(self, world: ArrayLike) -> np.ndarray:
        """A world point in local coordinates."""
        return (np.asarray(world, np.float64) - self.centre) / self.unit


def unit_vector(vector: ArrayLike) -> np.ndarray:
    """``vector`` at length 1; scaled first, so that no square over- or underflows."""
    scaled = np.asarray(vector, np.float64)
    scaled = scaled / np.abs(scaled).max()
    return scaled / np.linalg.norm(scaled)
