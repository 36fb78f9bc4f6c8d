"""The oracle of volumes of blocks: the spacing of each block's samples."""

from __future__ import annotations

import numpy as np

from clvol.integrators.pyramid.cells import distance_map, upload_cells
from clvol.integrators.pyramid.oracle import Asked, Oracle
from clvol.opencl.context import DeviceArray


class Resolution(Oracle):
    """The spacing of the samples in visible blocks (kappa of Ljung 2006, here across rays as well as along them), and
    elsewhere the distance to visible blocks. The stepping "pyramid" of the method "multiresolution" uses it; no scene can
    name it."""

    name = "resolution"
    takes_epsilon = False

    def map(self, asked: Asked) -> DeviceArray:
        if asked.blocks is None:
            raise ValueError("the oracle 'resolution' needs a volume of blocks")
        shown, spacing = asked.blocks.shown, asked.blocks.spacing
        bad = np.zeros(asked.shape, np.uint8)
        for bit, scale in enumerate(asked.scales):
            bad |= ((spacing < scale) & shown).astype(np.uint8) << bit
        bad[asked.blocks.holes] = 255
        return distance_map(asked, upload_cells(asked, bad), asked.scales)
