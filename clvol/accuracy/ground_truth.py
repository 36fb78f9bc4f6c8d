"""The ground truth that the pictures of a scene are compared with.

Emission and absorption have an exact integral (clvol.integrators.reference.picture), which shares no code with the
ray caster. Effects have no such integral. The ground truth of a scene with effects is therefore the limit to which
the ray caster itself converges at small steps, and the uncertainty of that limit is reported with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.accuracy.pixel_area import integrate_pixels
from clvol.errors import VolumeError
from clvol.integrators.base import FrameData
from clvol.integrators.reference.integrator import has_exact_integral
from clvol.integrators.reference.picture import render_reference
from clvol.render.supersampling.picture import rendered
from clvol.scene.compression import NOT_COMPRESSED
from clvol.scene.resolve import LARGEST_STEP_COUNT, ResolvedScene

if TYPE_CHECKING:
    from clvol.render.engines import Engines

FIRST_STEP, LEAST_STEP = 1 / 8, 1 / 128  # in units of the smallest voxel edge
_RAYS = 16  # per pixel, of a picture whose pixels are integrated
KNOWN = 2e-5  # RMSE, at which the limit is known as well as single precision and tables allow


def check_has_truth(resolved: ResolvedScene) -> None:
    """Raises VolumeError for a store that does not fit into memory.

    Errors are measured against all voxels at full resolution. The finest picture within a memory budget has an
    unknown error, so no error could be stated against it.
    """
    try:
        _ = resolved.volume.data
    except VolumeError as error:
        what = f"{error.what} in memory: errors are measured against all its voxels"
        raise VolumeError(error.where, what, error.expected) from None


def _of_voxels(resolved: ResolvedScene) -> ResolvedScene:
    """The scene without levels: what these average is part of the error."""
    integration = resolved.integration
    if integration.minification == "off":
        return resolved
    return replace(resolved, integration=integration.model_copy(update={"minification": "off"}))


def devices_of(engines: Engines) -> list[Any]:
    """The OpenCL devices that work."""
    return [context.device for context in engines.contexts]


class GroundTruth:
    """Exact pixels of ``resolved``, regardless of its accuracy settings.

    ``is_exact``: whether they come from the exact integral; otherwise they are the limit of small steps. ``error``:
    the uncertainty of that limit, an RMSE of linear premultiplied RGBA, taken as the change by the last halving of
    the step. It is known after the first call of ``pixels``, and 0 for the exact integral.

    ``area``: if more than 0, pixels are integrated over their area, for pictures with errors of about ``area``;
    otherwise pixels are rays through their middles.
    """

    def __init__(self, resolved: ResolvedScene, engines: Engines, area: float = 0.0) -> None:
        self.resolved, self._engines, self._area = _of_voxels(resolved), engines, area
        self.is_exact = has_exact_integral(self.resolved)
        self.error = 0.0
        self._limit: np.ndarray | None = None
        self._counters: dict[str, Any] = {}

    @property
    def how(self) -> str:
        """The name of this ground truth in reports."""
        what = "exact integral" if self.is_exact else "limit of small steps"
        return f"{what} over each pixel" if self._area else what

    def pixels(
        self,
        pixels: np.ndarray,
        tolerance: float,
        progress: Callable[[int, int], None] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """RGBA at ``pixels`` (int [n, 2]: row, column), float64 [n, 4], and counters like those of the reference.
        ``tolerance``: that of the exact integral."""
        if self.is_exact and self._area:
            devices = devices_of(self._engines)
            return integrate_pixels(self.resolved, devices, tolerance, pixels, self._area, progress)
        if self.is_exact:
            rgba, _, counters = render_reference(
                self.resolved, devices_of(self._engines), tolerance, pixels, progress
            )
            return rgba, counters
        if self._limit is None:
            self._limit = self._find_limit(progress)
        rows, columns = np.asarray(pixels).T
        return self._limit[rows, columns].astype(np.float64), self._counters

    def _find_limit(self, progress: Callable[[int, int], None] | None) -> np.ndarray:
        """The picture at the smallest step that is needed; sets ``error`` and the counters."""
        step, samples = FIRST_STEP, 0
        pictures: list[np.ndarray] = []
        while True:
            data = self._picture(step, progress)
            samples += data.samples
            pictures = [*pictures[-1:], data.rgba]
            if len(pictures) == 2:
                change = pictures[1].astype(np.float64) - pictures[0]
                self.error = float(np.sqrt(np.mean(change**2)))
                if self.error <= KNOWN or step / 2 < LEAST_STEP or not self._may_take(step / 2):
                    break
            step /= 2
        if self._area:  # two pictures with as many rays, of which none is the same
            other = self._picture(step, progress, "regular")
            samples += other.samples
            mean = 0.5 * (pictures[-1].astype(np.float64) + other.rgba)
            self.error += float(np.sqrt(np.mean((other.rgba - mean) ** 2)))
            pictures.append(mean)
        self._counters = {"samples": samples, "error_estimate": self.error, "step": step}
        return pictures[-1]

    def _may_take(self, step: float) -> bool:
        corners = self.resolved.volume.grid.world_corners()
        diagonal = np.linalg.norm(np.ptp(corners, axis=0)) / self.resolved.volume.grid.smallest_edge
        return bool(diagonal / step < LARGEST_STEP_COUNT)

    def _picture(
        self, step: float, progress: Callable[[int, int], None] | None, sample_pattern: str = "rotated"
    ) -> FrameData:
        scene = self.resolved
        pre = scene.integration.classification == "pre"
        settings = {
            "step": step, "early_termination": 0.0, "quadrature": "steps",
            "classification": "pre" if pre else "post", "voxel_precision": "stored",
            "method": "raycast",
        }  # fmt: skip
        fine = replace(
            scene,
            integration=scene.integration.model_copy(update=settings),
            compression=NOT_COMPRESSED,
            image=scene.image.model_copy(
                update={
                    "ray_spacing": 1, "samples": _RAYS if self._area else 1, "refine": "all",
                    "sample_pattern": sample_pattern,
                }
            ),
            gradient=scene.gradient.model_copy(update={"storage": "on-the-fly"}),
        )
        size = scene.image.width, scene.image.height
        engine = self._engines.prepare(fine)
        engine.warm_up(*size, False)
        return rendered(engine, fine, scene.camera, *size, progress, depth=False)
