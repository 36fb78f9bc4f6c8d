"""A volume on a device: its voxels in their own type, and the min-max grid over them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.errors import VolumeError
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.volume import Volume

CELL_SHIFT = 3  # cells of 8^3 for empty space
# 8-bit volumes are held as pairs (twice the memory) up to this many bytes of pairs.
_LARGEST_PAIRS = 512 * 2**20
_LARGEST_OFFSET = 2**31 - 1  # offsets are signed 32 bit: what the hardware's gather takes
_PLAIN_RANGE = (1e-18, 1e18)  # magnitudes that float32 arithmetic takes as they are


@dataclass(frozen=True)
class ValueMap:
    """Kernels compute with (voxel - bias) * gain, which is the voxel itself unless it is float64
    or float32 of extreme magnitude."""

    bias: float = 0.0
    gain: float = 1.0

    def __call__(self, values):
        return (np.asarray(values, np.float64) - self.bias) * self.gain


def value_map(volume: Volume) -> ValueMap:
    low, high = volume.value_range
    if volume.dtype == np.float64:
        # Halves first: high - low may overflow where high / 2 - low / 2 does not.
        half = high / 2 - low / 2
        if not half > 0:
            return ValueMap(low, 1.0)
        return ValueMap(low, float(min(0.5 / half, 1e300)))
    largest = max(abs(low), abs(high))
    if volume.dtype == np.float32 and largest and not _PLAIN_RANGE[0] < largest < _PLAIN_RANGE[1]:
        exponent = int(np.clip(-np.floor(np.log2(largest)), -126, 127))
        return ValueMap(0.0, 2.0**exponent)
    return ValueMap()


def padded_size(volume: Volume) -> tuple[int, int, int]:
    """Lattice points (x, y, z) on the device: an axis of one voxel is held twice."""
    return tuple(max(n, 2) for n in volume.grid.size)


def voxel_switches(volume: Volume, values: ValueMap) -> dict[str, int]:
    dtype = volume.dtype
    return {
        "VOXEL_BITS": dtype.itemsize * 8,
        "VOXEL_SIGNED": int(dtype.kind == "i"),
        "VOXEL_SCALED": int(dtype == np.float32 and values.gain != 1.0),
        "VOXEL_PAIRS": int(holds_pairs(volume)),
    }


def holds_pairs(volume: Volume) -> bool:
    nx, ny, nz = padded_size(volume)
    return volume.dtype.itemsize == 1 and 2 * nx * (ny - 1) * nz <= _LARGEST_PAIRS


def device_bytes(volume: Volume) -> int:
    """Bytes that ``DeviceVolume`` takes on the device for voxels and min-max grid."""
    size = nx, ny, nz = padded_size(volume)
    voxels = nx * ny * nz * volume.dtype.itemsize
    if holds_pairs(volume):
        voxels = 2 * nx * (ny - 1) * nz
    cells = np.prod([cell_count(n) for n in size], dtype=np.int64)
    return int(voxels + cells * (2 * volume.dtype.itemsize + 2))


def cell_count(size: int) -> int:
    return max(1, -(-(size - 1) // (1 << CELL_SHIFT)))


class DeviceVolume:
    """``voxels`` as cl/fetch_voxel.h lays them out; ``low``, ``high`` [z, y, x] of each cell in the
    values that kernels compute with (low > high: nothing finite in it)."""

    def __init__(self, context: DeviceContext, volume: Volume) -> None:
        _check_fits(context, volume)
        self.values = value_map(volume)
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
            self.voxels = context.output(np.uint8, (nz, ny - 1, nx, 2))
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
        self.low, self.high = self._min_max(context, plain, data.dtype)

    @property
    def _grid_switches(self) -> dict[str, int]:
        return {k: self.switches[k] for k in ("VOXEL_BITS", "VOXEL_SIGNED")}

    def _min_max(
        self, context: DeviceContext, plain: DeviceArray, dtype: np.dtype
    ) -> tuple[np.ndarray, np.ndarray]:
        out = context.empty(dtype, (*self.cells[::-1], 2))
        kernel = context.kernel(
            "empty_space.cl",
            "min_max_cells",
            "in volume V1, value size int4, value edge int32, out cells V1",
            self._grid_switches,
        )
        kernel(
            context.queue,
            self.cells,
            None,
            volume=plain,
            size=(*self.size, 0),
            edge=1 << CELL_SHIFT,
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
    if elements > _LARGEST_OFFSET:
        raise VolumeError(where, f"{elements} voxels", f"at most {_LARGEST_OFFSET} for one buffer")
