"""Which cells of a volume can be visible, and how far every cell is from the nearest of them."""

from __future__ import annotations

import numpy as np

from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.render.device_volume import DeviceVolume
from clvol.transfer.classes import ClassNodes

# Rounding of warped class coordinates in float32; even ones are exact at the nodes.
_WARP_ROUNDING = 1e-3


def visible_mask(volume: DeviceVolume, nodes: ClassNodes, visible: np.ndarray) -> np.ndarray:
    """bool [z, y, x]: whether anything in a cell can have opacity.

    ``visible`` bool [n - 1]: whether table look-ups between node k and k + 1 can give any.
    """
    margin = 0.0 if nodes.warp is None else _WARP_ROUNDING
    any_value = volume.low <= volume.high
    low = np.floor(nodes.position(np.where(any_value, volume.low, nodes.first)) - margin)
    high = np.ceil(nodes.position(np.where(any_value, volume.high, nodes.first)) + margin)
    # A range that is one node alone looks up both its neighbours with weight 0, itself with 1.
    alone = low == high
    before = np.concatenate([[0], np.cumsum(visible)])
    first = np.clip(low - alone, 0, visible.size).astype(np.int64)
    last = np.clip(high + alone, 0, visible.size).astype(np.int64)
    return any_value & (before[last] > before[first])


def distance_map(context: DeviceContext, mask: np.ndarray) -> DeviceArray:
    """uint8 [z, y, x] on the device: distance in cells (maximum norm, at most 255) to the nearest
    cell of ``mask``; 0 in it."""
    start = np.where(mask, 0, 255).astype(np.uint8)
    # A 32-bit gather of the last byte must stay inside the buffer.
    padded = np.concatenate([start.ravel(), np.full(4, 255, np.uint8)])
    distances = context.upload(padded)
    if not mask.any():
        return distances
    kernel = context.kernel(
        "empty_space.cl",
        "distance_pass",
        "in source uint8, out target uint8, value cells int4, value axis int32",
        {"VOXEL_BITS": 8, "VOXEL_SIGNED": 0},
    )
    cells = mask.shape[::-1]
    spare = [context.upload(padded), context.upload(padded)]
    for axis in range(3):
        target = spare[axis % 2]
        kernel(
            context.queue, cells, None, source=distances, target=target, cells=(*cells, 0), axis=axis
        )
        distances = target
    context.finish()
    return distances
