"""The ground truth that the pictures of a scene are compared with.

Emission and absorption have an exact integral (clvol.integrators.reference.picture). Effects have none that
shares no code with the ray caster; the truth of scenes with effects is the limit that the ray caster
itself tends to as its steps become small, and how well that limit is known is reported with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.device.view import EVERY_PIXEL
from clvol.errors import VolumeError
from clvol.integrators.base import FrameData
from clvol.integrators.reference.integrator import has_exact_integral
from clvol.integrators.reference.picture import render_reference
from clvol.scene.resolve import LARGEST_STEP_COUNT, ResolvedScene

if TYPE_CHECKING:
    from clvol.opencl.context import DeviceContext
    from clvol.render.prepared_cache import PreparedCache

FIRST_STEP, LEAST_STEP = 1 / 8, 1 / 128  # smallest voxel edges
KNOWN = 2e-5  # RMSE: the limit is then known as well as single precision and tables allow


def check_has_truth(resolved: ResolvedScene) -> None:
    """VolumeError for a store that does not fit into memory.

    Errors are measured against all voxels at full resolution. The finest picture that a budget allows
    could stand for the truth, but its own error is unknown: no error could be claimed.
    """
    try:
        _ = resolved.volume.data
    except VolumeError as error:
        what = f"{error.what} in memory: errors are measured against all its voxels"
        raise VolumeError(error.where, what, error.expected) from None


class GroundTruth:
    """Exact pixels of ``resolved``, whatever its settings of accuracy are.

    ``is_exact``: they come from the exact integral; else they are the limit of small steps. ``error``: how far that
    limit may be from the truth, an RMSE of linear premultiplied RGBA: the change that the last halving of
    the step made. It is known once pixels were requested, and 0 for the exact integral.
    """

    def __init__(self, resolved: ResolvedScene, context: DeviceContext, engines: PreparedCache) -> None:
        self.resolved, self._context, self._engines = resolved, context, engines
        self.is_exact = has_exact_integral(resolved)
        self.error = 0.0
        self._limit: np.ndarray | None = None
        self._counters: dict[str, Any] = {}

    @property
    def how(self) -> str:
        """Its name, for reports that claim an error."""
        return "exact integral" if self.is_exact else "limit of small steps"

    def pixels(
        self,
        pixels: np.ndarray,
        tolerance: float,
        progress: Callable[[int, int], None] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """float64 [n, 4] at ``pixels`` int [n, 2] (row, column), and counters as the reference has.
        ``tolerance`` is the exact integral's."""
        if self.is_exact:
            rgba, _, counters = render_reference(
                self.resolved, self._context.device, tolerance, pixels, progress
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
        self._counters = {"samples": samples, "error_estimate": self.error, "step": step}
        return pictures[-1]

    def _may_take(self, step: float) -> bool:
        corners = self.resolved.volume.grid.world_corners()
        diagonal = np.linalg.norm(np.ptp(corners, axis=0)) / self.resolved.volume.grid.smallest_edge
        return bool(diagonal / step < LARGEST_STEP_COUNT)

    def _picture(self, step: float, progress: Callable[[int, int], None] | None) -> FrameData:
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
            image=scene.image.model_copy(update={"ray_spacing": 1}),
            gradient=scene.gradient.model_copy(update={"storage": "on-the-fly"}),
        )
        size = scene.image.width, scene.image.height
        engine = self._engines.prepare(fine)
        engine.warm_up(*size, False)
        return engine.render(scene.camera, *size, progress, depth=False, lattice=EVERY_PIXEL)
