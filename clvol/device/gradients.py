"""Gradients at the voxels, found once and held in four bytes each (cl/gradients.cl); and when."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clvol.device.memory import LARGEST_OFFSET, device_bytes, holds_pairs, padded_size
from clvol.device.volume import DeviceVolume
from clvol.features import GRADIENTS
from clvol.opencl.arguments import INT4, RAW, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.volume import Volume

OPERATORS = ("central", "sobel")
_ANALYTIC = ("cubic", "catmull-rom")  # filters that have a derivative of their own
_ROOTS, _DIRECTIONS = 255, 127  # largest numbers of a code's root of length, and of its direction
_SHARE = 0.5  # of a device's memory that volume and gradients together may take
_SIZE = ("size.x", "size.y", "size.z")


@dataclass(frozen=True)
class DeviceLimits:
    """Bytes that a device has, and that one of its buffers may take."""

    memory: int
    buffer: int

    @classmethod
    def of(cls, context: DeviceContext) -> DeviceLimits:
        device = context.device
        return cls(int(device.global_mem_size), int(device.max_mem_alloc_size))


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


def gradient_switch(
    volume: Volume, filter: str, operator: str, storage: str, limits: DeviceLimits
) -> int:
    """GRADIENT of cl/features.h for a scene's filter and [gradient] ``operator`` and ``storage``."""
    if filter in _ANALYTIC:
        return GRADIENTS["analytic"]
    if chosen_storage(volume, operator, storage, limits) == "precomputed":
        return GRADIENTS["precomputed"]
    return GRADIENTS[operator]


def storing_switches(voxels: Mapping[str, int], operator: str) -> dict[str, int]:
    """Switches of cl/gradients.cl for voxels of these switches."""
    return {
        "VOXEL_BITS": voxels["VOXEL_BITS"],
        "VOXEL_SIGNED": voxels["VOXEL_SIGNED"],
        "SOBEL": int(operator == "sobel"),
    }


def precompute(
    context: DeviceContext, volume: DeviceVolume, operator: str
) -> tuple[DeviceArray, np.ndarray]:
    """uint32 [nz, ny, nx] on the device, and float32 [4]: the ``gradient_scale`` of cl/gradient.h.

    ``operator``: "central" or "sobel". The scale's x, y, z take stored numbers to the change of the
    kernels' value a lattice unit; its last entry is the largest component of a gradient at a voxel,
    in that value a smallest voxel edge. Takes ``gradient_bytes`` on the device; two passes.
    """
    edges = np.asarray(volume.grid.spacing) / volume.grid.smallest_edge
    # Halves first: float64 voxels may be so far apart that their difference overflows.
    before = 0.5 if volume.switches["VOXEL_BITS"] == 64 else volume.values.gain
    after = volume.values.gain / before
    real = np.float64 if volume.switches["VOXEL_BITS"] == 64 else np.float32
    metric = context.upload(np.array([*(after / edges), before], real))
    switches = storing_switches(volume.switches, operator)
    nx, ny, nz = volume.size
    given = {"volume": volume.plain(), "size": (nx, ny, nz, 0), "metric": metric}
    declared = (reads("volume", RAW, *_SIZE), value("size", INT4), reads("metric", real, 4))

    rows = context.empty(np.float32, (nz, ny))
    kernel = context.kernel(
        "gradients.cl", "largest_gradients", (*declared, writes("largest", np.float32, *_SIZE[1:])), switches
    )
    kernel(context.queue, (ny, nz), None, **given, largest=rows)
    context.finish()
    largest = float(context.read(rows).max())

    codes = context.empty(np.uint32, (nz, ny, nx))
    declared += (value("largest", np.float32), writes("codes", np.uint32, *_SIZE))
    kernel = context.kernel("gradients.cl", "store_gradients", declared, switches)
    kernel(context.queue, (ny, nz), None, **given, largest=largest, codes=codes)
    context.finish()
    scale = largest / (_ROOTS**2 * _DIRECTIONS) * edges
    return codes, np.array([*scale, largest], np.float32)
