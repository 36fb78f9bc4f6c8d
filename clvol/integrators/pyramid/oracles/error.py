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
    """The distance between samples at which a segment of that length, with values interpolated linearly along and across
    it, has an error of at most epsilon in each channel of its premultiplied linear colour. It follows from how far values
    deviate from the chord between such samples, and from how fast the transfer function turns that into colour. In empty
    space it reaches at least to the nearest visible cell. Where little light arrives from, a larger error is allowed:
    distances grow with the inverse square root of the transmittance, since errors grow with the square of the distance,
    by at most a factor of epsilon^(-1/2)."""

    name = "error"
    kernel = KERNEL_ERROR

    def map(self, asked: Asked) -> DeviceArray:
        scales = asked.scales
        bad = cells_of_voxels(asked, voxels_bad_for_error(asked))
        visible_in_cells(asked, bad, len(scales))
        found = distance_map(asked, bad, scales)
        raise_to_ways(asked, bad, len(scales), found)
        return found
