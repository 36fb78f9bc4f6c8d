"""Where gradients are had from: found on the fly, or precomputed where they fit. Arithmetic, without a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.volume.volume import Volume
from clvol.volume.voxel_layout import LARGEST_OFFSET, device_bytes, holds_pairs, padded_size

_SHARE = 0.5  # of a device's memory that volume and gradients together may take


@dataclass(frozen=True)
class DeviceLimits:
    """Bytes that a device has, and that one of its buffers may take."""

    memory: int
    buffer: int

    @classmethod
    def of(cls, context: Any) -> DeviceLimits:
        """Those of ``context.device``, a pyopencl device."""
        device = context.device
        return cls(int(device.global_mem_size), int(device.max_mem_alloc_size))


UNLIMITED = DeviceLimits(memory=2**63, buffer=2**63)


def gradient_bytes(volume: Volume) -> int:
    """Bytes of precomputed gradients on the device."""
    return 4 * int(np.prod(padded_size(volume), dtype=np.int64))


def chosen_storage(volume: Volume, operator: str, storage: str, limits: DeviceLimits) -> str:
    """ "precomputed" or "on-the-fly": ``storage`` itself, or where it is "auto" the rule:

    Gradients are precomputed where they fit (in one buffer, and with the volume in half the
    device's memory), since eight words then replace the voxels around each sample; except central
    differences of 8-bit volumes held as pairs: ten words on the fly, of half as much memory.
    """
    if storage != "auto":
        return storage
    if operator == "central" and holds_pairs(volume):
        return "on-the-fly"
    needed = gradient_bytes(volume)
    fits = needed <= limits.buffer and needed // 4 <= LARGEST_OFFSET
    fits = fits and device_bytes(volume) + needed <= _SHARE * limits.memory
    return "precomputed" if fits else "on-the-fly"
