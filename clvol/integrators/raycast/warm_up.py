"""The first launches of a scene's kernels, in which drivers finish compiling."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.integrators.raycast.history import arrays_to_warm_up, warm_up_reprojection
from clvol.integrators.raycast.measured_gain import LEAST_PIXELS
from clvol.opencl.context import restore_interrupts
from clvol.schedule.tiles import tiling

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster


def warm_up(caster: Raycaster, width: int, height: int, depth: bool, chosen: np.ndarray | None) -> None:
    """Launches all kernels of a picture of this size without pixels, once per program. ``chosen``: the tiles that are
    launched; None: all."""
    tiles = tiling(width, height, *caster.tile).count
    fills, lists = caster.resolved.image.ray_spacing > 1, caster.resolved.image.refines and caster.lists_rays
    how = depth, fills, lists, chosen is None, caster.resolved.coherence.mode == "reproject"
    key = (type(caster.march), caster.tile, tiles, *how, tuple(caster.switches.items()))
    if key in caster.context.warmed or caster.shows_nothing:
        return
    caster.march.begin(caster, None, width, height)
    view = np.zeros(1, caster.view_dtype)  # an image without pixels: every work-item returns
    view["tile"] = caster.tile
    counts = [caster.context.empty(np.uint32, (tiles,)) for _ in range(2)]
    none = {"image": caster.no_array, "depths": caster.no_array, "samples": counts[0]}
    tallies = []  # kept until they are written
    starts = arrays_to_warm_up(caster, tiles)
    both = bool(starts) and width * height >= LEAST_PIXELS  # with starts and without (measured_gain.py)
    for outputs in (none, none | starts) if both else (none | starts,):
        if caster.without_surfaces is None:
            tallies.append(caster.launches("raycast", view, tiles, depth, None, outputs, chosen))
        else:
            for engine in (caster, caster.without_surfaces):
                tallies.append(engine.launches("raycast", view, tiles, depth, None, outputs, np.zeros(1, np.int64)))
    if starts:
        warm_up_reprojection(caster.context)
    if fills:
        more = {"coarse": caster.no_array, "coarse_depths": caster.no_array, "rays": counts[1]}
        tallies.append(caster.launches("fill_between_rays", view, tiles, depth, None, none | more, chosen))
    if lists:
        none |= {"listed": caster.context.empty(np.int32, (2,))}
        tallies.append(caster.launches("listed_rays", view, tiles, depth, None, none, chosen))
    caster.context.finish()
    restore_interrupts()
    caster.context.warmed.add(key)
