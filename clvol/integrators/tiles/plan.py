"""The resolution of each tile, from the blocks that rays through the tiles' corners meet (Ljung 2006,
section 4.1)."""

from __future__ import annotations

from typing import Literal

import numpy as np

MAXIMUM, AVERAGE, RMS, COUNT = range(4)
"""The last axis of ``corners`` [rows + 1, columns + 1, 4]: the maximum, the mean and the root mean square of the
scale kappa in [0, 1] (samples per axis relative to full resolution; 0: dropped) of the blocks
along the ray through a tile corner, and the number of blocks; 0 for a ray that misses the
volume."""

Priority = Literal["max", "average", "rms"]


def priorities(corners: np.ndarray, priority: Priority) -> np.ndarray:
    """float64 [rows, columns] in [0, 1]: the priority of each tile, which decides its resolution.

    "max": the maximum of its corners' maxima; "average": the mean of their means; "rms": the root
    mean square of theirs. In a tile that lies partly outside the volume only the corners inside
    count, since a ray that meets no block has no mean. 0 where no corner meets the volume. (Ljung drops
    such tiles, but a corner of the volume can reach into a tile between its corners: here they get the
    lowest quality, and rays that miss the volume cost next to nothing.)
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
    """Each tile's four corners: [rows, columns, 4] from [rows + 1, columns + 1]."""
    left, right = corners[:, :-1], corners[:, 1:]
    return np.stack([left[:-1], right[:-1], left[1:], right[1:]], axis=-1)


def histogram(priority: np.ndarray, slots: int) -> tuple[np.ndarray, np.ndarray]:
    """int64 [slots + 1], the number of tiles whose priority lies in each slot, and int64 [...], the slot of each
    tile.

    Slot 0 holds the tiles of priority 0, slot k those with a priority in ((k - 1) / slots, k / slots].
    """
    # A priority that exceeds k / slots only by rounding belongs to slot k.
    slot = np.ceil(np.asarray(priority) * slots - 1e-9).clip(0, slots).astype(np.int64)
    return np.bincount(slot.ravel(), minlength=slots + 1), slot


def qualities(priority: np.ndarray, low: float, high: float, slots: int) -> np.ndarray:
    """Shares of a tile's edge in (0, 1]: ``high`` in the highest slot that holds any tile, from
    there linear in the number of the slot down to ``low`` for priority 0. ``slots``: Ljung
    takes the number of samples along a block's edge."""
    counts, slot = histogram(priority, slots)
    top = int(np.flatnonzero(counts)[-1])
    return low + (high - low) * slot / max(top, 1)


def planned_tau(quality: np.ndarray, size: int) -> np.ndarray:
    """int64: lines per axis of tiles of ``size``, at least 1."""
    tau = np.floor(np.asarray(quality, np.float64) * size + 0.5).astype(np.int64)
    return tau.clip(1, size)


def plan(
    corners: np.ndarray, priority: Priority, low: float, high: float, slots: int, size: int
) -> np.ndarray:
    """int64 [rows, columns]: tau of each tile."""
    return planned_tau(qualities(priorities(corners, priority), low, high, slots), size)
