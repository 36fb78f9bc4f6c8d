"""The choice between gradients computed on the fly and precomputed ones: arithmetic, without a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.volume.volume import Volume
from clvol.volume.voxel_layout import LARGEST_OFFSET, device_bytes, holds_pairs, padded_size

_SHARE = 0.5  # of a device's memory, for volume and gradients together


@dataclass(frozen=True)
class DeviceLimits:
    """The memory of a device and its largest buffer, in bytes."""

    memory: int
    buffer: int

    @classmethod
    def of(cls, context: Any) -> DeviceLimits:
        """The limits of ``context.device``, a pyopencl device."""
        device = context.device
        return cls(int(device.global_mem_size), int(device.max_mem_alloc_size))


UNLIMITED = DeviceLimits(memory=2**63, buffer=2**63)


def gradient_bytes(volume: Volume) -> int:
    """Bytes of precomputed gradients on the device."""
    return 4 * int(np.prod(padded_size(volume), dtype=np.int64))


def chosen_storage(volume: Volume, operator: str, storage: str, limits: DeviceLimits) -> str:
    """The storage, "precomputed" or "on-the-fly", for a ``storage`` that may be "auto".

    Gradients are then precomputed if they fit in one buffer, and with the volume in half of the device's memory,
    since eight words replace the voxels around each sample. The exception is central differences of 8-bit volumes
    stored as pairs, which read ten words on the fly from half as much memory.
    """
    if storage != "auto":
        return storage
    if operator == "central" and holds_pairs(volume):
        return "on-the-fly"
    needed = gradient_bytes(volume)
    fits = needed <= limits.buffer and needed // 4 <= LARGEST_OFFSET
    fits = fits and device_bytes(volume) + needed <= _SHARE * limits.memory
    return "precomputed" if fits else "on-the-fly"
