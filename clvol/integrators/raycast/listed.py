"""Lists of pixels where no kernel takes lists: the tiles of the lattices that they are on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.device.view import PixelLattice, PixelList
from clvol.integrators.base import FrameData, Progress
from clvol.integrators.raycast.picture import WholePicture

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster
    from clvol.scene.camera import Camera


def listed_by_tiles(
    caster: Raycaster, camera: Camera, width: int, height: int, progress: Progress | None, depth: bool,
    pixels: PixelList,
) -> FrameData:  # fmt: skip
    """As ``Prepared.render`` with a list. For each lattice with pixels of the list, the tiles that have some are
    rendered. ``rays`` counts all pixels of these tiles."""
    across, down = pixels.size(width, height)
    rgba = np.zeros((down * across, 4), np.float32)
    depths = np.full(down * across, np.inf, np.float32) if depth else None
    found = FrameData(rgba.reshape(down, across, 4), None, 0, 0, dict(caster.nothing_counted))
    found.depth = None if depths is None else depths.reshape(down, across)
    if caster.shows_nothing:
        return found
    spacing = pixels.spacing
    phases = pixels.rows % spacing * spacing + pixels.columns % spacing
    different = np.unique(phases)
    for done, phase in enumerate(different.tolist()):
        own = np.flatnonzero(phases == phase)
        lattice = PixelLattice(spacing, phase % spacing, phase // spacing, alone=True, covers=pixels.covers)
        size = lattice.size(width, height)
        rows, columns = pixels.rows[own] // spacing, pixels.columns[own] // spacing
        tile = caster.tile
        tiles, counts = np.unique(rows // tile[1] * -(-size[0] // tile[0]) + columns // tile[0], return_counts=True)
        caster.begin(camera, width, height, lattice)
        part = WholePicture(caster, camera, width, height, depth, lattice).render(None, tiles)
        rgba[own] = part.rgba[rows, columns]
        if depths is not None and part.depth is not None:
            depths[own] = part.depth[rows, columns]
        found.samples += part.samples
        found.rays += len(own) if tile == (1, 1) else len(tiles) * tile[0] * tile[1]
        for name, count in part.counters.items():
            found.counters[name] = found.counters.get(name, 0) + count
        if progress is not None:
            progress(done + 1, len(different))
    return found
