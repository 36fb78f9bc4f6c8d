"""Constant cells: where the field has one value and no gradient, so that rays need neither samples nor light there.

cl/march_shaded.h uses a map of them. Whether a scene has enough of them to pay for looking is decided on a sample of
its volume, on the host, as for steps that follow the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from clvol.encoding.coded_volume import UndecodedVolume
from clvol.features.values import shows
from clvol.integrators.raycast.step_map import sampled_cells
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction
from clvol.volume.lazy import LazyVolume

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster

_REACH = 1  # voxels beyond a cell that a gradient in it depends on
_WORTH = 0.2  # share of the cells that show something; looking costs rays that find nothing a few percent
# Effects under which a constant field does not look constant.
_CHANGES = ("CLIP", "DEPTH_CUE", "NOISE", "AMBIENT_OCCLUSION")


def uses_constant_cells(
    resolved: ResolvedScene, switches: Mapping[str, int], function: TransferFunction | None = None
) -> bool:
    """Whether rays of the scene, with ``function`` in place of its own, look for constant cells. ``switches``: those of
    its effects."""
    volume = resolved.volume
    if not switches.get("SEGMENT_OPACITIES") or not switches["LIGHTING"] or not switches["TRANSLUCENT"]:
        return False
    if any(switches.get(name) for name in _CHANGES):
        return False
    if isinstance(volume, LazyVolume) and (isinstance(volume, UndecodedVolume) or not volume.is_read):
        return False
    if volume.nan_count or volume.inf_count:
        return False
    curvature, slope, low, high = sampled_cells(volume).T
    visible = shows(function or resolved.transfer_function, low, high)
    constant = (low == high) & (slope == 0) & (curvature == 0)
    return bool(visible.any()) and float(np.mean(constant[visible])) >= _WORTH


def changing_cells(caster: Raycaster) -> np.ndarray:
    """bool [z, y, x]: the cells of the map of empty space in which the field or its gradient may change."""
    volume, cells = caster.volume, caster.map_cells[::-1]
    if caster.map_shift == volume.cell_shift:
        low, high = volume.bounds(_REACH)
    else:
        low, high = volume.fine_bounds(_REACH, np.ones(cells, bool))
    return (low != high).reshape(cells)
