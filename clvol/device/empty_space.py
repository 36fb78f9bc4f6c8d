"""Empty space: which cells of a volume can be visible, and how far every cell is from the nearest of them."""

from __future__ import annotations

from typing import Any, Protocol
from weakref import WeakKeyDictionary

import numpy as np

from clvol.device.host_cells import cell_distances, distances_on_host, octant_distances, octants_on_host
from clvol.device.memory import UNPERTURBED, Perturbation
from clvol.features import FILTER_REACH, overshoot
from clvol.opencl.arguments import INT4, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.transfer.lookup_nodes import LookupNodes

_ROUNDING = 2e-6  # relative error of a filter's sums in float32, with a margin


class CellBounds(Protocol):
    """Anything that knows the bounds of the values in each cell, as ``ResidentVolume.bounds``."""

    def bounds(self, apron: int) -> tuple[np.ndarray, np.ndarray]: ...


def visible_mask(
    volume: CellBounds,
    filter: str,
    nodes: LookupNodes,
    between: np.ndarray,
    at: np.ndarray,
    perturbation: Perturbation = UNPERTURBED,
) -> np.ndarray:
    """bool [z, y, x]: whether anything that ``filter`` interpolates in a cell can have opacity.

    ``between`` bool [n - 1]: whether look-ups between nodes k and k + 1 can give any opacity. ``at`` bool [n]:
    whether node k itself has any. That is all that matters for a cell whose only value is a node, which most
    background cells are.
    """
    lowest, highest = volume.bounds(FILTER_REACH[filter])
    mask = shows_between(nodes, between, at, lowest, highest, overshoot(filter), perturbation.added)
    return spread(mask, perturbation.cells, np.logical_or)


def shows_between(
    nodes: LookupNodes,
    between: np.ndarray,
    at: np.ndarray,
    lowest: np.ndarray,
    highest: np.ndarray,
    share: float = 0.0,
    added: float = 0.0,
) -> np.ndarray:
    """bool, in the shape of ``lowest``: whether anything from ``lowest`` to ``highest`` can have opacity; nothing can
    where lowest > highest. ``between`` and ``at`` are as in ``visible_mask``. The interval is widened on both sides
    by ``share`` of its span and by ``added``."""
    any_value = lowest <= highest
    low = np.where(any_value, lowest, nodes.first)
    high = np.where(any_value, highest, nodes.first)
    # The lowest value is node 0, also in float32, and whole numbers may lie on a node, too.
    exact = (low == nodes.first) | ((low == high) & nodes.is_exact(low))
    exact &= added == 0.0
    low_margin = np.where(exact, 0.0, nodes.rounding)
    high_margin = np.where(exact & (low == high), 0.0, nodes.rounding)
    low, high = _overshot(low, high, share)
    low, high = low - added, high + added
    first = np.floor(nodes.position(low) - low_margin)
    last = np.ceil(nodes.position(high) + high_margin)
    first = np.clip(first, 0, between.size).astype(np.int64)
    last = np.clip(last, 0, between.size).astype(np.int64)
    before = np.concatenate([[0], np.cumsum(between)])
    return any_value & np.where(first == last, at[first], before[last] > before[first])


def surface_mask(
    volume: CellBounds,
    filter: str,
    levels: list[float],
    perturbation: Perturbation = UNPERTURBED,
) -> np.ndarray:
    """bool [z, y, x]: whether what ``filter`` interpolates in a cell can take one of ``levels``."""
    lowest, highest = cell_bounds(volume, filter, perturbation)
    mask = np.zeros(lowest.shape, bool)
    for level in levels:
        mask |= (lowest <= level) & (level <= highest)
    return mask


