"""Volumes on a device: voxels in their own type, and the min-max grid over them."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from functools import partial
from typing import Any, TypeVar

import numpy as np

from clvol.device import host_cells
from clvol.device.fields import CellLayout
from clvol.device.gradients import precompute
from clvol.device.host_cells import done_on_host
from clvol.device.memory import ValueMap, value_map, voxel_switches
from clvol.device.voxel_boxes import BoxPlace, VoxelBox
from clvol.errors import VolumeError
from clvol.opencl.arguments import INT4, RAW, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume
from clvol.volume.voxel_layout import (
    CELL_SHIFT,
    FINE_SHIFT,
    LARGEST_OFFSET,
    cell_count,
    device_bytes,
    holds_pairs,
    padded_size,
)

T = TypeVar("T")


class ResidentVolume:
    """A volume on a device, whether its voxels lie in one array or in blocks.

    ``voxels``: the (first) buffer of voxels or samples. ``values``: the map from voxels to the values that kernels
    compute with. ``switches``: how voxels are stored. ``size``: lattice points (x, y, z). ``stride``: elements from
    one row to the next, and from one slice to the next. ``cells`` (x, y, z): cells of empty space, each of
    2^``cell_shift`` lattice units.
    ``contents`` tells apart what is resident of the volume, where that changes. ``layout``: switches (-D) that kernels
    need beside those of the scene, where voxels lie neither in one array nor in blocks.

    ``bounds``, ``min_max``, ``gradients`` and ``plain`` need all voxels in one array.
    """

    voxels: DeviceArray
    values: ValueMap
    switches: dict[str, int]
    size: tuple[int, int, int]
    stride: tuple[int, int]
    cells: tuple[int, int, int]
    cell_shift: int
    layout: dict[str, int] = {}
    view_fields: dict[str, tuple[float, ...]] = {}  # (x, y, z) of members of ``View`` that are of this volume alone
    has_fine_bounds = False
    in_front: np.ndarray | None = None  # of a part of a volume, as in ``PartVolume``

    @property
    def contents(self) -> bytes:
        return b""

    @property
    def cell_layout(self) -> CellLayout:
        """Where the cells are."""
        return CellLayout(1 << self.cell_shift)

    def field_levels(self, resolved: ResolvedScene) -> list[int]:
        """Levels at which the fields of a reduced scene go with the volume."""
        return [0] * len(resolved.fields)

    @property
    def value_range(self) -> tuple[float, float]:
        """Smallest and largest value that kernels compute with."""
        raise NotImplementedError

    def bounds(self, apron: int) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest finite voxel, [z, y, x], of each cell and ``apron`` voxels around it (a
        filter's reach), in the values that kernels compute with; low > high where no voxel is finite."""
        raise NotImplementedError

    def min_max(self, shift: int) -> tuple[np.ndarray, np.ndarray]:
        """As ``bounds(0)``, for cells of 2^``shift`` lattice cells."""
        raise NotImplementedError

    def fine_bounds(self, apron: int, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As ``bounds``, of the cells of 2^``FINE_SHIFT`` lattice units that ``wanted`` bool [z, y, x] marks, as two
        arrays [n]; where ``has_fine_bounds``."""
        raise NotImplementedError

    def gradients(self, operator: str) -> tuple[DeviceArray, np.ndarray]:
        """Precomputed gradients and their scale (clvol/device/gradients.py)."""
        raise NotImplementedError

    def plain(self) -> DeviceArray:
        """The voxels [nz, ny, nx] as they are, whatever the layout of ``voxels``."""
        raise NotImplementedError

    def boxes(self, halo: tuple[int, int]) -> Iterator[VoxelBox]:
        """All voxels in plain boxes, with ``halo`` (y, z) neighbours of what is their own; a box is valid until the
        next one is asked for."""
        _, ny, nz = self.size
        yield VoxelBox(self.plain(), BoxPlace((0, 0), (ny, nz), (0, 0), (ny, nz)))


class DeviceVolume(ResidentVolume):
    """A volume in one array: ``voxels`` as cl/fetch_voxel.h lays them out, and the bounds of each cell of empty
    space. VolumeError where it does not fit on the device."""

    has_fine_bounds = True

    def __init__(self, context: DeviceContext, volume: Volume) -> None:
        _check_fits(context, volume)
        self.grid = volume.grid
        self.values = value_map(volume)
        low, high = self.values(volume.value_range)
        self._value_range = float(low), float(high)
        self.switches = voxel_switches(volume, self.values, pairs=holds_pairs(volume))
        self.size = padded_size(volume)
        nx, ny, nz = self.size
        self._has_pairs = holds_pairs(volume)
        # Gradients read four voxels, starting at any but the first one: two more than a row has.
        self.stride = (nx, nx * (ny - 1)) if self._has_pairs else (nx, nx * ny)
        self.cells = cell_count(nx), cell_count(ny), cell_count(nz)
        self.cell_shift = CELL_SHIFT
        self._context = context
        self._fill(volume, None)

    def change(self, volume: Volume) -> None:
        """Takes the voxels of ``volume``, another step of the same series, into the same memory. Bounds and gradients
        are found anew. VolumeError, with nothing changed, if its voxels cannot be read."""
        self._fill(volume, self.voxels)

    def _fill(self, volume: Volume, kept: DeviceArray | None) -> None:
        """``kept``: the array whose memory is used again; None: a new one."""
        nx, ny, nz = self.size
        context, data = self._context, volume.data
        if data.shape != (nz, ny, nx):
            for axis, n in enumerate(data.shape):
                data = np.repeat(data, 2, axis=axis) if n == 1 else data
        data = np.ascontiguousarray(data)
        self._data = data
        self._kept: dict[Hashable, Any] = {}
        self.voxels = self._stored(context, data, kept)

    def _stored(self, context: DeviceContext, data: np.ndarray, kept: DeviceArray | None) -> DeviceArray:
        """The buffer of the voxels ``data`` [z, y, x]."""
        if kept is not None and not context.is_cpu and not self._has_pairs and data.dtype.itemsize > 1:
            context.write(kept, data.reshape(-1))
            plain = kept
        else:
            plain = context.share(data)
        self._kept["bounds", 0] = self._min_max(plain, 0)
        if self._has_pairs:
            return self._paired(context, data, plain, kept)
        if data.dtype.itemsize == 1:  # 32-bit loads of the last bytes must stay inside the buffer
            return context.share(np.append(data.ravel(), np.zeros(4, data.dtype)))
        return plain

    def _paired(
        self, context: DeviceContext, data: np.ndarray, plain: DeviceArray, kept: DeviceArray | None
    ) -> DeviceArray:
        nx, ny, nz = self.size
        shape = nz * (ny - 1) * nx + 4, 2
        if done_on_host(context, data.size):
            fill = partial(host_cells.pair_rows, data)
            if kept is None:
                return context.resident(np.uint8, shape, fill)
            context.refill(kept, fill)
            return kept
        pairs = context.resident(np.uint8, shape) if kept is None else kept
        declared = (
            reads("volume", RAW, "size.x", "size.y", "size.z"),
            value("size", INT4),
            writes("pairs", np.uint8, nz * (ny - 1) * nx, 2),
        )
        kernel = context.kernel("empty_space.cl", "pair_rows", declared, self._grid_switches)
        kernel(context.queue, (ny - 1, nz), None, volume=plain, size=(nx, ny, nz, 0), pairs=pairs)
        return pairs

    @property
    def _grid_switches(self) -> dict[str, int]:
        return {k: self.switches[k] for k in ("VOXEL_BITS", "VOXEL_SIGNED")}

    @property
    def value_range(self) -> tuple[float, float]:
        return self._value_range

    def plain(self) -> DeviceArray:
        return self._context.share(self._data)

    def keep(self, key: Hashable, make: Callable[[], T]) -> T:
        """What ``make`` has made of the volume under ``key``; made by the first call."""
        if key not in self._kept:
            self._kept[key] = make()
        found: T = self._kept[key]
        return found

    def gradients(self, operator: str) -> tuple[DeviceArray, np.ndarray]:
        """As in ``ResidentVolume``; computed once per operator."""
        return self.keep(("gradients", operator), lambda: precompute(self._context, self, operator))

    def bounds(self, apron: int) -> tuple[np.ndarray, np.ndarray]:
        """As in ``ResidentVolume``; computed once per apron."""
        return self.keep(("bounds", apron), lambda: self._min_max(self.plain(), apron))

    def min_max(self, shift: int) -> tuple[np.ndarray, np.ndarray]:
        """As in ``ResidentVolume``; computed anew by each call."""
        return self._min_max(self.plain(), 0, shift)

    def fine_bounds(self, apron: int, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As in ``ResidentVolume``. The bounds of all cells are kept, in the voxels' own type."""
        found = self.keep(("fine", apron), lambda: self._stored_min_max(self.plain(), apron, FINE_SHIFT))
        with np.errstate(over="ignore"):
            low, high = found[wanted].astype(np.float64).T
            return self.values(low), self.values(high)

    def _min_max(
        self, plain: DeviceArray, apron: int, shift: int = CELL_SHIFT
    ) -> tuple[np.ndarray, np.ndarray]:
        found = self._stored_min_max(plain, apron, shift).astype(np.float64)
        with np.errstate(over="ignore"):
            return self.values(found[..., 0]), self.values(found[..., 1])

    def _stored_min_max(self, plain: DeviceArray, apron: int, shift: int) -> np.ndarray:
        """[z, y, x, 2]: smallest and largest finite voxel of each cell, in the voxels' own type."""
        context = self._context
        if done_on_host(context, self._data.size):
            return host_cells.min_max_cells(self._data, shift, apron)
        nx, ny, nz = self.size
        cells = cell_count(nx, shift), cell_count(ny, shift), cell_count(nz, shift)
        out = context.empty(self._data.dtype, (*cells[::-1], 2))
        kernel = context.kernel(
            "empty_space.cl",
            "min_max_cells",
            (
                reads("volume", RAW, "size.x", "size.y", "size.z", self._data.dtype.itemsize),
                value("size", INT4),
                value("edge", np.int32),
                value("apron", np.int32),
                value("cells_x", np.int32),
                writes("cells", self._data.dtype, *out.shape),
            ),
            self._grid_switches,
        )
        kernel(
            context.queue,
            cells[1:],
            None,
            volume=plain,
            size=(*self.size, 0),
            edge=1 << shift,
            apron=apron,
            cells_x=cells[0],
            cells=out,
        )
        return context.read(out)


def _check_fits(context: DeviceContext, volume: Volume) -> None:
    device = context.device
    if volume.dtype == np.float64 and not context.has_double:
        raise VolumeError(
            volume.name or "volume", f"float64 voxels, which {context.name} cannot hold", "float32"
        )
    needed = device_bytes(volume)
    largest, memory = int(device.max_mem_alloc_size), int(device.global_mem_size)
    elements = int(np.prod(padded_size(volume), dtype=np.int64))
    where = volume.name or "volume"
    what = f"{volume.grid.size} voxels of {volume.dtype} need {needed} bytes on {context.name}"
    if needed > largest:
        expected = f"at most {largest} bytes in one buffer, the limit of the device"
        raise VolumeError(where, what, expected)
    if needed > memory:
        raise VolumeError(where, what, f"at most {memory} bytes, the memory of the device")
    if elements > LARGEST_OFFSET:
        raise VolumeError(where, f"{elements} voxels", f"at most {LARGEST_OFFSET} for one buffer")
