"""The oracle of Kraus et al. (2007): the distance to where opacity changes."""

from __future__ import annotations

from clvol.integrators.pyramid.cells import cells_of_voxels, distance_map, voxels_of_steep_opacity
from clvol.integrators.pyramid.oracle import Asked, Oracle
from clvol.opencl.context import DeviceArray


class OpacityGradient(Oracle):
    """Distance to the nearest voxel whose opacity gradient exceeds epsilon (Kraus et al. 2007, section 4): the opacity of a
    path one smallest voxel edge long, its change over such an edge by central differences."""

    name = "opacity-gradient"

    def map(self, asked: Asked) -> DeviceArray:
        bad = cells_of_voxels(asked, voxels_of_steep_opacity(asked))
        return distance_map(asked, bad, [1.0])
