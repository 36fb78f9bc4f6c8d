"""Renders to an error: with the cheapest settings whose measured error is at most the requested one.

If the measured bound of a picture is too large, the search is repeated with a lower target.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from clvol.accuracy.ground_truth import devices_of
from clvol.accuracy.picture_search import AIM, FLOAT32_ERROR, PictureSearch, Progress
from clvol.accuracy.trials import root_mean_square
from clvol.errors import RenderError, UsageError
from clvol.integrators.reference.picture import render_reference
from clvol.render.frame import Frame, make_frame
from clvol.scene.scene import Scene

LEAST_ERROR = 1e-10  # the smallest error that the exact integral in double precision reaches
_ATTEMPTS = 6


def render_to_error(
    scene: Scene,
    max_error: float,
    *,
    devices: Sequence[Any] | None = None,
    memory_cap: int | None = None,
    depth: bool = True,
    progress: Progress | None = None,
    seed: int = 0,
    pixel_area: bool = False,
) -> Frame:
    """Renders ``scene`` with the cheapest settings whose error is at most ``max_error``.

    ``max_error``: RMSE of linear premultiplied RGBA against the exact integral, 1e-10 to 1. All tunables of the scene
    (step, classification, ...) may change. ``frame.stats["accuracy"]`` contains "rmse", "bound" and "confidence" as
    measured, the chosen "settings", and the "seconds" of each stage. ``seed``: seeds the random choice of the pixels
    that are measured. ``pixel_area``: the truth of a pixel is the integral over it, not along the ray through its
    middle, and the number of rays per pixel may change, too; so it is for scenes with ``image.samples`` above 1. Other
    arguments are those of ``clvol.Renderer``.

    Raises UsageError for an impossible ``max_error``, RenderError if no picture was shown to stay below it, and
    otherwise what ``clvol.Renderer`` raises.
    """
    check_max_error(max_error)
    with PictureSearch(scene, devices, memory_cap, max_error, depth, progress, seed, pixel_area) as search:
        return _to_error(search, max_error)


def check_max_error(value: float) -> None:
    """Raises UsageError for an error outside of 1e-10 to 1."""
    if not LEAST_ERROR <= value <= 1.0:
        raise UsageError("max_error", f"got {value!r}", f"a number from {LEAST_ERROR:g} to 1")


def _to_error(search: PictureSearch, max_error: float) -> Frame:
    if max_error < FLOAT32_ERROR:
        return _exact(search, max_error, 0)
    aim = max_error * AIM
    for attempt in range(1, _ATTEMPTS + 1):
        picture = search.cheapest_picture(aim)
        if picture is None:
            return _exact(search, max_error, attempt)
        found = search.measured(picture, attempt, max_error)
        if found.bound <= max_error:
            return search.frame(picture, found, {"max_error": max_error}, attempt)
        aim *= min(AIM, 0.98 * max_error / found.bound)
    what = f"the error could not be brought below {max_error:g} in {_ATTEMPTS} attempts"
    raise RenderError("max_error", what, f"at least {found.bound:.3g}")


def _exact(search: PictureSearch, max_error: float, attempt: int) -> Frame:
    """Renders by the exact integral itself, for an error that no settings reach."""
    if search.area:
        what = f"no settings with an error of at most {max_error:g} were found, with 16 rays per pixel at most"
        raise RenderError("max_error", what, "a larger error, or one of rays through the pixels' middles")
    if not search.truth.is_exact:
        known = max(search.truth.error, FLOAT32_ERROR)
        what = f"no settings with an error of at most {max_error:g} were found, and effects have no exact integral"
        raise RenderError("max_error", what, f"a number well above {known:.2g}")
    search.report("integrating exactly")
    tolerance = max_error / 10.0
    start, progress = time.perf_counter(), search.progress
    rgba, depth, counters = render_reference(
        search.resolved, devices_of(search.engines), tolerance,
        progress=None if progress is None else lambda done, total: progress(done, total, "exactly"),
    )  # fmt: skip
    render_seconds = time.perf_counter() - start
    worst = float(counters["error_estimate"])
    bound = max(worst, _float32_error(rgba))
    if bound > max_error:
        what = f"the exact integral missed its tolerance ({worst:.3g} in the worst ray)"
        raise RenderError("max_error", what, f"at least {bound:.3g}")
    settings = {"integration.method": "reference", "integration.tolerance": tolerance}
    if search.resolved.compression.codec != "none":  # the original voxels were integrated
        settings["compression.codec"] = "none"
    resolved = search.resolved_as(settings)
    accuracy = {
        "max_error": max_error, "rmse": bound, "bound": bound, "confidence": 1.0,
        "pixels": rgba.shape[0] * rgba.shape[1], "of_pixels": rgba.shape[0] * rgba.shape[1],
        "how": "error estimates of the exact integral", "settings": settings,
        "attempts": attempt, "tried": len(search.search.measured),
        "seconds": dict(search.seconds), "of": search.of,
    }  # fmt: skip
    seconds = {"load": search.load_seconds, "render": render_seconds}
    shown_depth = depth if search.depth else None
    counted = {**counters, "accuracy": accuracy, **search.warnings(rgba, shown_depth)}
    return make_frame(resolved, rgba, shown_depth, seconds, counted, search.engines.names)


def _float32_error(rgba: np.ndarray) -> float:
    """The RMSE that rounding the picture to float32 causes."""
    return root_mean_square(rgba.astype(np.float32) - rgba)
