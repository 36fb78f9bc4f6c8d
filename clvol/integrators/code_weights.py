"""How much the errors of coded blocks count for a picture: as far as the transfer function shows them.

A value may be off by as much as leaves the colour that a ray shows behind a block of it about the same (CIELUV, as in
the selection of blocks). Where nothing is visible, and nothing visible is near in value, it may become anything near.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.encoding.coded_volume import EDGE
from clvol.errors import SceneError
from clvol.features import effects
from clvol.features.refuse import PLAIN
from clvol.integrators.multiresolution.luv import delta_e_luv, linear_to_luv
from clvol.lazily import lazily
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.encoding import trainer
else:
    trainer = lazily("clvol.encoding.trainer")

NOTICED = 1.0  # Delta-E that is about just noticed
_ENTRIES = 1024  # values at which colours are compared, beside the points of the function
_EFFECTS = PLAIN | {"nearest filter", "clipping"}  # with which a value alone decides what a sample shows


def check_weighting(resolved: ResolvedScene) -> None:
    """SceneError for weights in a scene that shows more of values than their colours."""
    if resolved.compression.weighting == "even" or not resolved.compression.is_lossy:
        return
    for effect in effects(resolved):
        if effect.called_for and effect.name not in _EFFECTS:
            where = f"{resolved.origin}: compression.weighting"
            what = f"got 'transfer-function' in a scene that calls for {effect.name}"
            raise SceneError(where, what, "'even', or a scene of emission and absorption with the filter 'linear'")


def block_weights(resolved: ResolvedScene) -> np.ndarray | None:
    """float64 [blocks]: the factor on squared errors of each block of 16^3 voxels, from 0 to 1; None: 1 for all.

    The bound of a block's errors, ``max_voxel_error`` divided by the root of its weight, is how far any value in the
    block, or within a voxel of it, can be displaced until its colour changes noticeably; at least ``max_voxel_error``.
    """
    if resolved.compression.weighting == "even":
        return None
    volume = resolved.volume
    low, high = volume.stored_range
    bound = (resolved.compression.max_voxel_error or trainer.DEFAULT_ERROR) * (high / 2 - low / 2) * 2
    if not 0 < bound < np.inf:
        return None
    path = EDGE * volume.grid.smallest_edge
    at, room = displacements(resolved.transfer_function, path, resolved.background, low, high)
    allowed = np.maximum(_least_between(at, room, *block_ranges(volume)), bound)
    return np.square(bound / allowed)


def displacements(
    function: TransferFunction, path: float, background: np.ndarray, low: float, high: float
) -> tuple[np.ndarray, np.ndarray]:
    """Values from ``low`` to ``high``, ascending, and how far each can be displaced within them until the colour of a
    ray through ``path`` (world) of it, over ``background`` (linear [3]), changes by NOTICED; inf: as far as they go."""
    points = function.values[(function.values > low) & (function.values < high)]
    sides = points, np.nextafter(points, -np.inf)  # of steps
    at = np.unique(np.concatenate([np.linspace(low, high, _ENTRIES), *sides]))
    alpha = -np.expm1(-np.minimum(function.extinction(at) * path, 700.0))[:, None]
    luv = linear_to_luv(function.color(at) * alpha + np.asarray(background) * (1.0 - alpha))
    room = np.empty(at.size)
    for k in range(at.size):
        other = np.abs(at - at[k])[delta_e_luv(luv, luv[k]) > NOTICED]
        room[k] = other.min(initial=np.inf)
    gap = np.diff(at, prepend=low, append=high)
    return at, np.maximum(room - np.maximum(gap[:-1], gap[1:]), 0.0)


def block_ranges(volume: Volume) -> tuple[np.ndarray, np.ndarray]:
    """float64 [blocks]: the smallest and largest finite voxel of each block and within a voxel of it; inf, -inf where
    there is none."""
    found = []
    for over, nothing in ((np.minimum, np.inf), (np.maximum, -np.inf)):
        voxels = volume.data
        if voxels.dtype.kind == "f":
            voxels = np.where(np.isfinite(voxels), voxels, nothing)
        for axis, n in enumerate(volume.shape):
            starts = np.arange(0, n, EDGE)
            ends = np.minimum(starts + EDGE + 1, n)
            parts = [np.s_[max(a - 1, 0) : b] for a, b in zip(starts.tolist(), ends.tolist())]
            along = np.moveaxis(voxels, axis, 0)
            voxels = np.moveaxis(np.stack([over.reduce(along[part], axis=0) for part in parts]), 0, axis)
        found.append(voxels.astype(np.float64).ravel())
    return found[0], found[1]


def _least_between(at: np.ndarray, room: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The smallest ``room`` at values from ``low`` to ``high`` [n]; inf where low > high."""
    first = np.clip(np.searchsorted(at, low, side="right") - 1, 0, at.size - 1)
    last = np.clip(np.searchsorted(at, high, side="left"), first, at.size - 1)
    least = [room]  # of 1, 2, 4, ... values from each on
    while 2 ** len(least) <= at.size:
        half = 2 ** (len(least) - 1)
        least.append(np.minimum(least[-1], np.append(least[-1][half:], np.full(half, np.inf))))
    level = np.log2(last - first + 1).astype(np.int64)
    table = np.stack(least)
    found = np.minimum(table[level, first], table[level, last + 1 - 2**level])
    return np.where(low > high, np.inf, found)
