"""Where the index of refraction may change ([refraction]): rays leap over no such cell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.device.empty_space import visible_mask
from clvol.device.noise import perturbation
from clvol.device.transfer_lookup import device_function
from clvol.transfer.lookup_nodes import visible_cells

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster


def bending_cells(caster: Raycaster) -> np.ndarray | bool:
    """bool [z, y, x]: the cells in which the index may change, or False where there is none. What masks hide bends rays
    all the same."""
    resolved, volume, nodes = caster.resolved, caster.volume, caster.nodes
    index = resolved.refraction
    if index is None or index.shape is None:
        return False
    shape = device_function(index.shape, volume.values)
    between, at = visible_cells(shape, nodes.values), shape.opacity(nodes.values) > 0
    moved = perturbation(resolved.noise, resolved.volume.grid, volume.values.gain)
    return visible_mask(volume, resolved.integration.filter, nodes, between, at, moved)
