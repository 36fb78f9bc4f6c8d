"""Trials: renders one scene with many settings, and measures the error and the time of each picture."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clvol.accuracy.ground_truth import GroundTruth
from clvol.accuracy.settings import Settings, apply
from clvol.device.view import EVERY_PIXEL, PixelLattice
from clvol.integrators.base import Prepared
from clvol.render.engines import Engines
from clvol.render.supersampling.picture import rendered
from clvol.scene.resolve import ResolvedScene

# Share of the preparation that counts as cost: it is done once for all views of a scene, but a single view should
# still finish quickly.
PREPARATION = 0.02

_log = logging.getLogger(__name__)


@dataclass(eq=False)
class Trial:
    """The result of rendering with ``settings``.

    ``seconds``: of the whole picture, the smallest of ``times``, or predicted from it if only a lattice of pixels was
    rendered. ``times``: of each frame as rendered. ``samples`` and ``rays``: of the whole picture, predicted likewise.
    ``rmse``: against the exact integral at the rendered pixels; inf if a value is not finite. ``cost``: the seconds of
    the picture and a share of those that prepare it, by which settings are compared. ``rgba`` (float32 [h, w, 4]) and
    ``depth`` ([h, w] or None): of the rendered pixels.
    """

    settings: dict[str, Any]
    rmse: float
    seconds: float
    times: list[float]
    samples: int
    rays: int
    prepare_seconds: float
    compile_seconds: float
    cost: float
    rgba: np.ndarray | None = field(default=None, repr=False)
    depth: np.ndarray | None = field(default=None, repr=False)

    @property
    def picture(self) -> np.ndarray:
        """``rgba`` of a trial that was run with ``keep``; ValueError for any other."""
        if self.rgba is None:
            raise ValueError("the picture of this trial was not kept")
        return self.rgba


class Trials:
    """Renders ``resolved`` with any settings on the pixels of ``lattice``.

    The exact integral at these pixels is computed to ``tolerance`` when it is first needed. It has the scene's own
    filter and classification (of voxels, or of interpolated values), so settings that change these are measured as
    approximations of the scene. For scenes with effects it is the limit of small steps (see GroundTruth).
    ``exact`` (float64 [h, w, 4]): that integral, if it is known already. ``truth``: the ground truth, or True to create
    it. If ``truth`` is False, errors are not measured and are reported as inf. ``one_ray``: pixels have one ray,
    whatever the settings say.
    """

    def __init__(
        self,
        resolved: ResolvedScene,
        engines: Engines,
        *,
        lattice: PixelLattice = EVERY_PIXEL,
        tolerance: float = 1e-9,
        frames: int = 3,
        depth: bool = False,
        exact: np.ndarray | None = None,
        truth: GroundTruth | bool = True,
        one_ray: bool = False,
    ) -> None:
        self._one_ray = one_ray
        self.resolved, self.engines = resolved, engines
        self.lattice, self.frames, self.depth = lattice, frames, depth
        self.size = resolved.image.width, resolved.image.height
        self.tolerance = tolerance
        self.reference_counters: dict[str, Any] = {}
        if truth is True:
            truth = GroundTruth(resolved, engines)
        self._exact, self.truth = exact, truth or None
        width, height = lattice.size(*self.size)
        self._scale = self.size[0] * self.size[1] / (width * height)
        self._overhead: float | None = None

    def exact(self, progress: Callable[[int, int], None] | None = None) -> np.ndarray:
        """The ground truth at the lattice's pixels, float64 [h, w, 4]."""
        if self._exact is None:
            if self.truth is None:
                raise ValueError("trials without ground truth have no exact pixels")
            pixels = self.lattice.pixels(*self.size)
            rgba, self.reference_counters = self.truth.pixels(pixels, self.tolerance, progress)
            width, height = self.lattice.size(*self.size)
            self._exact = rgba.reshape(height, width, 4)
        return self._exact

    def run(self, settings: Settings, keep: bool = False) -> Trial:
        """Renders with ``settings`` several times. With ``keep`` the trial holds the picture."""
        resolved = apply(self.resolved, settings)
        start, compiled = time.perf_counter(), self.engines.compile_seconds
        engine = self.engines.prepare(resolved)
        compile_seconds = self.engines.compile_seconds - compiled
        prepare_seconds = time.perf_counter() - start - compile_seconds
        start = time.perf_counter()
        engine.warm_up(*self.size, self.depth)
        compile_seconds += time.perf_counter() - start
        times = []
        for _ in range(self.frames):
            start = time.perf_counter()
            if self.lattice == EVERY_PIXEL and not self._one_ray:
                data = rendered(engine, resolved, resolved.camera, *self.size, depth=self.depth)
            else:
                data = engine.render(resolved.camera, *self.size, depth=self.depth, lattice=self.lattice)
            times.append(time.perf_counter() - start)
        seconds, scale = min(times), 1.0
        if not getattr(engine, "renders_all_pixels", False):
            seconds, scale = self._of_picture(engine, seconds), self._scale
        trial = Trial(
            settings=dict(settings),
            rmse=root_mean_square(data.rgba - self.exact()) if self.truth else np.inf,
            seconds=seconds,
            cost=seconds + PREPARATION * prepare_seconds,
            times=times,
            samples=round(data.samples * scale),
            rays=round(data.rays * scale),
            prepare_seconds=prepare_seconds,
            compile_seconds=compile_seconds,
            rgba=data.rgba if keep else None,
            depth=data.depth if keep else None,
        )
        error = f"RMSE {trial.rmse:.3g}, " if self.truth else ""
        _log.info("tried %s: %s%.3g s per frame", _changes(self.resolved, settings), error, trial.seconds)
        return trial

    def frames_of(self, settings: Settings) -> Callable[[], tuple[float, np.ndarray]]:
        """A function that renders one more frame and returns (seconds, picture). Everything is prepared in advance."""
        resolved = apply(self.resolved, settings)
        engine = self.engines.prepare(resolved)
        engine.warm_up(*self.size, self.depth)

        def frame() -> tuple[float, np.ndarray]:
            start = time.perf_counter()
            data = rendered(engine, resolved, engine.resolved.camera, *self.size, depth=self.depth)
            return time.perf_counter() - start, data.rgba

        return frame

    def _of_picture(self, engine: Prepared, seconds: float) -> float:
        """The predicted seconds of the whole picture, from those of the lattice."""
        if self._scale == 1.0:
            return seconds
        if self._overhead is None:  # the fixed cost of a launch, measured with very few pixels
            far = PixelLattice(self.lattice.spacing, self.size[0] - 1, self.size[1] - 1)
            times = []
            for _ in range(5):
                start = time.perf_counter()
                engine.render(self.resolved.camera, *self.size, depth=self.depth, lattice=far)
                times.append(time.perf_counter() - start)
            self._overhead = min(times)
        return self._overhead + self._scale * max(seconds - self._overhead, 0.1 * seconds)


def _changes(resolved: ResolvedScene, settings: Settings) -> str:
    """Describes the settings that differ from those of the scene."""
    own = {key: getattr(getattr(resolved, key.split(".")[0]), key.split(".")[1]) for key in settings}
    changed = [f"{key}={value}" for key, value in settings.items() if value != own[key]]
    return ", ".join(changed) or "the settings of the scene"


def root_mean_square(difference: np.ndarray) -> float:
    """The root mean square over all pixels and channels; inf if a value is not finite."""
    value = float(np.sqrt(np.mean(np.square(np.asarray(difference, np.float64)))))
    return value if np.isfinite(value) else np.inf
