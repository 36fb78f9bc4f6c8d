"""The oracle of a bounded error of the picture."""

from __future__ import annotations

from clvol.integrators.pyramid.cells import (
    cells_of_voxels,
    distance_map,
    raise_to_ways,
    voxels_bad_for_error,
)
from clvol.integrators.pyramid.oracle import KERNEL_ERROR, Asked, Oracle
from clvol.integrators.pyramid.oracles.visible import visible_in_cells
from clvol.opencl.context import DeviceArray


class Error(Oracle):
    """How far apart samples may be so that a segment of that length between them, values interpolated linearly along it and
    across, is wrong by at most epsilon in each channel of its premultiplied linear colour: from how far values are off the chord
    between samples that far apart, and how fast the transfer function turns that into colour. And as far, at least, as nothing
    is visible. Where little light arrives from more error is allowed: distances grow with the inverse square root of the
    transmittance, since errors grow with the square of the distance; at most epsilon^(-1/2) times."""

    name = "error"
    kernel = KERNEL_ERROR

    def map(self, asked: Asked) -> DeviceArray:
        scales = asked.scales
        bad = cells_of_voxels(asked, voxels_bad_for_error(asked))
        visible_in_cells(asked, bad, len(scales))
        found = distance_map(asked, bad, scales)
        raise_to_ways(asked, bad, len(scales), found)
        return found
