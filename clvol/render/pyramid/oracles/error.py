"""The oracle of a bounded error of the picture."""

from __future__ import annotations

from clvol.opencl.context import DeviceArray
from clvol.render.pyramid.cells import bad_for_error, distance_map, distances_by_scale
from clvol.render.pyramid.oracles.base import KERNEL_ERROR, Asked, Oracle


class Error(Oracle):
    """How far apart samples may be so that a segment of that length between them, values interpolated linearly along it and
    across, is wrong by at most epsilon in each channel of its premultiplied linear colour: from how far values are off the chord
    between samples that far apart, and how fast the transfer function turns that into colour. Where little
    light arrives from more error is allowed: distances grow with the inverse square root of the transmittance,
    since errors grow with the square of the distance; at most epsilon^(-1/2) times."""

    name = "error"
    kernel = KERNEL_ERROR

    def map(self, asked: Asked) -> DeviceArray:
        return distance_map(asked, distances_by_scale(asked, bad_for_error(asked), asked.scales))
