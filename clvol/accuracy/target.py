"""Rendering to an error, or to a time.

The settings are chosen on a pilot: a sparse lattice of the picture's pixels, rendered under one setting after
the other beside the exact integral there. Then the whole picture is made; and then its error is measured on
pixels that the choice did not see (clvol/accuracy/estimate.py). What is claimed is that measurement,
never the pilot's hope: if the bound fails, the pilot's aim is lowered and all is done again.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from clvol.accuracy.estimate import ErrorEstimate, draw, estimate
from clvol.accuracy.judge import Judge, check_judged
from clvol.accuracy.search import Search
from clvol.accuracy.settings import (
    SceneKnob,
    apply,
    canonical,
    is_possible,
    key_of,
    scene_knobs,
    scene_settings,
    tables_with,
)
from clvol.accuracy.trials import Trial, Trials, root_mean_square
from clvol.device.view import PixelLattice
from clvol.errors import RenderError, UsageError
from clvol.integrators.reference.picture import render_reference
from clvol.integrators.registry import check_scene, integrator_of
from clvol.opencl.context import DeviceContext
from clvol.render.frame import Frame, make_frame
from clvol.render.notices import Notices
from clvol.render.prepared_cache import PreparedCache
from clvol.render.renderer import check_memory, open_context
from clvol.scene.resolve import ResolvedScene
from clvol.scene.scene import Scene

CONFIDENCE = 0.95
LEAST_ERROR = 1e-10  # what the exact integral in double precision can still be asked for
_FLOAT32_ERROR = 1e-6  # sums of float32 are not to be trusted further
_PILOT_PIXELS = 10_000
_DRAWN_PIXELS = 2_048  # at first; then twice as many until the bound says yes or no
_ATTEMPTS = 6
_PICTURES_KEPT, _BYTES_KEPT = (3, 24), 2**29  # at least and most; in between, as memory allows
_SHORTEST = 1e-9  # seconds: no picture takes less, whatever the device
_AIM = 0.95  # share of the error that is aimed at: the bound lies a little above the error
_SHARES = (1.0, 0.7, 0.4)  # of the error, left to what shows on single pixels
_FIRST_ERROR, _LARGEST_ERROR = 1e-2, 0.5  # where a time's search begins, and gives up
_LOOKS_AT_TIME = 10
_USED = 0.7  # share of a time that is enough of it
_SHARE_OF_ERROR = 1e-3  # the exact integral's own tolerance, as a share of the error asked for

Progress = Callable[..., None]  # (done, total, what)


def render_to_error(
    scene: Scene,
    max_error: float,
    *,
    devices: Sequence[Any] | None = None,
    memory_cap: int | None = None,
    depth: bool = True,
    progress: Progress | None = None,
    seed: int = 0,
) -> Frame:
    """The picture with the cheapest settings that hold an error.

    ``max_error``: RMSE of linear premultiplied RGBA against the exact integral, 1e-10 to 1. Of the scene's
    knobs (step, classification, ...) all are free. ``frame.stats["accuracy"]`` has "rmse", "bound" and
    "confidence" as measured, the "settings" chosen, and what it took. Other arguments as for
    ``clvol.Renderer``; ``seed`` of the drawn pixels.

    Raises UsageError for an impossible ``max_error`` and RenderError if it could not be shown to hold.
    """
    check_max_error(max_error)
    with _Workshop(scene, devices, memory_cap, max_error, depth, progress, seed) as workshop:
        return workshop.to_error(max_error)


def render_in_time(
    scene: Scene,
    seconds: float,
    *,
    devices: Sequence[Any] | None = None,
    memory_cap: int | None = None,
    depth: bool = True,
    progress: Progress | None = None,
    seed: int = 0,
) -> Frame:
    """The most accurate picture whose frame takes at most ``seconds`` (``stats["seconds"]["render"]``:
    compiled and resident; the choice and the measurement come on top).

    Its error is measured and told as by ``render_to_error``. Raises UsageError if even the quickest
    settings take longer.
    """
    check_time_budget(seconds)
    with _Workshop(scene, devices, memory_cap, _FIRST_ERROR, depth, progress, seed) as workshop:
        return workshop.in_time(seconds)


def check_max_error(value: float) -> None:
    """UsageError for an error that cannot be aimed at."""
    if not LEAST_ERROR <= value <= 1.0:
        raise UsageError("max_error", f"got {value!r}", f"a number from {LEAST_ERROR:g} to 1")


def check_time_budget(value: float) -> None:
    """UsageError for a time that cannot be aimed at."""
    if not 0.0 < value < math.inf:
        raise UsageError("time_budget", f"got {value!r}", "seconds, more than 0")
    if value < _SHORTEST:
        raise UsageError("time_budget", f"got {value!r}", f"seconds, at least {_SHORTEST:g}")


class _Workshop:
    """Device, pilot and knobs of one call."""

    def __init__(
        self, scene, devices, memory_cap, error: float, depth: bool, progress, seed: int
    ) -> None:
        start = time.perf_counter()
        self.scene = scene
        asked = scene.resolve()
        self.asked = asked
        self.resolved = apply(asked, {"integration.method": integrator_of(asked).tuned_as})
        check_scene(self.resolved)
        check_memory(self.resolved, memory_cap)
        check_judged(self.resolved)
        self.context: DeviceContext = open_context(devices)
        self.engines = PreparedCache(self.context)
        self.depth, self.progress = depth, progress
        self.rng = np.random.default_rng(seed)
        self.error = error
        self.size = asked.image.width, asked.image.height
        self.knobs = scene_knobs(self.resolved)
        self.start = scene_settings(self.resolved, self.knobs)
        self.of_picture = {k: v for k, v in self.knobs.items() if v.knob.of_picture}
        self.pictures: dict[tuple, Trial] = {}
        self.seconds = {"pilot": 0.0, "pictures": 0.0, "measure": 0.0}
        self.load_seconds = time.perf_counter() - start
        lattice = _pilot_lattice(*self.size, self.rng)
        self.judge = Judge(self.resolved, self.context, self.engines)
        self.pilot = Trials(
            self.resolved, self.context, self.engines, lattice=lattice, tolerance=self.tolerance,
            frames=2, judge=self.judge,
        )  # fmt: skip
        self.whole = Trials(
            self.resolved, self.context, self.engines, frames=2, depth=depth,
            judge=False,
        )  # fmt: skip
        self.search = Search(
            self._measure_pilot,
            self.knobs,
            lambda settings: is_possible(self.resolved, settings, memory_cap),
            self._canonical,
        )

    def __enter__(self) -> _Workshop:
        return self

    def __exit__(self, *exc: object) -> None:
        self.engines.close()
        self.context.release()

    @property
    def tolerance(self) -> float:
        return min(max(self.error * _SHARE_OF_ERROR, 1e-12), 1e-5)

    # Choosing

    def to_error(self, max_error: float) -> Frame:
        if max_error < _FLOAT32_ERROR:
            return self._exact(max_error, 0)
        aim = max_error * _AIM
        for attempt in range(1, _ATTEMPTS + 1):
            picture = self._cheapest_picture(aim)
            if picture is None:
                return self._exact(max_error, attempt)
            found = self._measured(picture, attempt, max_error)
            if found.bound <= max_error:
                asked = {"max_error": max_error}
                return self._frame(picture, found, asked, attempt)
            aim *= min(_AIM, 0.98 * max_error / found.bound)
        what = f"the error could not be brought below {max_error:g} in {_ATTEMPTS} attempts"
        raise RenderError("max_error", what, f"at least {found.bound:.3g}")

    def in_time(self, budget: float) -> Frame:
        """The cheapest pictures for one error after the other, until the time is used."""
        best: Trial | None = None
        low, high = 0.0, _LARGEST_ERROR  # errors that take too long; that there is time for
        error = _FIRST_ERROR
        for _ in range(_LOOKS_AT_TIME):
            picture = self._cheapest_picture(error)
            seconds = math.inf if picture is None else picture.seconds
            if seconds <= budget * _AIM:
                best, high = picture, error
                if seconds >= _USED * budget or error <= _FLOAT32_ERROR:
                    break
            else:
                low = error
            # The error falls with about the square of the time.
            over = min(seconds / (_AIM * budget), 1e3)  # whose square no budget makes overflow
            guess = error * min(max(over**2, 0.03), 30.0)
            if low > 0:
                guess = max(guess, low * (high / low) ** 0.25)
            most = high * (low / high) ** 0.25 if low > 0 else high / 1.3
            error = max(min(guess, most), _FLOAT32_ERROR)
            if low > 0 and high / low < 1.2:
                break
        if best is None:
            least = min(trial.seconds for trial in self.pictures.values())
            raise UsageError("time_budget", f"got {budget:g} s", f"at least {least:.3g} s here")
        found = self._measured(best, 1, None)
        return self._frame(best, found, {"time_budget": budget}, 1)

    def _plain(self) -> dict[str, Any]:
        """The scene's settings with every pixel's own ray."""
        return self._canonical({**self.start, **self._without_picture_knobs()})

    def _without_picture_knobs(self) -> dict[str, Any]:
        return {key: knob.values[-1] for key, knob in self.of_picture.items()}

    def _measure_pilot(self, settings: dict[str, Any]) -> Trial:
        self.report("choosing settings")
        return self.pilot.run(settings)

    def _cheapest_picture(self, aim: float) -> Trial | None:
        """The cheapest whole picture found that holds ``aim``. The knobs of pictures need some of the
        error for themselves, so the pilot is asked for a part of it as well. What they add
        shows beside the picture without them."""
        best: Trial | None = None
        candidates = self.timed("pilot", lambda: self.search.candidates(self._plain(), aim))
        if not candidates:
            return None
        # Rays far apart share no memory, which costs one way of rendering more than another.
        first = min(candidates, key=lambda trial: self._whole(trial.settings).cost)
        for share in _SHARES:
            chosen = self.timed("pilot", lambda: self.search.hold(first.settings, share * aim))
            if chosen is None:
                break
            plain = self._whole(chosen.settings)
            if best is None or plain.cost < best.cost:
                best = plain
            room = math.sqrt(max(aim**2 - chosen.rmse**2, 0.0))
            method = chosen.settings.get("integration.method", self.resolved.integration.method)
            combinations = _Combinations(
                {key: knob for key, knob in self.of_picture.items() if knob.knob.is_of(method)}
            )
            while (values := combinations.next()) is not None:
                tried = self._whole(self._canonical({**chosen.settings, **values}))
                holds = root_mean_square(tried.rgba - plain.rgba) <= room
                combinations.drop(values, cheaper=not holds)
                if holds and tried.cost < best.cost:
                    best = tried
        return best

    def _canonical(self, settings: dict[str, Any]) -> dict[str, Any]:
        return canonical(self.resolved, self.knobs, settings)

    def _whole(self, settings: dict[str, Any]) -> Trial:
        key = key_of(settings)
        if key not in self.pictures:
            self.report("rendering")
            kept = _BYTES_KEPT // (self.size[0] * self.size[1] * 16)
            while len(self.pictures) >= min(max(kept, _PICTURES_KEPT[0]), _PICTURES_KEPT[1]):
                del self.pictures[next(iter(self.pictures))]
            self.pictures[key] = self.timed(
                "pictures", lambda: self.whole.run(settings, keep=True)
            )
        return self.pictures[key]

    # Measuring

    def _measured(self, picture: Trial, attempt: int, limit: float | None) -> ErrorEstimate:
        """The picture's error. Each look may err with half the chance of the one before, so that all
        together are as sure as CONFIDENCE says."""
        width, height = self.size
        count_all = width * height
        rgba = picture.rgba.reshape(count_all, 4)
        pilot = self.pilot.lattice.pixels(width, height) @ (width, 1)
        known = _squared(rgba[pilot], self.pilot.exact().reshape(-1, 4))
        left_out = np.zeros(count_all, bool)
        left_out[pilot] = True
        others = count_all - len(pilot)
        rough = np.zeros(count_all)
        if others > _DRAWN_PIXELS:
            rough = _squared(rgba, self._finer(picture).reshape(count_all, 4))
        squared = probability = np.zeros(0)
        look, count = 0, _DRAWN_PIXELS
        while True:
            look += 1
            if squared.size + count >= others:  # as well all of them
                rest = self._errors(rgba, np.flatnonzero(~left_out)) if others else []
                found = estimate([], [], count_all, 1.0, [*known, *rest])
                return replace(found, bound=found.bound + self.judge.error)
            at, p = draw(rough, count, self.rng, left_out)
            squared = np.append(squared, self._errors(rgba, at))
            probability = np.append(probability, p)
            chance = (1.0 - CONFIDENCE) / 2.0 ** (attempt + look)
            found = estimate(squared, probability, count_all, 1.0 - chance, known)
            found = replace(found, bound=found.bound + self.judge.error)
            if limit is None or found.bound <= limit or found.rmse > limit:
                return replace(found, confidence=CONFIDENCE)
            count = squared.size

    def _errors(self, rgba: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Squared errors of the pixels ``at`` [n] of ``rgba`` [height * width, 4]."""
        self.report("measuring the error")
        pixels = np.stack(np.divmod(at, self.size[0]), axis=1)
        exact, _ = self.timed("measure", lambda: self.judge.pixels(pixels, self.tolerance))
        return _squared(rgba[at], exact)

    def _finer(self, picture: Trial) -> np.ndarray:
        """A rendering that tells roughly where the picture is wrong."""
        settings = dict(picture.settings)
        for key, knob in self.knobs.items():
            if knob.knob.of_picture:
                settings[key] = knob.values[-1]
            elif knob.knob.is_main:
                settings[key] = knob.next_to(settings[key], 2) or knob.values[-1]
        settings = self._canonical(settings)
        if settings == picture.settings:
            settings = min(self.search.measured, key=lambda trial: trial.rmse).settings
        return self._whole(settings).rgba

    # Results

    def _exact(self, max_error: float, attempt: int) -> Frame:
        """No settings reach the error: the exact integral itself is the picture."""
        if not self.judge.is_exact:
            known = max(self.judge.error, _FLOAT32_ERROR)
            what = f"settings that hold {max_error:g} were not found, and effects have no exact integral"
            raise RenderError("max_error", what, f"a number well above {known:.2g}")
        self.report("integrating exactly")
        tolerance = max_error / 10.0
        start = time.perf_counter()
        rgba, depth, counters = render_reference(
            self.resolved, self.context.device, tolerance,
            progress=None if self.progress is None else lambda d, t: self.progress(d, t, "exactly"),
        )  # fmt: skip
        taken = time.perf_counter() - start
        worst = float(counters["error_estimate"])
        bound = max(worst, _float32_error(rgba))
        if bound > max_error:
            what = f"the exact integral missed its tolerance ({worst:.3g} in the worst ray)"
            raise RenderError("max_error", what, f"at least {bound:.3g}")
        settings = {"integration.method": "reference", "integration.tolerance": tolerance}
        resolved = self._resolved_as(settings)
        accuracy = {
            "max_error": max_error, "rmse": bound, "bound": bound, "confidence": 1.0,
            "pixels": rgba.shape[0] * rgba.shape[1], "of_pixels": rgba.shape[0] * rgba.shape[1],
            "how": "error estimates of the exact integral", "settings": settings,
            "attempts": attempt, "tried": len(self.search.measured),
            "seconds": dict(self.seconds),
        }  # fmt: skip
        seconds = {"load": self.load_seconds, "render": taken}
        depth = depth if self.depth else None
        counted = {**counters, "accuracy": accuracy, **self._warnings(rgba, depth)}
        return make_frame(resolved, rgba, depth, seconds, counted, self.context.name)

    def _frame(
        self, trial: Trial, found: ErrorEstimate, asked: dict[str, float], attempt: int
    ) -> Frame:
        accuracy = {
            **asked, **asdict(found), "how": f"{self.judge.how} at {where_measured(found)}",
            "settings": self._counting(trial.settings), "attempts": attempt,
            "tried": len(self.search.measured), "seconds": dict(self.seconds),
        }  # fmt: skip
        pilot = self.search.measure({**trial.settings, **self._without_picture_knobs()})
        seconds = {
            "load": self.load_seconds, "prepare": pilot.prepare_seconds,
            "compile": pilot.compile_seconds + trial.compile_seconds, "render": trial.seconds,
        }  # fmt: skip
        counted = {"samples": trial.samples, "rays": trial.rays, "accuracy": accuracy}
        counted |= self._warnings(trial.rgba, trial.depth)
        resolved = self._resolved_as(trial.settings)
        return make_frame(resolved, trial.rgba, trial.depth, seconds, counted, self.context.name)

    def _warnings(self, rgba: np.ndarray, depth: np.ndarray | None) -> dict[str, Any]:
        return Notices(self.asked).of_picture(self.asked, self.asked.camera, rgba, depth)

    def _counting(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Without what has no effect beside the others."""
        scene = apply(self.resolved, settings)
        return {k: value for k, value in settings.items() if self.knobs[k].knob.counts(scene)}

    def _resolved_as(self, settings: dict[str, Any]) -> ResolvedScene:
        """The scene with ``settings``, whose source says them too."""
        source = self.scene.model_copy(update=tables_with(self.scene, settings)).to_toml()
        return replace(apply(self.asked, settings), source=source)

    def timed(self, stage: str, work: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        result = work()
        self.seconds[stage] += time.perf_counter() - start
        return result

    def report(self, what: str) -> None:
        if self.progress is not None:
            self.progress(None, None, what)


def where_measured(found: ErrorEstimate) -> str:
    """In words, the pixels that ``found`` rests on."""
    if found.pixels >= found.of_pixels:
        return "all pixels"
    return "the pixels that settings were chosen by, and at others, drawn where errors are expected"


class _Combinations:
    """Combinations of the values of knobs, middle ones first, so that what is learnt from one leaves few
    others to be tried."""

    def __init__(self, knobs: dict[str, SceneKnob]) -> None:
        # Without its last value, which is to do without the knob.
        self._ladders = {
            key: knob.values[:-1] if knob.values[-1] == knob.scene_value else knob.values
            for key, knob in knobs.items()
        }
        places = itertools.product(*(range(len(values)) for values in self._ladders.values()))
        middle = [(len(values) - 1) / 2 for values in self._ladders.values()]
        self._left = sorted(
            (p for p in places if p), key=lambda p: sum(abs(a - m) for a, m in zip(p, middle))
        )

    def next(self) -> dict[str, Any] | None:
        if not self._left:
            return None
        place = self._left[0]
        return {key: values[k] for (key, values), k in zip(self._ladders.items(), place)}

    def drop(self, values: dict[str, Any], cheaper: bool) -> None:
        """Takes out this one, and all that are cheaper in no knob less (or else more accurate)."""
        place = [self._ladders[key].index(value) for key, value in values.items()]
        self._left = [
            p for p in self._left
            if not all(a <= b if cheaper else a >= b for a, b in zip(p, place))
        ]  # fmt: skip


def _pilot_lattice(width: int, height: int, rng: np.random.Generator) -> PixelLattice:
    spacing = max(1, round(math.sqrt(width * height / _PILOT_PIXELS)))
    spacing = max(1, min(spacing, width, height))
    return PixelLattice(spacing, int(rng.integers(spacing)), int(rng.integers(spacing)))


def _squared(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Mean over the channels of the squared difference, [...]; inf where one is not finite."""
    with np.errstate(invalid="ignore"):
        squared = np.square(np.asarray(a, np.float64) - b).mean(axis=-1)
    return np.where(np.isfinite(squared), squared, np.inf)


def _float32_error(rgba: np.ndarray) -> float:
    """What rounding the picture to 32 bits costs."""
    return root_mean_square(rgba.astype(np.float32) - rgba)
