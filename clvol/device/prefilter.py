"""B-spline coefficients of a volume, with which the cubic filter interpolates its voxels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume

_CHUNK = 2**22  # voxels filtered at a time, in double precision
# Coefficients are at most 27 times the largest voxel; float32 rounds small ones evenly from here on.
_FLOAT32 = (1e-30, 1e37)


def prefiltered(resolved: ResolvedScene, filtered: Volume | None = None) -> ResolvedScene:
    """``resolved`` with the coefficients of the cubic B-spline through its voxels in place of them,
    if ``integration.prefilter`` and the cubic filter are requested.

    Coefficients are float32 (float64 for float64 voxels, and where they exceed the range of float32) and
    take no more memory than that: the filter runs axis by axis in place, chunk by chunk (about
    100 MB). Beyond the volume the outermost coefficient is repeated, as in the kernels.

    Voxels that are not finite stay unchanged; for the filter they are filled with the nearest
    finite ones, which takes a copy of the volume and 14 more bytes per voxel meanwhile.
    ``filtered``: the volume that an earlier call made of ``resolved.volume``.
    """
    integration, volume = resolved.integration, resolved.volume
    if not (integration.prefilter and integration.filter == "cubic"):
        return resolved
    if filtered is None:
        grid = volume.grid
        filtered = Volume(
            coefficients(volume),
            spacing=grid.spacing, origin=grid.origin, direction=grid.direction, name=volume.name,
            frame=volume.frame, path=volume.path, format=volume.format,
        )  # fmt: skip
    return replace(resolved, volume=filtered, voxel_range=resolved.data_range)


def coefficients(volume: Volume) -> np.ndarray:
    """The coefficients [z, y, x] of ``prefiltered``."""
    data, bad = volume.data, None
    if volume.nan_count + volume.inf_count:
        bad = ~np.isfinite(data)
        data = _filled(data, bad, volume.grid.spacing)
    largest = max(abs(v) for v in volume.value_range)
    in_range = largest == 0 or _FLOAT32[0] < largest < _FLOAT32[1]
    dtype = np.float32 if volume.dtype != np.float64 and in_range else np.float64
    out = np.empty(data.shape, dtype)
    for axis, source in enumerate((data, out, out)):
        _filter_axis(source, out, axis)
    if bad is not None:
        out[bad] = volume.data[bad]
    return out


def _filter_axis(source: np.ndarray, out: np.ndarray, axis: int) -> None:
    """The coefficients of each line of ``source`` along ``axis``, into ``out`` (which may be it).

    At voxel centres the B-spline has weights 1, 4, 1 (/ 6), at the ends 5, 1: a system that is
    solved directly. (scipy.ndimage.spline_filter is off by as much as 1e-4 on axes of a few voxels.)
    """
    n = source.shape[axis]
    if n == 1:
        out[...] = source
        return
    from scipy import linalg  # importing it takes a quarter of a second, which other scenes save

    bands = np.full((2, n), 4.0)
    bands[0], bands[1, 0], bands[1, -1] = 1.0, 5.0, 5.0
    across = 1 if axis == 0 else 0
    thick = max(1, _CHUNK * source.shape[across] // source.size)
    for start in range(0, source.shape[across], thick):
        chunk = (slice(None),) * across + (slice(start, start + thick),)
        lines = np.moveaxis(source[chunk], axis, 0)
        right = lines.reshape(n, -1).astype(np.float64)
        first = right[0].copy()  # coefficients of the differences from there, so that a constant line stays unchanged
        right -= first
        right *= 6.0
        solved = linalg.solveh_banded(bands, right, overwrite_b=True, check_finite=False)
        solved += first
        np.moveaxis(out[chunk], axis, 0)[...] = solved.reshape(lines.shape)


def _filled(data: np.ndarray, bad: np.ndarray, spacing: tuple[float, float, float]) -> np.ndarray:
    """``data`` [z, y, x] with each ``bad`` voxel replaced by the nearest finite one in world space."""
    if bad.all():
        return np.zeros_like(data)
    from scipy import ndimage

    nearest = ndimage.distance_transform_edt(
        bad, sampling=spacing[::-1], return_distances=False, return_indices=True
    )
    return data[tuple(nearest)]
