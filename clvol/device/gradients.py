"""Gradients at the voxels, computed once and held in four bytes each (cl/gradients.cl)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.device.arguments import Arguments
from clvol.features.gradient_storage import DeviceLimits, chosen_storage
from clvol.features.vocabulary import ANALYTIC, GRADIENTS
from clvol.opencl.arguments import INT4, RAW, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.volume import Volume

if TYPE_CHECKING:
    from clvol.device.volume import DeviceVolume

OPERATORS = ("central", "sobel")
_ROOTS, _DIRECTIONS = 255, 127  # largest numbers of a code's root of length, and of its direction
_SIZE = ("size.x", "size.y", "size.z")


def gradient_switch(
    volume: Volume, filter: str, operator: str, storage: str, limits: DeviceLimits
) -> int:
    """GRADIENT of cl/features.h for a scene's filter and [gradient] ``operator`` and ``storage``."""
    if filter in ANALYTIC:
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

    ``operator``: "central" or "sobel". The scale's x, y, z turn stored numbers into the change of the
    kernels' value per lattice unit; its last entry is the largest component of a gradient at a voxel,
    in that value per smallest voxel edge. Takes ``gradient_bytes`` on the device, and two passes.
    """
    edges = np.asarray(volume.grid.spacing) / volume.grid.smallest_edge
    # Values are halved first: float64 voxels may be so far apart that their difference overflows.
    before = 0.5 if volume.switches["VOXEL_BITS"] == 64 else volume.values.gain
    after = volume.values.gain / before
    real = np.float64 if volume.switches["VOXEL_BITS"] == 64 else np.float32
    metric = context.upload(np.array([*(after / edges), before], real))
    switches = storing_switches(volume.switches, operator)
    nx, ny, nz = volume.size
    given: dict[str, Any] = {"volume": volume.plain(), "size": (nx, ny, nz, 0), "metric": metric}
    declared: Arguments = (reads("volume", RAW, *_SIZE), value("size", INT4), reads("metric", real, 4))

    rows = context.empty(np.float32, (nz, ny))
    kernel = context.kernel(
        "gradients.cl", "largest_gradients", (*declared, writes("largest", np.float32, *_SIZE[1:])), switches
    )
    kernel(context.queue, (ny, nz), None, **given, largest=rows)
    context.finish()
    largest = float(context.read(rows).max())

    codes = context.resident(np.uint32, (nz, ny, nx))
    declared += (value("largest", np.float32), writes("codes", np.uint32, *_SIZE))
    kernel = context.kernel("gradients.cl", "store_gradients", declared, switches)
    kernel(context.queue, (ny, nz), None, **given, largest=largest, codes=codes)
    context.finish()
    scale = largest / (_ROOTS**2 * _DIRECTIONS) * edges
    return codes, np.array([*scale, largest], np.float32)