def cell_bounds(
    volume: CellBounds, filter: str, perturbation: Perturbation = UNPERTURBED
) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and the highest value, [z, y, x], that a sample in each cell can have, up to rounding;
    infinite, with low > high, where there is none."""
    lowest, highest = volume.bounds(FILTER_REACH[filter])
    any_value = lowest <= highest
    lowest, highest = _overshot(lowest, highest, overshoot(filter))
    lowest = np.where(any_value, lowest - perturbation.added, np.inf)
    highest = np.where(any_value, highest + perturbation.added, -np.inf)
    reach = perturbation.cells
    return spread(lowest, reach, np.minimum), spread(highest, reach, np.maximum)


def spread(array: np.ndarray, cells: tuple[int, int, int], over: np.ufunc) -> np.ndarray:
    """``over`` (np.maximum, for example) applied to all entries of ``array`` [z, y, x] within ``cells`` (x, y, z) of
    each entry."""
    for axis, count in zip((2, 1, 0), cells):
        reach, most = 0, min(count, array.shape[axis] - 1)
        while reach < most:  # windows add up
            step = min(most - reach, 2 * reach + 1)
            grown = array.copy()
            others = (slice(None),) * axis
            ahead, behind = (*others, slice(step, None)), (*others, slice(None, -step))
            over(grown[ahead], array[behind], out=grown[ahead])
            over(grown[behind], array[ahead], out=grown[behind])
            array, reach = grown, reach + step
    return array


def dilated(mask: np.ndarray) -> np.ndarray:
    """``mask`` and all cells next to it, diagonally too."""
    for axis in range(mask.ndim):
        grown = mask.copy()
        ahead = [slice(None)] * mask.ndim
        behind = list(ahead)
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        grown[tuple(ahead)] |= mask[tuple(behind)]
        grown[tuple(behind)] |= mask[tuple(ahead)]
        mask = grown
    return mask
def _overshot(low: np.ndarray, high: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """The range of values that a filter can make of voxels from ``low`` to ``high``: wider by ``share`` of their span
    on both sides, and by rounding. From equal voxels it makes exactly their value."""
    if not share:
        return low, high
    more = share * (high - low) + _ROUNDING * np.maximum(np.abs(low), np.abs(high))
    more = np.where(low == high, 0.0, more)
    return low - more, high + more


_last_maps: WeakKeyDictionary[DeviceContext, tuple[tuple[Any, ...], DeviceArray]] = WeakKeyDictionary()


def distance_map(context: DeviceContext, mask: np.ndarray, octants: bool = False) -> DeviceArray:
    """uint8 [z, y, x] on the device: distance in cells (maximum norm, at most 255) to the nearest
    cell of ``mask``; 0 inside the mask. ``octants``: eight more follow, in each of which only cells ahead count, in no
    coordinate behind: to larger x in those whose number has bit 0, y bit 1, z bit 2."""
    if octants or distances_on_host(context, mask.size):
        key = octants, mask.shape, mask.tobytes()
        known = _last_maps.get(context)
        if known is None or known[0] != key:  # functions that show the same values have the same map
            known = _last_maps[context] = key, _with_octants(context, mask) if octants else _on_host(context, mask)
        return known[1]
    return _by_kernel(context, mask)


def _on_host(context: DeviceContext, mask: np.ndarray) -> DeviceArray:
    return context.upload(np.append(cell_distances(mask), np.full(4, 255, np.uint8)))


def _by_kernel(context: DeviceContext, mask: np.ndarray) -> DeviceArray:
    start = np.where(mask, 0, 255).astype(np.uint8)
    # A 32-bit gather of the last byte must stay inside the buffer.
    padded = np.concatenate([start.ravel(), np.full(4, 255, np.uint8)])
    distances = context.upload(padded)
    if not mask.any():
        return distances
    kernel = context.kernel(
        "empty_space.cl",
        "distance_pass",
        (
            reads("source", np.uint8, "cells.x", "cells.y", "cells.z"),
            writes("target", np.uint8, "cells.x", "cells.y", "cells.z"),
            value("cells", INT4),
            value("axis", np.int32),
        ),
        {"VOXEL_BITS": 8, "VOXEL_SIGNED": 0},
    )
    cells = mask.shape[::-1]
    spare = [context.upload(padded, writable=True) for _ in range(2)]
    for axis in range(3):
        target = spare[axis % 2]
        kernel(
            context.queue, cells[1:], None, source=distances, target=target, cells=(*cells, 0), axis=axis
        )
        distances = target
    context.finish()
    return distances


def _with_octants(context: DeviceContext, mask: np.ndarray) -> DeviceArray:
    """``distance_map`` with the maps of the octants."""
    beyond = np.full(4, 255, np.uint8)
    if octants_on_host(context, mask.size):
        return context.upload(np.concatenate([cell_distances(mask).ravel(), octant_distances(mask).ravel(), beyond]))
    maps = context.upload(np.append(np.empty(9 * mask.size, np.uint8), beyond), writable=True)
    own = _on_host if distances_on_host(context, mask.size) else _by_kernel
    context.copy(own(context, mask), 0, maps, 0, mask.size)
    kernel = context.kernel(
        "empty_space.cl",
        "octant_distances",
        (writes("maps", np.uint8, 9, "cells.x", "cells.y", "cells.z"), value("cells", INT4)),
        {"VOXEL_BITS": 8, "VOXEL_SIGNED": 0},
    )
    kernel(context.queue, (8,), None, maps=maps, cells=(*mask.shape[::-1], 0))
    context.finish()
    return maps
