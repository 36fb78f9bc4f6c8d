"""The oracle of empty space."""

from __future__ import annotations

import numpy as np

from clvol.opencl.context import DeviceArray
from clvol.render.pyramid.cells import distance_map, distances_by_scale
from clvol.render.pyramid.oracles.base import Asked, Oracle


class Visible(Oracle):
    """Distance to the nearest cell in which anything can be visible: what is empty is not sampled densely, and
    all else is, so that pictures are those of the minimum distance but for what lies next to visible space."""

    name = "visible"
    takes_epsilon = False

    def map(self, asked: Asked) -> DeviceArray:
        found = asked.context.read(asked.statistics.values)[:2].astype(np.float64)
        shown = asked.shows(found[0], found[1]).astype(np.uint8)
        bad = asked.context.upload(shown)
        return distance_map(asked, distances_by_scale(asked, bad, [asked.reach]))
