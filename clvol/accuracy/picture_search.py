"""Searches for the cheapest picture whose error is at most a given one: first with a pilot, then with whole pictures.

Settings are chosen on the pilot, a sparse lattice of the picture's pixels that is rendered with many settings and
compared with the exact integral. Then whole pictures are rendered, and their error is measured at pixels that did not
influence the choice (clvol/accuracy/measurement.py). The reported error is that measurement, not the estimate from
the pilot.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from clvol.accuracy.combinations import Combinations
from clvol.accuracy.estimate import ErrorEstimate
from clvol.accuracy.ground_truth import GroundTruth, check_has_truth
from clvol.accuracy.measurement import Measurement, where_measured
from clvol.accuracy.search import Search
from clvol.accuracy.settings import (
    Settings,
    apply,
    canonical,
    is_possible,
    key_of,
    scene_settings,
    scene_tunables,
    tables_with,
)
from clvol.accuracy.trials import Trial, Trials, root_mean_square
from clvol.device.view import PixelLattice
from clvol.errors import SceneError
from clvol.integrators.registry import check_scene, integrator_of
from clvol.render.engines import close_engines, open_engines
from clvol.render.frame import Frame, make_frame
from clvol.render.notices import Notices
from clvol.render.renderer import check_memory
from clvol.scene.resolve import ResolvedScene
from clvol.scene.scene import Scene

AIM = 0.95  # target as a share of the requested error or time, since the bound lies a little above the error
FLOAT32_ERROR = 1e-6  # sums in float32 are not more exact than this
_PILOT_PIXELS = 10_000
_PICTURES_KEPT, _BYTES_KEPT = (3, 24), 2**29  # least and most pictures; in between, as many as these bytes allow
_SHARES = (1.0, 0.7, 0.4)  # shares of the error for the tunables whose effect single pixels show
_SHARE_OF_ERROR = 1e-3  # tolerance of the exact integral, as a share of the requested error

Progress = Callable[..., None]  # (done, total, what)
T = TypeVar("T")


class PictureSearch:
    """The state of one search: device, pilot and tunables. Use it as a context manager.

    ``error``: the RMSE for which settings are searched first. ``seconds``: the time of each stage so far. Other
    arguments and exceptions are those of ``clvol.accuracy.error_target.render_to_error``.
    """

    def __init__(
        self,
        scene: Scene,
        devices: Sequence[Any] | None,
        memory_cap: int | None,
        error: float,
        depth: bool,
        progress: Progress | None,
        seed: int,
        pixel_area: bool = False,
    ) -> None:
        start = time.perf_counter()
        self.scene = scene
        requested = scene.resolve()
        self.area = pixel_area or requested.image.samples > 1
        if self.area and requested.image.pixel_filter != "box":
            what = f"got {requested.image.pixel_filter!r} where the truth is the integral over each pixel"
            raise SceneError(f"{requested.origin}: image.pixel_filter", what, "'box', which is what that compares with")
        self.requested, self._notices = requested, Notices(requested)
        self.resolved = apply(requested, {"integration.method": integrator_of(requested).tuned_as})
        check_scene(self.resolved)
        check_memory(self.resolved, memory_cap)
        check_has_truth(self.resolved)
        self.engines = open_engines(devices)
        self.depth, self.progress = depth, progress
        rng = np.random.default_rng(seed)
        self._tolerance = min(max(error * _SHARE_OF_ERROR, 1e-12), 1e-5)
        self.size = requested.image.width, requested.image.height
        self.tunables = scene_tunables(self.resolved, self.area)
        self.start = scene_settings(self.resolved, self.tunables)
        self.of_picture = {k: v for k, v in self.tunables.items() if v.tunable.of_picture}
        if self.area:  # rays are added, not left out
            self.of_picture = {k: v for k, v in self.of_picture.items() if v.tunable.of_area}
        self.pictures: dict[tuple, Trial] = {}
        self.seconds = {"pilot": 0.0, "pictures": 0.0, "measure": 0.0}
        self.load_seconds = time.perf_counter() - start
        lattice = _pilot_lattice(*self.size, rng)
        of_rays = self.truth = GroundTruth(self.resolved, self.engines)
        if self.area:
            self.truth = GroundTruth(self.resolved, self.engines, max(error, FLOAT32_ERROR))
        self.pilot = Trials(
            self.resolved, self.engines, lattice=lattice, tolerance=self._tolerance, frames=2, truth=of_rays,
            one_ray=self.area,
        )  # fmt: skip
        self._whole = Trials(self.resolved, self.engines, frames=2, depth=depth, truth=False)
        self._measurement = Measurement(
            self.pilot, self.truth, rng, self._tolerance, self._measuring, self.area
        )
        self.search = Search(
            self._measure_pilot,
            self.tunables,
            lambda settings: is_possible(self.resolved, settings, memory_cap),
            self._canonical,
        )

    def __enter__(self) -> PictureSearch:
        return self

    def __exit__(self, *exc: object) -> None:
        close_engines(self.engines, self._notices)

    @property
    def of(self) -> str:
        """What the truth of a pixel is, for ``stats["accuracy"]``."""
        return "pixel areas" if self.area else "pixel centres"

    # Choosing settings

    def _plain(self) -> dict[str, Any]:
        """The scene's settings with one ray per pixel."""
        return self._canonical({**self.start, **self._without_picture_tunables()})

    def _without_picture_tunables(self) -> dict[str, Any]:
        return {key: tunable.values[-1] for key, tunable in self.of_picture.items()}

    def _of_one_ray(self, settings: dict[str, Any]) -> dict[str, Any]:
        """``settings`` for a picture of one ray per pixel, by which methods are compared."""
        return self._canonical({**settings, "image.samples": 1}) if self.area else settings

    def _measure_pilot(self, settings: dict[str, Any]) -> Trial:
        self.report("choosing settings")
        return self.pilot.run(settings)

    def cheapest_picture(self, aim: float) -> Trial | None:
        """The cheapest whole picture found whose error is at most ``aim``; None if there is none.

        The tunables that only whole pictures show need a part of the error, so the pilot is also searched for smaller
        errors. The error that these tunables add is measured against the picture without them.
        """
        best: Trial | None = None
        candidates = self.timed("pilot", lambda: self.search.candidates(self._plain(), aim))
        if not candidates:
            return None
        # The pilot's rays are far apart and share no memory accesses, which slows some methods more than others.
        first = min(candidates, key=lambda trial: self.picture(self._of_one_ray(trial.settings)).cost)
        for share in _SHARES:
            chosen = self.timed("pilot", partial(self.search.hold, first.settings, share * aim))
            if chosen is None:
                break
            plain = self.picture(chosen.settings)
            if best is None or plain.cost < best.cost:
                best = plain
            room = math.sqrt(max(aim**2 - chosen.rmse**2, 0.0))
            method = chosen.settings.get("integration.method", self.resolved.integration.method)
            combinations = Combinations(
                {key: tunable for key, tunable in self.of_picture.items() if tunable.tunable.is_of(method)}
            )
            while (values := combinations.next()) is not None:
                tried = self.picture(self._canonical({**chosen.settings, **values}))
                holds = root_mean_square(tried.picture - plain.picture) <= room
                combinations.drop(values, cheaper=not holds)
                if holds and tried.cost < best.cost:
                    best = tried
        return best

    def _canonical(self, settings: Settings) -> dict[str, Any]:
        return canonical(self.resolved, self.tunables, settings)

    def picture(self, settings: dict[str, Any]) -> Trial:
        """The whole picture with ``settings``, rendered unless it is still kept."""
        key = key_of(settings)
        if key not in self.pictures:
            self.report("rendering")
            kept = _BYTES_KEPT // (self.size[0] * self.size[1] * 16)
            while len(self.pictures) >= min(max(kept, _PICTURES_KEPT[0]), _PICTURES_KEPT[1]):
                del self.pictures[next(iter(self.pictures))]
            self.pictures[key] = self.timed(
                "pictures", lambda: self._whole.run(settings, keep=True)
            )
        return self.pictures[key]

    # Measuring

    def measured(self, picture: Trial, attempt: int, limit: float | None) -> ErrorEstimate:
        """The error of a whole picture. The arguments are those of ``Measurement.of``."""
        return self._measurement.of(picture, lambda: self._finer(picture), attempt, limit)

    def _measuring(self, work: Callable[[], T]) -> T:
        self.report("measuring the error")
        return self.timed("measure", work)

    def _finer(self, picture: Trial) -> np.ndarray:
        """A rendering that shows roughly where the picture is wrong."""
        settings = dict(picture.settings)
        for key, tunable in self.tunables.items():
            if tunable.tunable.of_picture:
                settings[key] = tunable.values[-1]
            elif tunable.tunable.is_main:
                settings[key] = tunable.next_to(settings[key], 2) or tunable.values[-1]
        settings = self._canonical(settings)
        if settings == picture.settings:
            settings = min(self.search.measured, key=lambda trial: trial.rmse).settings
        return self.picture(settings).picture

    # Results

    def frame(
        self, trial: Trial, found: ErrorEstimate, target: dict[str, float], attempt: int
    ) -> Frame:
        """The picture of ``trial`` as a frame, with the ``target`` and the measured error in ``stats["accuracy"]``."""
        accuracy = {
            **target, **asdict(found), "how": f"{self.truth.how} at {where_measured(found)}",
            "settings": self._counting(trial.settings), "attempts": attempt,
            "tried": len(self.search.measured), "seconds": dict(self.seconds), "of": self.of,
        }  # fmt: skip
        pilot = self.search.measure({**trial.settings, **self._without_picture_tunables()})
        seconds = {
            "load": self.load_seconds, "prepare": pilot.prepare_seconds,
            "compile": pilot.compile_seconds + trial.compile_seconds, "render": trial.seconds,
        }  # fmt: skip
        counted = {"samples": trial.samples, "rays": trial.rays, "accuracy": accuracy}
        resolved = self.resolved_as(trial.settings)
        compression = self.engines.compression(resolved)
        counted |= compression | self.warnings(trial.picture, trial.depth, compression.get("compression"))
        return make_frame(resolved, trial.picture, trial.depth, seconds, counted, self.engines.names)

    def warnings(
        self, rgba: np.ndarray, depth: np.ndarray | None, compression: dict[str, Any] | None = None
    ) -> dict[str, Any]:
        """The entries that a picture's warnings add to its stats, of which ``compression`` is one."""
        return self._notices.of_picture(self.requested, self.requested.camera, rgba, depth, compression)

    def _counting(self, settings: dict[str, Any]) -> dict[str, Any]:
        """``settings`` without those that have no effect in combination with the others."""
        scene = apply(self.resolved, settings)
        return {k: value for k, value in settings.items() if self.tunables[k].tunable.counts(scene)}

    def resolved_as(self, settings: dict[str, Any]) -> ResolvedScene:
        """The scene with ``settings``, which its source text then contains, too."""
        source = self.scene.model_copy(update=tables_with(self.scene, settings)).to_toml()
        return replace(apply(self.requested, settings), source=source)

    def timed(self, stage: str, work: Callable[[], T]) -> T:
        """Calls ``work``, adds its time to ``stage`` and returns its result."""
        start = time.perf_counter()
        result = work()
        self.seconds[stage] += time.perf_counter() - start
        return result

    def report(self, what: str) -> None:
        """Reports to ``progress`` what is being done now."""
        if self.progress is not None:
            self.progress(None, None, what)


def _pilot_lattice(width: int, height: int, rng: np.random.Generator) -> PixelLattice:
    spacing = max(1, round(math.sqrt(width * height / _PILOT_PIXELS)))
    spacing = max(1, min(spacing, width, height))
    return PixelLattice(spacing, int(rng.integers(spacing)), int(rng.integers(spacing)))
