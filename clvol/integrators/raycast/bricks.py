"""Rays through a volume of which only bricks are on the device: those that a frame needs, or a group of its tiles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from clvol.device.brick_pool import BrickPool, BrickSource
from clvol.device.empty_space import spread
from clvol.device.light_volume import METHODS
from clvol.device.tile_ranges import Ranges, tile_ranges
from clvol.device.view import EVERY_PIXEL, Pixels, RayFrame
from clvol.device.volume import ResidentVolume
from clvol.device.voxel_boxes import LEAST_UNIT, VoxelBox, box_bytes, box_places
from clvol.errors import SceneError
from clvol.features import FILTER_REACH
from clvol.integrators.base import FrameData, Progress
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.march import March
from clvol.integrators.raycast.tile_groups import tile_groups
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.schedule.tiles import TILE
from clvol.store.geometry import BlockGrid
from clvol.transfer import TransferFunction
from clvol.volume.voxel_layout import CELL_SHIFT, FINE_SHIFT, cell_count

# Voxels beyond a visible cell that rays and gradients use: a ray takes up to 8 samples before it looks for empty space
# again (MARCH_STEPS of cl/march.h), and begins two before what is visible.
_SAMPLES_BEYOND, _GRADIENT_REACH = 10, 2


class BrickVolume(ResidentVolume):
    """A volume as a ``BrickPool``. It has no array of all voxels, and therefore no stored gradients."""

    has_fine_bounds = True

    def __init__(
        self, context: DeviceContext, source: BrickSource, memory_bytes: int | None = None, **layout: Any
    ) -> None:
        self._context = context
        self.pool = BrickPool(context, source, memory_bytes, **layout)
        self.values = self.pool.values
        low, high = self.values(source.value_range)
        self._value_range = float(low), float(high)
        self.switches, self.stride = self.pool.switches, self.pool.stride
        nz, ny, nx = source.blocks.shape
        self.size = max(nx, 2), max(ny, 2), max(nz, 2)
        self.cells = cell_count(self.size[0]), cell_count(self.size[1]), cell_count(self.size[2])
        self.cell_shift = CELL_SHIFT
        self.layout = {"BRICKS": self.switches["BRICKS"], "VOXEL_PAIRS": self.switches["VOXEL_PAIRS"]}
        self._found: dict[int, np.ndarray] = {}  # by the shift of cells, in the voxels' own type
        self._bounds = {CELL_SHIFT: self._mapped(CELL_SHIFT)}

    @property
    def voxels(self) -> DeviceArray:  # type: ignore[override]  # the pool may grow
        return self.pool.voxels

    @property
    def value_range(self) -> tuple[float, float]:
        return self._value_range

    def bounds(self, apron: int) -> tuple[np.ndarray, np.ndarray]:
        """As in ``ResidentVolume``, with an apron of a whole cell."""
        low, high = self._bounds[CELL_SHIFT]
        return (low, high) if not apron else _around(low, high)

    def fine_bounds(self, apron: int, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As in ``ResidentVolume``, with an apron of a whole cell."""
        low, high = self.min_max(FINE_SHIFT)
        low, high = (low, high) if not apron else _around(low, high)
        return low[wanted], high[wanted]

    def min_max(self, shift: int) -> tuple[np.ndarray, np.ndarray]:
        if shift not in self._bounds:
            self._bounds[shift] = self._mapped(shift)
        return self._bounds[shift]

    def plain(self) -> DeviceArray:
        """As in ``ResidentVolume``; decoded anew by each call, beside what the pool may hold."""
        return self._box((0, 0), (self.size[1], self.size[2]))

    def boxes(self, halo: tuple[int, int]) -> Iterator[VoxelBox]:
        """As in ``ResidentVolume``: each box is decoded into memory that the pool gives up until a frame needs bricks.
        SceneError where that is not enough for one box."""
        pool, (nx, ny, nz) = self.pool, self.size
        row, most, unit = nx * pool.dtype.itemsize, pool.free_bytes, max(LEAST_UNIT, self.pool.blocks.edge)
        if (needed := box_bytes((ny, nz), halo, row, unit)) > most:
            expected = f"at least {pool.memory_bytes - most + needed} bytes for finding out what is visible"
            raise SceneError("compression.memory", f"got {pool.memory_bytes} bytes", expected)
        pool.release()
        for place in box_places((ny, nz), halo, row, most, unit):
            yield VoxelBox(self._box(place.first, place.last), place)

    def _box(self, first: tuple[int, int], last: tuple[int, int]) -> DeviceArray:
        """The voxels [z, y, x] of all rows from ``first`` to before ``last`` (y, z)."""
        real = self.pool.blocks.shape
        shape = min(last[1], real[0]) - first[1], min(last[0], real[1]) - first[0], real[2]
        box = self._context.empty(self.pool.dtype, shape)
        self.pool.put_box(box, (first[1], first[0], 0))
        if 1 not in real:
            return box
        voxels = self._context.read(box)
        for axis, n in enumerate(real):
            voxels = np.repeat(voxels, 2, axis=axis) if n == 1 else voxels
        return self._context.upload(voxels)

    def _mapped(self, shift: int) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = (cell_count(n, shift) for n in self.size)
        finest = min(shift, FINE_SHIFT, self.switches["BRICKS"])
        if finest not in self._found:  # takes every brick in turn
            self._found[finest] = self.pool.bounds(finest)
        found = self._found[finest].astype(np.float64)
        low, high = found[..., 0], found[..., 1]
        if finest < shift:
            low, high = _joined(low, high, 1 << (shift - finest))
        low, high = low[:z, :y, :x], high[:z, :y, :x]
        with np.errstate(over="ignore"):
            return self.values(low), self.values(high)


