"""Measures error against time: renders one scene with many settings, and finds those that are worth using.

Settings are values of the tunables (clvol/accuracy/tunables.py). First each tunable is varied alone, from the scene's
own settings. Then the tunables of every other method are varied, and the main ladders (the step) with every
combination of alternatives (classification, quadrature, filter, ...). Finally the neighbours of the points on the
Pareto front are tried until it no longer changes. Errors are measured over all pixels against the exact integral.
Times are medians over frames, for which all candidates take turns.
"""

from __future__ import annotations

import itertools
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

import clvol
from clvol.accuracy.ground_truth import GroundTruth, check_has_truth, devices_of
from clvol.accuracy.metrics import compare, max_abs
from clvol.accuracy.search import pareto_front
from clvol.accuracy.settings import (
    apply,
    canonical,
    changed,
    is_possible,
    key_of,
    label,
    neighbours,
    scene_settings,
    scene_tunables,
)
from clvol.accuracy.timing import take_turns
from clvol.accuracy.trials import Trial, Trials
from clvol.accuracy.tunables import Tunable
from clvol.errors import UsageError
from clvol.integrators.registry import check_scene, integrator_of
from clvol.render.engines import close_engines, open_engines
from clvol.render.notices import Notices
from clvol.render.renderer import check_memory
from clvol.scene.scene import Scene

SETTINGS = 160  # largest number of settings to try
FRAMES = 7
_SLOWEST = 40.0  # times the scene's own frame; settings that take longer are not refined further
_PATIENCE = 2.0  # seconds per frame that are always acceptable
_STRIDE = 4  # notches of the main ladder between two settings of a combination
_BEATEN = 0.7  # ratio of both error and time below which the difference is not noise
_FLOOR = 0.9  # share of the error two notches before, above which a ladder no longer helps
_SAME_ERROR, _SAME_TIME = 0.97, 0.03  # ratio of errors and difference of times that count as equal
_METHOD = "integration.method"
_AREA_ERROR = 1e-2  # of pictures whose pixels are integrated, about
_DECADES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 1e-6)

Progress = Callable[..., None]  # (done, total, what)


