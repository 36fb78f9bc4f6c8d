"""The reference: the exact emission-absorption integral, the ground truth of every other method.

There is no step size: the field along a ray is a polynomial in each cell, the transfer function is
linear between control points, and every smooth piece is integrated to a tolerance
(cl/reference.cl). It shares no code with the ray caster.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.errors import SceneError, UsageError
from clvol.integrators.reference.program import integrate_rays

if TYPE_CHECKING:
    import pyopencl

    from clvol.scene.resolve import ResolvedScene
    from clvol.transfer import TransferFunction
    from clvol.volume import Grid, Volume

FILTERS = ("linear", "nearest", "cubic")
_LARGEST_EXPONENT = 500  # of values; beyond it products of differences overflow, or shares underflow


def render_reference(
    resolved: ResolvedScene,
    device: pyopencl.Device | Sequence[pyopencl.Device],
    tolerance: float = 1e-9,
    pixels: ArrayLike | None = None,
    progress: Callable[[int, int], None] | None = None,
    on_loss: Callable[[int, BaseException], None] | None = None,
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """The picture of ``resolved``, exact to about ``tolerance`` in linear premultiplied RGBA.

    ``device``: one, or several that share the rays; one of these that fails is left out, with a warning, or a call of
    ``on_loss(device, error)``.
    ``pixels``: int [n, 2], (row, column) of the pixels to evaluate; without it the whole image.
    ``progress(done, total)`` is called now and then with numbers of pixels.

    Returns (rgba, depth, counters): float64 [height, width, 4] and [height, width], or [n, 4] and
    [n] for ``pixels``. ``depth`` is the world distance from the ray's origin (the eye, or the
    camera plane of an orthographic view) at which the accumulated opacity reaches one half, inf where
    it never does. ``counters``: "rays"; "cells" walked; "pieces" integrated; "samples" (evaluations of
    the field); "failed_pieces" that missed the tolerance within the bounded work, and
    "failed_rays" that hold one; "error_estimate", the largest sum of error estimates over a ray;
    "seconds" (upload and kernels).

    Classification "post" and "preintegrated" have one and the same integral. "pre" interpolates
    the extinction tau and the emission c tau of the voxels.

    Raises SceneError for what the reference does not integrate (isosurfaces, clip planes,
    lights), UsageError for a wrong argument, DeviceError without fp64 or if the device
    fails.
    """
    _check_supported(resolved)
    if not 0.0 < tolerance < 1.0:
        raise UsageError("tolerance", f"got {tolerance!r}", "a number between 0 and 1")
    width, height = resolved.image.width, resolved.image.height
    if pixels is None:
        origins, directions = resolved.camera.world_rays(width, height)
    else:
        origins, directions = resolved.camera.world_rays_of(width, height, *_pixel_indices(pixels, width, height))
    shape = origins.shape[:-1]

    rgba, depth, counters = integrate_world_rays(
        resolved.volume,
        resolved.transfer_function,
        origins.reshape(-1, 3),
        directions.reshape(-1, 3),
        device,
        tolerance=tolerance,
        filter=resolved.integration.filter,
        preclassified=resolved.integration.classification == "pre",
        progress=progress,
        on_loss=on_loss,
    )
    return rgba.reshape(*shape, 4), depth.reshape(shape), counters


def integrate_world_rays(
    volume: Volume,
    transfer_function: TransferFunction,
    origins: np.ndarray,
    directions: np.ndarray,
    device: pyopencl.Device | Sequence[pyopencl.Device],
    *,
    tolerance: float = 1e-9,
    filter: str = "linear",
    preclassified: bool = False,
    progress: Callable[[int, int], None] | None = None,
    on_loss: Callable[[int, BaseException], None] | None = None,
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """As ``render_reference``, for n rays given in the world.

    ``origins`` and unit ``directions`` are float64 [n, 3]; the ray is origin + t direction, t >= 0.
    ``filter``: "nearest", "linear" or "cubic".
    """
    if filter not in FILTERS:
        expected = " or ".join(repr(name) for name in FILTERS)
        raise UsageError("filter", f"got {filter!r}", expected)
    origins, directions = to_index(volume.grid, origins, directions)
    scale, control = _control_points(volume, transfer_function)
    result = integrate_rays(
        device,
        volume.data,
        scale,
        control,
        transfer_function.opacity_unit,
        tolerance,
        origins,
        directions,
        filter=filter,
        preclassified=preclassified and filter != "nearest",
        progress=progress,
        on_loss=on_loss,
    )
    totals = result.counters.sum(axis=0, dtype=np.int64)
    counters = {
        "rays": len(origins),
        "cells": int(totals[0]),
        "pieces": int(totals[1]),
        "samples": int(totals[2]),
        "failed_pieces": int(totals[3]),
        "failed_rays": int(np.count_nonzero(result.counters[:, 3])),
        "error_estimate": float(result.error.max(initial=0.0)),
        "seconds": result.seconds,
    }
    return result.rgba, result.depth, counters


def to_index(
    grid: Grid, origins: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """World rays [n, 3] in index space (x, y, z); the parameter stays the world distance."""
    matrix = grid.world_to_index()[:3, :3]
    # The grid's origin is subtracted first, since that difference may be exact.
    origins = (np.asarray(origins, np.float64) - np.asarray(grid.origin)) @ matrix.T
    return origins, np.asarray(directions, np.float64) @ matrix.T


def _control_points(
    volume: Volume, transfer_function: TransferFunction
) -> tuple[float, dict[str, np.ndarray]]:
    """The factor that scales all values, and the control points on that scale."""
    values, opacities = transfer_function.values, transfer_function.opacities
    lower, upper = volume.value_range
    largest = max(abs(lower), abs(upper), float(np.abs(values).max()))
    exponent = math.frexp(largest)[1]
    scale = 1.0
    if abs(exponent) > _LARGEST_EXPONENT and largest > 0.0:
        scale = 2.0 ** min(1 - exponent, 1000)
    values = values * scale
    # Region r lies below point r and above point r - 1; it shows unless both are transparent.
    # The empty region inside a step never holds a value.
    low = np.concatenate([opacities[:1], opacities])
    high = np.concatenate([opacities, opacities[-1:]])
    shows = (low > 0) | (high > 0)
    shows[1:-1] &= values[1:] > values[:-1]
    return scale, {
        "value": values,
        "opacity": opacities,
        "clearness": 1.0 - opacities,
        "color": transfer_function.colors,
        "visible_below": np.concatenate([[0], np.cumsum(shows)]),
    }


def _check_supported(resolved: ResolvedScene) -> None:
    for key, entries in (
        ("isosurface", resolved.isosurfaces),
        ("clip", resolved.clips),
        ("light", resolved.lights),
    ):
        if entries:
            raise SceneError(
                f"{resolved.origin}: {key}",
                f"got {len(entries)} with method 'reference'",
                "none: the reference integrates emission and absorption alone",
            )


def _pixel_indices(pixels: ArrayLike, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    pixels = np.asarray(pixels)
    if pixels.ndim != 2 or pixels.shape[1] != 2 or pixels.dtype.kind not in "iu":
        raise UsageError(
            "pixels",
            f"{pixels.dtype} array of shape {pixels.shape}",
            "integers [n, 2] (row, column)",
        )
    rows, columns = pixels[:, 0], pixels[:, 1]
    outside = (rows < 0) | (rows >= height) | (columns < 0) | (columns >= width)
    if outside.any():
        row, column = pixels[np.argmax(outside)]
        raise UsageError(
            "pixels", f"got ({row}, {column})", f"rows below {height} and columns below {width}"
        )
    return rows, columns
