"""How much of a ray's light each cell of empty space absorbs, about: what tiles of a picture are expected to cost."""

from __future__ import annotations

import numpy as np

from clvol.device.volume import ResidentVolume
from clvol.transfer import TransferFunction

_NODES = 1024  # of the integral of the extinction
_OPAQUE = 20.0  # optical depth above which more makes no difference


def cell_depths(volume: ResidentVolume, function: TransferFunction, voxel_edge: float) -> np.ndarray:
    """float64 [z, y, x]: about the mean optical depth of each cell of empty space along its edge, of all values between
    its bounds alike. ``voxel_edge``: the smallest, as a world length."""
    low, high = volume.bounds(0)
    nodes = np.linspace(*volume.value_range, _NODES + 1)
    at_nodes = np.minimum(function.extinction(nodes) * voxel_edge * (1 << volume.cell_shift), _OPAQUE)
    sums = np.concatenate([[0.0], np.cumsum(0.5 * (at_nodes[1:] + at_nodes[:-1]))])
    unit = max(nodes[1] - nodes[0], 1e-300)
    first, last = (np.clip((bound - nodes[0]) / unit, 0, _NODES) for bound in (low, np.maximum(low, high)))
    width = last - first
    at = np.arange(_NODES + 1)
    inside = (np.interp(last, at, sums) - np.interp(first, at, sums)) / np.maximum(width, 1e-9)
    return np.where(width > 1e-6, inside, np.interp(first, at, at_nodes))
