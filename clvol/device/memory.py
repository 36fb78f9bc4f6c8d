"""How a volume is laid out on a device, and how many bytes it takes there: arithmetic, without a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from clvol.volume import Volume
from clvol.volume.voxel_layout import device_bytes

# Magnitudes whose gradients, squared, still fit float32: such values are used unscaled.
_PLAIN_RANGE = (1e-12, 1e18)


class VoxelFacts(Protocol):
    """What is known about the voxels of a volume, whether they lie in one array or in blocks."""

    @property
    def dtype(self) -> np.dtype: ...

    @property
    def value_range(self) -> tuple[float, float]: ...

    @property
    def nan_count(self) -> int: ...

    @property
    def inf_count(self) -> int: ...


@dataclass(frozen=True)
class ValueMap:
    """Kernels compute with (voxel - bias) * gain, which is the voxel itself unless the voxels are float64,
    or float32 of extreme magnitude."""

    bias: float = 0.0
    gain: float = 1.0

    def __call__(self, values: ArrayLike) -> np.ndarray:
        return (np.asarray(values, np.float64) - self.bias) * self.gain


@dataclass(frozen=True)
class Perturbation:
    """Bounds of what noise does: the most that it adds to or subtracts from a value that kernels compute with
    (``added``), and by how many ``cells`` (x, y, z) it moves a position."""

    added: float = 0.0
    cells: tuple[int, int, int] = (0, 0, 0)


UNPERTURBED = Perturbation()


def value_map(voxels: VoxelFacts) -> ValueMap:
    """The map from voxels to the values that kernels compute with."""
    low, high = voxels.value_range
    if voxels.dtype == np.float64:
        # Values are halved first: high - low may overflow where high / 2 - low / 2 does not.
        half = high / 2 - low / 2
        if not half > 0:
            return ValueMap(low, 1.0)
        return ValueMap(low, float(min(0.5 / half, 1e300)))
    largest = max(abs(low), abs(high))
    if voxels.dtype == np.float32 and largest and not _PLAIN_RANGE[0] < largest < _PLAIN_RANGE[1]:
        exponent = int(np.clip(-np.floor(np.log2(largest)), -126, 127))
        return ValueMap(0.0, 2.0**exponent)
    return ValueMap()


def voxel_switches(voxels: VoxelFacts, values: ValueMap, *, pairs: bool) -> dict[str, int]:
    """The switches (-D) that say how voxels are stored. ``pairs``: each voxel is stored together with the one above it
    in y (``holds_pairs``)."""
    dtype = voxels.dtype
    return {
        "VOXEL_BITS": dtype.itemsize * 8,
        "VOXEL_SIGNED": int(dtype.kind == "i"),
        "VOXEL_SCALED": int(dtype == np.float32 and values.gain != 1.0),
        "VOXEL_PAIRS": int(pairs),
        "VOXEL_HOLES": int(voxels.nan_count + voxels.inf_count > 0),
    }


def scene_bytes(volume: Volume, width: int, height: int) -> int:
    """Bytes on the device for what every picture needs: volume, picture and depth."""
    return device_bytes(volume) + width * height * 20
