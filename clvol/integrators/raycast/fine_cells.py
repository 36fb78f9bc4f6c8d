"""Smaller cells for the map of empty space of plain scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.device.empty_space import shows_between
from clvol.features import FILTER_REACH, overshoot
from clvol.volume.voxel_layout import CELL_SHIFT, FINE_SHIFT, MOST_FINE_CELLS, cell_count

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster


def fine_mask(caster: Raycaster, mask: np.ndarray) -> np.ndarray | None:
    """bool [z, y, x]: as ``mask``, in cells of 2^``FINE_SHIFT`` lattice units: rays take fewer samples for nothing.
    None where that gains nothing (all or nothing is visible), where the map would be larger than a cache, or where the
    volume does not know bounds of such cells."""
    volume, filter = caster.volume, caster.resolved.integration.filter
    nx, ny, nz = (cell_count(n, FINE_SHIFT) for n in volume.size)
    if not volume.has_fine_bounds or not mask.any() or nx * ny * nz > MOST_FINE_CELLS:
        return None
    if mask.all() and not caster.switches.get("CONSTANT_CELLS"):  # whose map has the same cells
        return None
    fine = mask
    for axis, n in enumerate((nz, ny, nx)):
        fine = fine.repeat(1 << (CELL_SHIFT - FINE_SHIFT), axis=axis).take(range(n), axis=axis)
    low, high = volume.fine_bounds(FILTER_REACH[filter], fine)
    fine[fine] = shows_between(caster.nodes, *caster.visible_nodes, low, high, overshoot(filter))
    return fine
