"""How a volume is laid out on a device, and what it takes there: arithmetic, without a device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.volume import Volume
from clvol.volume.voxel_layout import device_bytes, holds_pairs

# Magnitudes that float32 arithmetic takes as they are, squares of their gradients too.
_PLAIN_RANGE = (1e-12, 1e18)


@dataclass(frozen=True)
class ValueMap:
    """Kernels compute with (voxel - bias) * gain, which is the voxel itself unless it is float64
    or float32 of extreme magnitude."""

    bias: float = 0.0
    gain: float = 1.0

    def __call__(self, values):
        return (np.asarray(values, np.float64) - self.bias) * self.gain


@dataclass(frozen=True)
class Perturbation:
    """What noise does at most: ``added`` to or taken from a value that kernels compute with, and how many
    cells (x, y, z) a place is moved by."""

    added: float = 0.0
    cells: tuple[int, int, int] = (0, 0, 0)


UNPERTURBED = Perturbation()


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


def voxel_switches(volume: Volume, values: ValueMap) -> dict[str, int]:
    dtype = volume.dtype
    return {
        "VOXEL_BITS": dtype.itemsize * 8,
        "VOXEL_SIGNED": int(dtype.kind == "i"),
        "VOXEL_SCALED": int(dtype == np.float32 and values.gain != 1.0),
        "VOXEL_PAIRS": int(holds_pairs(volume)),
        "VOXEL_HOLES": int(volume.nan_count + volume.inf_count > 0),
    }


def scene_bytes(volume: Volume, width: int, height: int) -> int:
    """Bytes on the device for everything that a picture needs: volume, picture and depth."""
    return device_bytes(volume) + width * height * 20
