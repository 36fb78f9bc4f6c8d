"""The footprint of a pixel in a volume, and the levels that a picture takes for it (cl/volume_levels.h)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clvol.device.view import RayFrame
from clvol.volume import Volume
from clvol.volume.level_layout import level_edge, levels_of
from clvol.volume.voxel_layout import padded_size

_ROUNDING = 1e-5  # relative, of footprints in single precision


class Footprint(NamedTuple):
    """A pixel's side at a lattice place (x, y, z), on the plane through it that is parallel to the picture:
    ``constant`` + ``slope`` . place, in edges of the voxels of level 0."""

    slope: tuple[float, float, float]
    constant: float

    def extremes(self, size: tuple[int, int, int]) -> tuple[float, float]:
        """The least and the largest in a volume of ``size`` (x, y, z) lattice points; below 0 behind the eye."""
        ends = [(min(s * (n - 1), 0.0), max(s * (n - 1), 0.0)) for s, n in zip(self.slope, size)]
        return self.constant + sum(e[0] for e in ends), self.constant + sum(e[1] for e in ends)


def footprint_of(frame: RayFrame, volume: Volume, bias: float) -> Footprint:
    """The footprint of the pixels of ``frame``, times 2^``bias``: orthographic ones have one size, those of a
    perspective view grow in proportion to the depth. Pixels of supersampled pictures are shares of a pixel."""
    grid = volume.grid
    columns = grid.direction * np.asarray(grid.spacing) / frame.unit  # in smallest edges per lattice unit
    forward = columns @ frame.forward
    at_origin = float(np.linalg.norm(columns @ frame.du))
    slope = frame.lens[0] * (forward @ columns)  # the side grows by lens[0] per edge of depth
    scale = frame.pixel * 2.0**bias * (frame.unit / level_edge(volume))
    constant = scale * (at_origin - float(slope @ frame.origin))
    x, y, z = (scale * slope).tolist()
    return Footprint((x, y, z), constant)


def levels_seen(footprint: Footprint, volume: Volume) -> tuple[int, int]:
    """The finest and the coarsest level that samples anywhere in ``volume`` are blended of. Footprints within rounding
    of a level's edge are taken for that edge."""
    levels = len(levels_of(volume))
    least, most = footprint.extremes(padded_size(volume))
    first = _exponent(least * (1.0 + _ROUNDING))
    largest = most * (1.0 - _ROUNDING)
    last = _exponent(largest) + (largest > 1.0)
    return min(first, levels - 1), min(last, levels - 1)


def _exponent(footprint: float) -> int:
    """The level whose voxels have edges at most that long."""
    return math.frexp(footprint)[1] - 1 if footprint >= 1.0 else 0
