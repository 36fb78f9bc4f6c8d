"""The oracle of the data alone, from a min-max grid."""

from __future__ import annotations

import numpy as np

from clvol.opencl.context import DeviceArray
from clvol.render.empty_space import spread
from clvol.render.pyramid.cells import distance_map, distances_by_scale
from clvol.render.pyramid.oracles.base import Asked, Oracle


class Bandwidth(Oracle):
    """How far values can be interpolated within epsilon, a share of the volume's range, whatever the transfer function
    makes of them: an interpolated value lies between its samples, so where lowest and highest value
    nearer than a distance differ by no more than epsilon, samples may be that distance apart."""

    name = "bandwidth"

    def map(self, asked: Asked) -> DeviceArray:
        found = asked.context.read(asked.statistics.values)
        low, high = (part.astype(np.float64) for part in found[:2])
        has_holes = np.isinf(found[2])  # or deviates by more than any value
        allowed = asked.epsilon * np.ptp(asked.volume.value_range)
        bad = np.zeros(low.shape, np.uint8)
        for bit, scale in enumerate(asked.scales):
            around = tuple(int(np.ceil(scale / 2 / (e * (1 << asked.shift)))) for e in asked.edges)
            span = spread(high, around, np.maximum) - spread(low, around, np.minimum)
            bad |= (has_holes | (span > allowed)).astype(np.uint8) << bit
        distances = distances_by_scale(asked, asked.context.upload(bad), asked.scales)
        return distance_map(asked, distances)