def _joined(low: np.ndarray, high: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """The bounds of cells of ``parts``^3 smaller ones."""
    empty = low > high
    low, high = np.where(empty, np.inf, low), np.where(empty, -np.inf, high)
    for axis in range(3):
        at = np.arange(0, low.shape[axis], parts)
        low, high = np.minimum.reduceat(low, at, axis=axis), np.maximum.reduceat(high, at, axis=axis)
    empty = low > high
    return np.where(empty, 1.0, low), np.where(empty, 0.0, high)


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

    The picture is that of ``Raycaster`` bit for bit. SceneError where the pool does not hold the bricks of one tile,
    or, for rays that leave their tile (refraction, shadow rays), all that show anything; it says how much memory would
    do.
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
        march: March | None = None,
    ) -> None:
        super().__init__(context, resolved, lanes=lanes, skip=skip, tile=tile, volume=volume, march=march)

    def set_transfer_function(self, function: TransferFunction) -> None:
        self._needed: np.ndarray | None = None
        self._last: tuple[tuple, int, Ranges] | None = None
        super().set_transfer_function(function)

    def for_scene(self, resolved: ResolvedScene) -> BrickCaster:
        other = super().for_scene(resolved)
        other._needed = other._last = None
        return other

    @property
    def needed(self) -> np.ndarray:
        """int64: the numbers of the blocks in which rays, and what they look at beside them, may need voxels."""
        if self._needed is None:
            blocks = self.volume.pool.blocks
            self._needed = blocks_near(self.shown, self._reach, blocks) if self._skips else np.arange(blocks.count)
        return self._needed

    @property
    def _skips(self) -> bool:
        """Whether rays take no sample far from what is visible. Some marches do, of the last pieces of rays."""
        return self.skip and not self.effects.switches and self.resolved.integration.quadrature == "steps"

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:
        """As ``Raycaster.render``; the notes say what was decoded for the frame, and what is on the device."""
        data = super().render(camera, width, height, progress, depth, lattice)
        pool = self.volume.pool
        data.notes["compression"] = {"device_bytes": pool.device_bytes, "decoded_voxels": pool.take_filled()}
        return data

    def _build_shadows(self) -> None:
        self._hold(self.needed, "the light volume")
        super()._build_shadows()

    def _build_occlusion(self) -> None:
        if self.effects.switches.get("AMBIENT_OCCLUSION"):
            self._hold(self.needed, "the ambient occlusion")
        super()._build_occlusion()

    @property
    def _reach(self) -> np.ndarray:
        """Voxels (z, y, x) from a visible cell to what a ray may sample because of it."""
        spacing = np.asarray(self.resolved.volume.grid.spacing)[::-1]
        steps = _SAMPLES_BEYOND * self.resolved.integration.step * spacing.min()
        moved = np.asarray(self._moved.cells)[::-1] << CELL_SHIFT
        return steps / spacing + self._beside + moved

    @property
    def _beside(self) -> int:
        """Voxels around a sample that its value and gradient depend on."""
        return FILTER_REACH[self.resolved.integration.filter] + _GRADIENT_REACH

    def _hold(self, blocks: np.ndarray, what: str) -> None:
        pool = self.volume.pool
        if len(blocks) > pool.most:
            where = f"{self.resolved.origin}: compression.memory"
            got = f"{pool.most} decoded blocks can be held where the rays of {what} need {len(blocks)}"
            raise SceneError(where, got, f"at least {pool.memory_for(len(blocks))} bytes")
        pool.hold(blocks)

    @property
    def lists_rays(self) -> bool:
        return False  # what a list needs is not known tile by tile

    def groups(
        self, frame: RayFrame, size: tuple[int, int], tiles: np.ndarray | None
    ) -> Iterator[np.ndarray | None]:
        needed = self.needed
        if self._rays_turn:
            self._hold(needed, "a frame")
            yield tiles
            return
        if self.volume.pool.resident(needed).all():
            yield tiles
            return
        columns, rows = (-(-n // m) for n, m in zip(size, self.tile))
        one = np.ones(len(needed), np.int64)
        ranges = self._tile_ranges(frame, size)
        for group, seen in tile_groups(ranges, one, self.volume.pool.most, columns, rows, tiles):
            # Rays of tiles without any leap over all there is.
            self._hold(needed[seen] if seen.any() else needed[:1], "a tile")
            yield group

    @property
    def _rays_turn(self) -> bool:
        """Whether rays leave their tiles."""
        switches = self.effects.switches
        return bool(switches.get("REFRACTION") or switches.get("SHADOWS") == METHODS["rays"])

    def _tile_ranges(self, frame: RayFrame, size: tuple[int, int]) -> Ranges:
        """As ``tile_ranges``, of the blocks that are needed; those of the last frame are kept."""
        key = *(np.asarray(each).tobytes() for each in vars(frame).values()), size
        if self._last is None or self._last[:2] != (key, id(self.needed)):
            self._last = key, id(self.needed), self._found_ranges(frame, size)
        return self._last[2]

    def _found_ranges(self, frame: RayFrame, size: tuple[int, int]) -> Ranges:
        blocks, spacing = self.volume.pool.blocks, np.asarray(self.resolved.volume.grid.spacing)
        beside = self._beside + (np.asarray(self._moved.cells) << CELL_SHIFT)
        low = blocks.places(self.needed)[:, ::-1] * blocks.edge
        high = np.minimum(low + blocks.edge, np.asarray(self.volume.size) - 1)
        to_edges = np.diag(spacing / spacing.min())
        return tile_ranges(low - beside, high + beside, frame, to_edges, size, self.tile)


def blocks_near(mask: np.ndarray, reach: np.ndarray, blocks: BlockGrid) -> np.ndarray:
    """int64: the numbers of the blocks that have anything within ``reach`` voxels (z, y, x), rounded up to cells, of a
    cell of ``mask`` bool [z, y, x]."""
    per_block = max(blocks.edge >> CELL_SHIFT, 1)
    dz, dy, dx = np.ceil(reach / (1 << CELL_SHIFT)).astype(int).tolist()
    near = spread(mask, (dx, dy, dz), np.logical_or)
    if blocks.edge < 1 << CELL_SHIFT:
        near = near.repeat(parts := (1 << CELL_SHIFT) // blocks.edge, 0).repeat(parts, 1).repeat(parts, 2)
    room = np.zeros([n * per_block for n in blocks.counts], bool)
    z, y, x = (min(a, b) for a, b in zip(near.shape, room.shape))
    room[:z, :y, :x] = near[:z, :y, :x]
    # Cells end one voxel before the volume does: a last block of a single plane has none of its own.
    for axis, (n, given) in enumerate(zip(room.shape, near.shape)):
        if given < n:
            last = np.take(room, [given - 1], axis=axis)
            index = [slice(None)] * 3
            index[axis] = slice(given, n)
            room[tuple(index)] |= last
    bz, by, bx = blocks.counts
    split = room.reshape(bz, per_block, by, per_block, bx, per_block)
    return np.flatnonzero(split.any(axis=(1, 3, 5)))
