"""The world length that opacities refer to where nothing is stated."""

from __future__ import annotations

import numpy as np

from clvol.volume.grid import Grid

_SHORTEST_EDGE_PER_UNIT = 32.0


def default_opacity_unit(grid: Grid) -> float:
    """The world length that presets state opacities for: a 32nd of the volume's shortest edge."""
    lower, upper = grid.index_bounds()
    edges = (np.asarray(upper) - np.asarray(lower)) * np.asarray(grid.spacing)
    return float(edges.min()) / _SHORTEST_EDGE_PER_UNIT