def measure_tradeoff(
    scene: Scene,
    *,
    devices: Sequence[Any] | None = None,
    memory_cap: int | None = None,
    frames: int = FRAMES,
    settings: int = SETTINGS,
    progress: Progress | None = None,
    pixel_area: bool = False,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Renders ``scene`` with at most ``settings`` settings, and times the relevant ones over ``frames`` frames.

    Returns the content of tradeoff.json, and pictures, float32 [h, w, 4], by name: "reference", and the ids of the
    points of the front and of the scene's own settings. ``pixel_area``: as for ``render_to_error``. Raises what
    ``clvol.Renderer`` raises, and UsageError for numbers below 1.
    """
    for name, value, least in (("frames", frames, 1), ("settings", settings, 1)):
        if value < least:
            raise UsageError(name, f"got {value}", f"at least {least}")
    sweep = _Sweep(scene, devices, memory_cap, progress, pixel_area)
    try:
        sweep.explore(settings)
        result, pictures = sweep.result(frames)
        resolved = sweep.resolved
        sweep.notices.of_picture(resolved, resolved.camera, pictures["reference"], None)
        return result, pictures
    finally:
        close_engines(sweep.engines, sweep.notices)


class _Sweep:
    """The state of one sweep: device, tunables and all trials so far."""

    def __init__(
        self, scene: Scene, devices: Sequence[Any] | None, memory_cap: int | None, progress: Progress | None,
        pixel_area: bool,
    ) -> None:  # fmt: skip
        resolved = scene.resolve()
        pixel_area = pixel_area or resolved.image.samples > 1
        resolved = apply(resolved, {_METHOD: integrator_of(resolved).tuned_as})
        check_scene(resolved)
        check_memory(resolved, memory_cap)
        check_has_truth(resolved)
        self.resolved, self.progress, self.memory_cap = resolved, progress, memory_cap
        self.engines, self.notices = open_engines(devices), Notices(resolved)
        self.tunables = scene_tunables(resolved, pixel_area)
        self.base = canonical(resolved, self.tunables, scene_settings(resolved, self.tunables))
        self.truth = GroundTruth(resolved, self.engines, _AREA_ERROR if pixel_area else 0.0)
        tolerance = resolved.integration.tolerance
        self.trials = Trials(resolved, self.engines, tolerance=tolerance, frames=2, truth=self.truth)
        self.found: dict[tuple, Trial] = {}
        self.sweeps: dict[tuple, list[str]] = {}  # the tunables on whose own curves each setting lies

    # Exploring

    def explore(self, most: int) -> None:
        """Tries at most ``most`` settings."""
        self.most = most
        self.trials.exact(self.report_as("integrating exactly"))
        baseline = self.run(self.base)
        self.limit = max(_SLOWEST * baseline.seconds, _PATIENCE)
        for key, tunable in self.tunables.items():
            for settings in self.ladder(self.base, key, 1):
                self.sweeps.setdefault(key_of(settings), []).append(key)
        for settings in self.by_other_methods():
            scene = apply(self.resolved, settings)
            for key, tunable in self.tunables.items():
                if tunable.tunable.counts(scene) and not tunable.tunable.counts(self.resolved):
                    self.ladder(settings, key, 1)
        tunables = self.tunables.values()
        alternatives = [k for k in tunables if not k.tunable.is_ladder and not k.tunable.alone]
        for values in itertools.product(*(k.values for k in alternatives)):
            settings = {**self.base, **{k.key: v for k, v in zip(alternatives, values)}}
            for main in (k for k in self.tunables.values() if k.tunable.is_main):
                self.ladder(settings, main.key, _STRIDE)
        expanded: set[tuple] = set()
        while len(self.found) < self.most:
            waiting = [t for t in self.front() if key_of(t.settings) not in expanded]
            if not waiting:
                break
            for trial in waiting:
                expanded.add(key_of(trial.settings))
                for settings in neighbours(self.tunables, trial.settings):
                    self.try_out(settings)

    def by_other_methods(self) -> Iterator[dict[str, Any]]:
        """The scene's own settings with each other method, because some tunables belong to one method only."""
        tunable = self.tunables.get(_METHOD)
        if tunable is None:
            return
        for value in tunable.values:
            settings = {**self.base, _METHOD: value}
            if value != tunable.scene_value and self.is_possible(settings):
                yield settings

    def is_possible(self, settings: dict[str, Any]) -> bool:
        return is_possible(self.resolved, settings, self.memory_cap)

    def ladder(self, settings: dict[str, Any], key: str, stride: int) -> list[dict[str, Any]]:
        """Tries the values of one tunable from the scene's own outwards, while that is useful; returns the settings."""
        tunable = self.tunables[key]
        tried = []
        own = tunable.values.index(tunable.scene_value)
        outwards = [range(own, len(tunable.values), stride), range(own - stride, -1, -stride)]
        for indices in outwards:
            errors: list[float] = []
            for index in indices:
                trial = self.try_out({**settings, key: tunable.values[index]})
                if trial is not None:
                    tried.append(trial.settings)
                    errors.append(trial.rmse)
                if trial is None and tunable.tunable.is_ladder:
                    break
                if self.leads_nowhere(trial, errors, tunable.tunable):
                    break
        return tried

    def leads_nowhere(self, trial: Trial | None, errors: list[float], tunable: Tunable) -> bool:
        """Whether the next values of a ladder can be skipped, because they take too long, or because another trial is
        far better and the last notches hardly changed the error."""
        if trial is None or not tunable.is_ladder:
            return False
        if trial.seconds > self.limit:
            return True
        if tunable.saves_memory:
            return False
        beaten = any(
            t.seconds < _BEATEN * trial.seconds and t.rmse < _BEATEN * trial.rmse
            for t in self.found.values()
        )
        return beaten and len(errors) > 2 and errors[-1] > _FLOOR * errors[-3]

    def try_out(self, settings: dict[str, Any]) -> Trial | None:
        """The trial of ``settings``; None if they cannot be rendered or enough settings have been tried."""
        if not self.is_possible(settings):
            return None
        settings = canonical(self.resolved, self.tunables, settings)
        if key_of(settings) not in self.found and len(self.found) >= self.most:
            return None
        return self.run(settings)

    def run(self, settings: dict[str, Any]) -> Trial:
        """The trial of ``settings`` (canonical, possible), rendered unless it is known."""
        key = key_of(settings)
        if key not in self.found:
            self.report(len(self.found), self.most, "trying settings")
            self.found[key] = self.trials.run(settings)
        return self.found[key]

    def front(self) -> list[Trial]:
        return pareto_front(list(self.found.values()))

    # Timing and reporting

    def result(self, frames: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        timed = {key_of(t.settings): t for t in self.front()}
        timed |= {key: self.found[key] for key in self.sweeps if key in self.found}
        base = key_of(self.base)
        timed[base] = self.found[base]
        runs = {key: self.trials.frames_of(trial.settings) for key, trial in timed.items()}
        rounds = _Rounds(self.report_as("timing"), frames * len(runs))
        times = take_turns(
            {key: rounds.counted(run) for key, run in runs.items()}, frames
        )
        ids = {key: f"p{n}" for n, key in enumerate(timed)}
        points, pictures = {}, {"reference": self.trials.exact().astype(np.float32)}
        for key, trial in timed.items():
            points[key] = self.point(ids[key], trial, times[key])
        front = _front_of(points)
        for n, key in enumerate(dict.fromkeys([*front, base])):
            self.report(n, len(front) + 1, "comparing")
            rgba = runs[key]()[1]
            pictures[ids[key]] = rgba
            measured = compare(rgba, self.trials.exact(), self.resolved.background)
            points[key] |= {"max_abs": max_abs(rgba, self.trials.exact()), **measured}
        for key, trial in self.found.items():  # rendered, but not timed as carefully
            if key not in points:
                seconds = {"median": trial.seconds, "min": trial.seconds, "max": max(trial.times),
                           "spread": None, "frames": len(trial.times)}  # fmt: skip
                points[key] = self.point(f"p{len(points)}", trial, seconds)
        for key in front:
            points[key]["on_front"] = True
        return self.content(points, [ids[key] for key in front], ids[base], frames), pictures

    def point(self, name: str, trial: Trial, seconds: dict[str, Any]) -> dict[str, Any]:
        sweeps = self.sweeps.get(key_of(trial.settings), [])
        scene = apply(self.resolved, trial.settings)
        return {
            "id": name,
            "label": label(self.tunables, trial.settings, self.resolved),
            "settings": trial.settings,
            "changed": changed(trial.settings, self.base),
            "rmse": trial.rmse,
            "max_abs": None, "psnr": None, "ssim": None,
            "delta_e_mean": None, "delta_e_max": None,
            "seconds": seconds,
            "samples": trial.samples,
            "rays": trial.rays,
            "prepare_seconds": trial.prepare_seconds,
            "device_bytes": integrator_of(scene).device_bytes(scene.volume, scene),
            "on_front": False,
            "sweep": sweeps[0] if len(sweeps) == 1 else None,
        }  # fmt: skip

    def content(self, points: dict, front: list[str], baseline: str, frames: int) -> dict[str, Any]:
        """The content of tradeoff.json."""
        resolved, counters = self.resolved, self.trials.reference_counters
        devices = devices_of(self.engines)
        by_id = {point["id"]: point for point in points.values()}
        return {
            "version": 1,
            "scene": {
                "name": resolved.volume.name or resolved.origin,
                "width": resolved.image.width, "height": resolved.image.height,
                "source": resolved.source,
                "background": [float(c) for c in resolved.background],
            },
            "machine": {
                "devices": self.engines.names, "device_name": " and ".join(device.name.strip() for device in devices),
                "driver": " and ".join(device.driver_version for device in devices), "cores": os.cpu_count(),
                "system": platform.system(), "clvol": clvol.__version__,
            },
            "reference": {
                "how": self.truth.how,
                "step": counters.get("step"),
                "tolerance": self.trials.tolerance,
                "seconds": counters.get("seconds"),
                "error_estimate": counters.get("error_estimate"),
                "failed_rays": counters.get("failed_rays"),
            },
            "method": {
                "frames": frames, "settings": len(points),
                "clock": "seconds of a frame, everything compiled and resident",
                "errors": "RMSE of linear premultiplied RGBA over all pixels",
            },
            "knobs": [
                {
                    "name": tunable.key, "title": tunable.tunable.title, "unit": tunable.tunable.unit,
                    "values": list(tunable.values), "scene_value": tunable.scene_value,
                    "about": tunable.about,
                }
                for tunable in self.tunables.values()
            ],
            "baseline": baseline,
            "points": list(by_id.values()),
            "front": front,
            "sentences": sentences([by_id[name] for name in front]),
        }  # fmt: skip

    def report(self, done: int | None, total: int | None, what: str) -> None:
        if self.progress is not None:
            self.progress(done, total, what)

    def report_as(self, what: str) -> Callable[[int, int], None]:
        return lambda done, total: self.report(done, total, what)


class _Rounds:
    """Counts frames for the progress display."""

    def __init__(self, report: Callable[[int, int], None], total: int) -> None:
        self.report, self.total, self.done = report, total, 0

    def counted(self, run: Callable[[], tuple[float, np.ndarray]]) -> Callable[[], float]:
        """A function that renders a frame by ``run`` and returns its seconds."""

        def counting() -> float:
            self.done += 1
            self.report(min(self.done, self.total), self.total)
            return run()[0]

        return counting


def sentences(front: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Sentences such as "for error below X, use Y: Z s", for each X of a list that the ``front`` (by falling error)
    reaches. If the same settings serve several X, only the smallest X is listed."""
    found: dict[str, dict[str, Any]] = {}
    for error in _DECADES:
        held = [point for point in front if point["rmse"] <= error]
        if held:
            point, seconds = held[0], held[0]["seconds"]["median"]
            text = f"for error below {error:g}, use {point['label']}: {seconds:.3g} s"
            found[point["id"]] = {
                "error": error, "point": point["id"], "seconds": seconds, "text": text
            }  # fmt: skip
    return list(found.values())


def _front_of(points: dict[tuple, dict[str, Any]]) -> list[tuple]:
    """The keys of the points that no other beats in error and time, by rising time and falling error. Of points whose
    times cannot be distinguished, the more exact one is kept, or with equal errors the one closest to the scene."""
    front: list[tuple] = []
    for key, point in sorted(
        points.items(), key=lambda item: (item[1]["seconds"]["median"], item[1]["rmse"])
    ):
        if front:
            last = points[front[-1]]
            same_time = _same_time(last["seconds"], point["seconds"])
            if point["rmse"] > _SAME_ERROR * last["rmse"]:
                is_same = same_time and _SAME_ERROR * point["rmse"] <= last["rmse"]
                if is_same and len(point["changed"]) < len(last["changed"]):
                    front[-1] = key
                continue
            if same_time:
                front.pop()
        front.append(key)
    return front


def _same_time(a: dict[str, Any], b: dict[str, Any]) -> bool:
    """Whether two medians differ by less than the spread of the times."""
    noise = max(_SAME_TIME, 0.5 * max(a["spread"] or 0.0, b["spread"] or 0.0))
    return b["median"] - a["median"] <= noise * b["median"]
