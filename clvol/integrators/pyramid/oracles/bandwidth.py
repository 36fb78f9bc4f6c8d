"""The oracle that depends only on the data, from a min-max grid."""

from __future__ import annotations

import numpy as np

from clvol.device.empty_space import spread
from clvol.integrators.pyramid.cells import cells_of_voxels, distance_map, upload_cells
from clvol.integrators.pyramid.oracle import Asked, Oracle
from clvol.opencl.context import DeviceArray

_COARSER = 1  # the grid's cells are twice as long as the map's


class Bandwidth(Oracle):
    """The distance over which values can be interpolated within epsilon, a share of the volume's range, regardless of
    the transfer function. An interpolated value lies between its samples: where the lowest and the highest value
    within half a distance differ by at most epsilon, samples may be that distance apart."""

    name = "bandwidth"

    def map(self, asked: Asked) -> DeviceArray:
        shift = asked.shift + _COARSER
        low, high = asked.volume.min_max(shift)
        allowed = asked.epsilon * np.ptp(asked.volume.value_range)
        bad = np.zeros(low.shape, np.uint8)
        for bit, scale in enumerate(asked.scales):
            x, y, z = (int(scale / 2 / (edge * (1 << shift))) for edge in asked.edges)
            span = spread(high, (x, y, z), np.maximum) - spread(low, (x, y, z), np.minimum)
            bad |= (span > allowed).astype(np.uint8) << bit
        for axis in range(3):
            bad = np.repeat(bad, 1 << _COARSER, axis=axis)
        nz, ny, nx = asked.shape
        bad = bad[:nz, :ny, :nx]
        if asked.volume.switches["VOXEL_HOLES"]:
            bad[_holes(asked)] = 255
        return distance_map(asked, upload_cells(asked, bad), asked.scales)


def _holes(asked: Asked) -> np.ndarray:
    """bool [z, y, x]: cells with a voxel that is not finite."""
    context, (nz, ny, nx) = asked.context, asked.shape
    voxels = np.zeros(asked.volume.size[::-1], np.uint8)
    for box in asked.volume.boxes((0, 0)):
        (y0, z0), (y1, z1), first = box.place.begin, box.place.end, box.place.first
        own = context.read(box.voxels)[z0 - first[1] : z1 - first[1], y0 - first[0] : y1 - first[0]]
        voxels[z0:z1, y0:y1] = ~np.isfinite(own)
    cells = cells_of_voxels(asked, context.upload(voxels))
    return context.read(cells)[:nz, :ny, :nx] > 0
