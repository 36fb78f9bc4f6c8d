"""Rays through a volume of which only bricks are on the device: those that a frame needs, or a group of its tiles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clvol.device.brick_pool import BrickPool, BrickSource
from clvol.device.memory import Perturbation
from clvol.device.tile_effects import tile_ranges
from clvol.device.view import RayFrame
from clvol.device.volume import ResidentVolume
from clvol.errors import SceneError
from clvol.features import FILTER_REACH
from clvol.integrators.raycast.caster import Raycaster, TilesDone
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.scene.sizes import format_size
from clvol.schedule.tiles import TILE, tiling
from clvol.volume.voxel_layout import CELL_SHIFT, cell_count

# Voxels beyond a visible cell that rays and gradients use: a ray takes up to 8 samples before it looks for empty space
# again (MARCH_STEPS of cl/march.h), and begins two before what is visible.
_SAMPLES_BEYOND, _GRADIENT_REACH = 10, 2


class BrickVolume(ResidentVolume):
    """A volume as a ``BrickPool``. It has no array of all voxels, and therefore no stored gradients."""

    def __init__(self, context: DeviceContext, source: BrickSource, memory_bytes: int, **layout: bool) -> None:
        self.pool = BrickPool(context, source, memory_bytes, **layout)
        self.values = self.pool.values
        low, high = self.values(source.value_range)
        self._value_range = float(low), float(high)
        self.voxels, self.switches, self.stride = self.pool.voxels, self.pool.switches, self.pool.stride
        nz, ny, nx = source.blocks.shape
        self.size = max(nx, 2), max(ny, 2), max(nz, 2)
        self.cells = cell_count(self.size[0]), cell_count(self.size[1]), cell_count(self.size[2])
        self.cell_shift = CELL_SHIFT
        self._name = source.name
        self._bounds = {CELL_SHIFT: self._mapped(CELL_SHIFT)}

    @property
    def value_range(self) -> tuple[float, float]:
        return self._value_range

    def bounds(self, apron: int) -> tuple[np.ndarray, np.ndarray]:
        """As in ``ResidentVolume``, with an apron of a whole cell."""
        low, high = self._bounds[CELL_SHIFT]
        return (low, high) if not apron else _around(low, high)

    def min_max(self, shift: int) -> tuple[np.ndarray, np.ndarray]:
        if shift not in self._bounds:
            self._bounds[shift] = self._mapped(shift)
        return self._bounds[shift]

    def _mapped(self, shift: int) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = (cell_count(n, shift) for n in self.size)
        found = self.pool.bounds(shift)[:z, :y, :x].astype(np.float64)
        with np.errstate(over="ignore"):
            return self.values(found[..., 0]), self.values(found[..., 1])


def _around(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The bounds of each cell and its neighbours; low > high where none of them has a finite value."""
    empty = low > high
    low, high = np.where(empty, np.inf, low), np.where(empty, -np.inf, high)
    for axis in range(3):
        for array, combine in ((low, np.minimum), (high, np.maximum)):
            padded = np.pad(array, [(1, 1) if k == axis else (0, 0) for k in range(3)], mode="edge")
            n = array.shape[axis]
            views = [np.take(padded, np.arange(k, k + n), axis=axis) for k in range(3)]
            array[...] = combine(combine(views[0], views[1]), views[2])
    empty = low > high
    return np.where(empty, 1.0, low), np.where(empty, 0.0, high)


class BrickCaster(Raycaster):
    """As ``Raycaster``, with a ``BrickVolume``: before tiles are rendered, the bricks that their rays may need are made
    resident. Where the pool does not hold those of a whole frame, tiles are rendered in groups, one after the other.

    The picture is that of ``Raycaster`` bit for bit. SceneError where the pool does not hold the bricks of one tile, or,
    for rays that leave their tile (refraction, shadow rays), all that show anything; it says how much memory would do.
    """

    volume: BrickVolume

    def __init__(
        self,
        context: DeviceContext,
        resolved: ResolvedScene,
        volume: BrickVolume,
        *,
        lanes: int | None = None,
        skip: bool = True,
        tile: tuple[int, int] = (TILE, TILE),
    ) -> None:
        super().__init__(context, resolved, lanes=lanes, skip=skip, tile=tile, volume=volume)

    def _empty_space_found(self, mask: np.ndarray) -> None:
        """``needed``: the numbers of the blocks in which rays, and what they look at beside them, may need voxels."""
        blocks = self.volume.pool.blocks
        self.needed = np.arange(blocks.count)
        if self.skip:
            self.needed = np.flatnonzero(blocks_near(mask, self._reach, blocks.counts, blocks.edge))

    @property
    def _reach(self) -> np.ndarray:
        """Voxels (z, y, x) from a visible cell to what a ray may sample because of it."""
        grid = self.resolved.volume.grid
        moved: Perturbation = self._moved
        steps = _SAMPLES_BEYOND * self.resolved.integration.step * grid.smallest_edge
        samples = steps / np.asarray(grid.spacing)[::-1]
        beside = FILTER_REACH[self.resolved.integration.filter] + _GRADIENT_REACH
        return samples + beside + (np.asarray(moved.cells)[::-1] << CELL_SHIFT)
