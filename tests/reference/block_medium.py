"""The field of blocks as the twin's medium: values blended between blocks, and gradients as differences of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.volume import Grid
from reference.field import GridSampler
from reference.multiresolution import BlockField

_PER_AXIS = np.eye(3)


@dataclass
class _SurfaceField:
    """What surfaces are found in: the field at the lattice points, trilinear between them (cl/cell_blocks.h)."""

    value: GridSampler
    filter: str = "linear"


class BlockMediumField:
    """In the place of ``reference.field.Field``: ``blocks`` over a volume's ``grid``. Places beyond the volume's faces
    are taken back to them."""

    filter = "linear"

    def __init__(self, blocks: BlockField, grid: Grid) -> None:
        self.blocks, self.grid = blocks, grid
        self._to_index = grid.world_to_index()
        self._upper = np.asarray(blocks.grid.shape[::-1], np.float64) - 1.0
        z, y, x = np.indices(blocks.grid.shape)
        lattice = self._at(np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float64)).reshape(z.shape)
        self.of_surfaces = _SurfaceField(GridSampler(lattice, grid))

    def value(self, world: np.ndarray) -> np.ndarray:
        """[n] at world places [n, 3]."""
        return self._at(self._index(world))

    def gradient(self, world: np.ndarray) -> np.ndarray:
        """Derivative [n, 3] of the value per world length: differences over a voxel to each side. Beyond a face the
        field goes on in a straight line."""
        index = self._index(world)
        slopes = []
        for axis in _PER_AXIS:
            low, high = (self._beyond(index + side * axis) for side in (-1.0, 1.0))
            slopes.append(0.5 * (high - low) * (self._upper @ axis > 0))
        return np.stack(slopes, axis=-1) @ self._to_index[:3, :3]

    def _index(self, world: np.ndarray) -> np.ndarray:
        index = world @ self._to_index[:3, :3].T + self._to_index[:3, 3]
        return np.clip(index, 0.0, self._upper)

    def _at(self, index: np.ndarray) -> np.ndarray:
        return self.blocks(index + 0.5)

    def _beyond(self, index: np.ndarray) -> np.ndarray:
        face = np.clip(index, 0.0, self._upper)
        inside = np.clip(2.0 * face - index, 0.0, self._upper)
        mirrored = (index != face).any(axis=1)
        return np.where(mirrored, 2.0 * self._at(face) - self._at(inside), self._at(index))
