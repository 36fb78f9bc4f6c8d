"""A volume on a device: its voxels in their own type, and the min-max grid over them."""

from __future__ import annotations

import numpy as np

from clvol.device.gradients import precompute
from clvol.device.memory import value_map, voxel_switches
from clvol.errors import VolumeError
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.volume import Volume
from clvol.volume.voxel_layout import CELL_SHIFT, LARGEST_OFFSET, cell_count, device_bytes, holds_pairs, padded_size


class DeviceVolume:
    """``voxels`` as cl/fetch_voxel.h lays them out, and what lies in each cell of empty space."""

    def __init__(self, context: DeviceContext, volume: Volume) -> None:
        _check_fits(context, volume)
        self.grid = volume.grid
        self.values = value_map(volume)
        self.value_range = tuple(float(v) for v in self.values(volume.value_range))
        self.switches = voxel_switches(volume, self.values)
        self.size = padded_size(volume)
        nx, ny, nz = self.size
        data = volume.data
        if data.shape != (nz, ny, nx):
            for axis, n in enumerate(data.shape):
                data = np.repeat(data, 2, axis=axis) if n == 1 else data
        data = np.ascontiguousarray(data)
        plain = context.share(data)
        if holds_pairs(volume):
            self.stride = (nx, nx * (ny - 1))
            # Gradients read four voxels from any but the first one on: two more than a row has.
            self.voxels = context.empty(np.uint8, (nz * (ny - 1) * nx + 4, 2))
            pair_rows = context.kernel(
                "empty_space.cl",
                "pair_rows",
                "in volume V1, value size int4, out pairs uint8",
                self._grid_switches,
            )
            size = (nx, ny, nz, 0)
            pair_rows(
                context.queue, (ny - 1, nz), None, volume=plain, size=size, pairs=self.voxels
            )
        else:
            self.stride = (nx, nx * ny)
            self.voxels = plain
            if volume.dtype.itemsize == 1:  # 32-bit loads of the last bytes must stay inside
                self.voxels = context.upload(np.append(data.ravel(), np.zeros(4, data.dtype)))
        self.cells = tuple(cell_count(n) for n in self.size)
        self.cell_shift = CELL_SHIFT
        self._context, self._data = context, data
        self._gradients: dict[str, tuple[DeviceArray, np.ndarray]] = {}
        self._bounds = {0: self._min_max(plain, 0)}

    @property
    def _grid_switches(self) -> dict[str, int]:
        return {k: self.switches[k] for k in ("VOXEL_BITS", "VOXEL_SIGNED")}

    def plain(self) -> DeviceArray:
        """The voxels [nz, ny, nx] as they are, whatever the layout of ``voxels``."""
        return self._context.share(self._data)

    def gradients(self, operator: str) -> tuple[DeviceArray, np.ndarray]:
        """Precomputed gradients and their scale (clvol/device/gradients.py). Found once."""
        if operator not in self._gradients:
            self._gradients[operator] = precompute(self._context, self, operator)
        return self._gradients[operator]

    def bounds(self, apron: int) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest finite voxel, [z, y, x], of each cell and ``apron`` voxels around it (a
        filter's reach), in the values that kernels compute with; low > high where there is none.
        Found once."""
        if apron not in self._bounds:
            self._bounds[apron] = self._min_max(self.plain(), apron)
        return self._bounds[apron]

    def min_max(self, shift: int) -> tuple[np.ndarray, np.ndarray]:
        """As ``bounds(0)``, of cells of 2^``shift`` lattice cells; not kept."""
        return self._min_max(self.plain(), 0, shift)

    def _min_max(
        self, plain: DeviceArray, apron: int, shift: int = CELL_SHIFT
    ) -> tuple[np.ndarray, np.ndarray]:
        context = self._context
        cells = tuple(cell_count(n, shift) for n in self.size)
        out = context.empty(self._data.dtype, (*cells[::-1], 2))
        kernel = context.kernel(
            "empty_space.cl",
            "min_max_cells",
            "in volume V1, value size int4, value edge int32, value apron int32, out cells V1",
            self._grid_switches,
        )
        kernel(
            context.queue,
            cells,
            None,
            volume=plain,
            size=(*self.size, 0),
            edge=1 << shift,
            apron=apron,
            cells=out,
        )
        context.finish()
        found = context.read(out).astype(np.float64)
        with np.errstate(over="ignore"):
            return self.values(found[..., 0]), self.values(found[..., 1])


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
        expected = f"at most {largest} bytes in one buffer, all that the device gives"
        raise VolumeError(where, what, expected)
    if needed > memory:
        raise VolumeError(where, what, f"at most {memory} bytes, all that the device has")
    if elements > LARGEST_OFFSET:
        raise VolumeError(where, f"{elements} voxels", f"at most {LARGEST_OFFSET} for one buffer")
