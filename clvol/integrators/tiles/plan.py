"""From what rays through the tiles' corners meet to the resolution of each tile (Ljung 2006,
section 4.1)."""

from __future__ import annotations

from typing import Literal

import numpy as np

MAXIMUM, AVERAGE, RMS, COUNT = range(4)
"""Of ``corners`` [rows + 1, columns + 1, 4]: the greatest, the mean and the root mean square of the
scale kappa in [0, 1] (samples an axis over those at full resolution; 0: dropped) of the blocks
along the ray through a tile corner, and how many blocks there are; 0 for a ray that misses the
volume."""

Priority = Literal["max", "average", "rms"]


def priorities(corners: np.ndarray, priority: Priority) -> np.ndarray:
    """float64 [rows, columns] in [0, 1]: how much resolution each tile deserves.

    "max": the greatest of its corners' maxima; "average": the mean of their means; "rms": the root
    mean square of theirs. Of a tile that lies partly beside the volume only the corners count that
    meet it: a ray that meets no block has no mean of them. 0 where no corner does. (Ljung drops
    such tiles. But a corner of the volume can poke into a tile between its corners: here they get the
    lowest quality, and rays that miss cost next to nothing.)
    """
    corners = np.asarray(corners, np.float64)
    meets = _of_tiles(corners[..., COUNT]) > 0
    if priority == "max":
        return np.where(meets, _of_tiles(corners[..., MAXIMUM]), 0.0).max(axis=-1)
    power = {"average": 1, "rms": 2}[priority]
    values = _of_tiles(corners[..., {1: AVERAGE, 2: RMS}[power]]) ** power
    total = np.where(meets, values, 0.0).sum(axis=-1)
    return (total / np.maximum(meets.sum(axis=-1), 1)) ** (1.0 / power)


def _of_tiles(corners: np.ndarray) -> np.ndarray:
    """[rows, columns, 4] of [rows + 1, columns + 1]: each tile's four corners."""
    left, right = corners[:, :-1], corners[:, 1:]
    return np.stack([left[:-1], right[:-1], left[1:], right[1:]], axis=-1)


def histogram(priority: np.ndarray, slots: int) -> tuple[np.ndarray, np.ndarray]:
    """int64 [slots + 1] how many tiles have a priority in each slot, and int64 [...] each one's
    slot.

    Slot 0 holds those of priority 0, slot k those in ((k - 1) / slots, k / slots].
    """
    # A priority that only rounding lifts above k / slots belongs below.
    slot = np.ceil(np.asarray(priority) * slots - 1e-9).clip(0, slots).astype(np.int64)
    return np.bincount(slot.ravel(), minlength=slots + 1), slot


def qualities(priority: np.ndarray, low: float, high: float, slots: int) -> np.ndarray:
    """Shares of a tile's edge in (0, 1]: ``high`` in the highest slot that any tile is in, from
    there linear in the number of the slot down to ``low`` for those of priority 0. ``slots``: Ljung
    takes as many as a block's edge has samples."""
    counts, slot = histogram(priority, slots)
    top = int(np.flatnonzero(counts)[-1])
    return low + (high - low) * slot / max(top, 1)


def planned_tau(quality: np.ndarray, size: int) -> np.ndarray:
    """int64: lines an axis of tiles of ``size``, at least 1."""
    tau = np.floor(np.asarray(quality, np.float64) * size + 0.5).astype(np.int64)
    return tau.clip(1, size)


def plan(
    corners: np.ndarray, priority: Priority, low: float, high: float, slots: int, size: int
) -> np.ndarray:
    """int64 [rows, columns]: tau of each tile."""
    return planned_tau(qualities(priorities(corners, priority), low, high, slots), size)
