"""Smaller cells for the map of empty space of plain scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.device.empty_space import dilated, shows_between
from clvol.features import FILTER_REACH, overshoot
from clvol.volume.voxel_layout import CELL_SHIFT, FINE_SHIFT, MOST_FINE_CELLS, cell_count

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster


def fine_masks(caster: Raycaster, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray | None] | None:
    """bool [z, y, x]: as ``mask``, in cells of 2^``FINE_SHIFT`` lattice units: rays take fewer samples for nothing; and
    those of them in which a surface can be, in scenes that have surfaces. None where that gains nothing (all or nothing
    is visible), where the map would be larger than a cache, or where the volume does not know bounds of such cells."""
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
    shows = shows_between(caster.nodes, *caster.visible_nodes, low, high, overshoot(filter))
    surfaces = None
    if caster.resolved.isosurfaces:
        beyond = overshoot(filter) * np.maximum(high - low, 0.0)
        meets = np.zeros(shows.shape, bool)
        for surface in caster.resolved.isosurfaces:
            level = float(volume.values(surface.value))
            meets |= (low - beyond <= level) & (level <= high + beyond) & (low <= high)
        surfaces = np.zeros_like(fine)
        surfaces[fine] = meets
        if filter == "nearest":  # the region nearest to one voxel lies in two cells
            surfaces = dilated(surfaces)
    fine[fine] = shows
    return (fine if surfaces is None else fine | surfaces), surfaces
