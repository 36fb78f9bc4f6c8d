"""Voxels held in fewer bits than in their file: less memory to read, at the cost of an error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from clvol.errors import SceneError
from clvol.scene.codes import in_codes
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume

_SLICES = 2**22  # voxels quantised at a time, in double precision


def quantised(resolved: ResolvedScene, codes: Volume | None = None) -> ResolvedScene:
    """``resolved`` with its voxels as ``integration.voxel_precision`` says: evenly spaced over the
    volume's range and rounded to nearest, with everything stated in values (the transfer function, iso-values, ...)
    converted to the same numbers. ``codes``: the volume that an earlier call made of ``resolved.volume``.

    SceneError if a voxel is not finite, which integers cannot express.
    """
    precision, volume = resolved.integration.voxel_precision, resolved.volume
    if precision == "stored" or np.dtype(precision).itemsize >= volume.dtype.itemsize:
        return resolved
    if volume.nan_count or volume.inf_count:
        bad = volume.nan_count + volume.inf_count
        where = f"{resolved.origin}: integration.voxel_precision"
        raise SceneError(where, f"got {precision!r} for {bad} voxels that are not finite", "'stored'")
    low, high = volume.value_range
    most = np.iinfo(precision).max
    # Values are halved first: high - low may overflow.
    span = (high / 2 - low / 2) * 2
    if not 0 < span < np.inf:
        return resolved

    def code(values: ArrayLike) -> np.ndarray:
        return (np.asarray(values, np.float64) - low) / span * most

    if codes is None:
        codes = _volume_of_codes(volume, code, precision)
    return replace(resolved, volume=codes, **in_codes(resolved, code, most / span))


def _volume_of_codes(volume: Volume, code: Callable, dtype: str) -> Volume:
    grid, flat = volume.grid, volume.data.reshape(-1)
    codes = np.empty(flat.size, dtype)
    for start in range(0, flat.size, _SLICES):
        part = slice(start, start + _SLICES)
        codes[part] = np.rint(code(flat[part]))
    return Volume(
        codes.reshape(volume.data.shape),
        spacing=grid.spacing, origin=grid.origin, direction=grid.direction, name=volume.name,
    )  # fmt: skip
