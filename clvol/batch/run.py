"""Renders the pictures of a job, each of which may fail without the others."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from clvol.accuracy.error_target import render_to_error
from clvol.batch.claims import Claims
from clvol.batch.job import Picture
from clvol.batch.made import is_made_from
from clvol.batch.results import ResultsReader, append, digest_of
from clvol.batch.shared import unmade
from clvol.batch.write_behind import WriteBehind
from clvol.errors import ClvolError, ClvolWarning, DeviceError, SceneError, UsageError, VolumeError
from clvol.image import atomic_paths, check_output, save_picture
from clvol.integrators.base import Progress
from clvol.render import Renderer
from clvol.render.frame import Frame
from clvol.render.made_from import MadeFrom
from clvol.scene import Scene
from clvol.scene.family import SceneFamily
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume
from clvol.volume.series import VolumeSeries

STEPS = 1000  # units of progress per picture

Save = Callable[[Frame, Sequence[str]], None]


@dataclass
class Options:
    """How pictures are rendered: as for ``Renderer``. ``max_error``: settings are chosen for it. ``results``: the file
    that gets a line per picture. ``run``: a name that processes have in common which together are one run: what has
    failed in one is not tried by the others."""

    devices: list[str] | None = None
    memory_cap: int | None = None
    isolate: bool = False
    max_error: float | None = None
    results: str = "results.jsonl"
    run: str = ""


@dataclass
class _Loaded:
    """The scene of a picture, and the same with its volume."""

    picture: Picture
    scene: Scene
    resolved: ResolvedScene
    made_from: MadeFrom


@dataclass
class _Known:
    """What the lines of results say: (request, files) of pictures that were rendered, and the files of those that have
    failed in this run."""

    measured: set[tuple[str, ...]] = field(default_factory=set)
    failed: set[tuple[str, ...]] = field(default_factory=set)


@dataclass
class Outcome:
    """Counts of pictures by what became of them: "rendered", "kept" (they existed, or another process has made them)
    and "failed". ``status``: the exit status, that of the worst failure."""

    counts: dict[str, int] = field(default_factory=lambda: {"rendered": 0, "kept": 0, "failed": 0})
    status: int = 0


class JobRun:
    """One run of a job by this process. ``emit(result)`` gets the result of each picture that it renders, or that
    fails. ``progress(done, all, picture)``, in ``STEPS`` per picture. ``begin(picture)`` is called before one is
    rendered."""

    def __init__(
        self, pictures: Sequence[Picture], options: Options, emit: Callable[[dict[str, Any]], None],
        progress: Callable[[int, int, str], None] | None = None, begin: Callable[[Picture], None] | None = None,
    ) -> None:  # fmt: skip
        self._pictures, self._options, self._emit, self._progress = list(pictures), options, emit, progress
        self._begin, self._raises_device_errors = begin, False
        self._results, self._so_far = ResultsReader(options.results), _Known()
        self._family = SceneFamily()
        self._last: _Loaded | None = None
        self._checked: set[str] = set()  # folders that can be written to
        # With the volume, or the series, that its scenes have in common.
        self._renderer: tuple[Volume | VolumeSeries, Renderer] | None = None
        self.outcome = Outcome()

    def run(self) -> Outcome:
        """Returns once all pictures exist or have failed. An interrupt ends it, and leaves what is done."""
        counts = self.outcome.counts
        try:
            self._all_of(self._pictures, self._waiting)
        finally:
            self.close()
        counts["kept"] = len(self._pictures) - counts["rendered"] - counts["failed"]
        return self.outcome

    def make(self, picture: Picture) -> list[dict[str, Any]]:
        """Makes one more picture, and returns its result; none if it is there already, or if another process makes it
        meanwhile. What is loaded and prepared stays for the next one until ``close``. DeviceError if no device
        works."""
        results: list[dict[str, Any]] = []
        self._emit, self._raises_device_errors = results.append, True
        self._all_of([picture], None)
        return results

    def _all_of(self, pictures: Sequence[Picture], waiting: Callable[[int], None] | None) -> None:
        with Claims() as claims, WriteBehind() as behind:
            for picture in unmade(pictures, claims, lambda p: p.files, self._is_done, waiting, releases=False):
                self._one(picture, claims, behind)

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer[1].close()
            self._renderer = None

    def _waiting(self, count: int) -> None:
        if self._progress is not None:
            all_of_them = len(self._pictures)
            self._progress((all_of_them - count) * STEPS, all_of_them * STEPS, f"{count} of other processes")

    # ---- one picture

    def _one(self, picture: Picture, claims: Claims, behind: WriteBehind) -> None:
        if self._options.run and picture.files in self._known().failed:
            claims.release(picture.files[0])
            return
        if self._begin is not None:
            self._begin(picture)
        start, report = time.perf_counter(), None
        name = os.path.basename(picture.files[0])
        if self._progress is not None:
            report = partial(self._report, picture.number, name)
            report(0, 1)
        result = picture.as_result() | ({"run": self._options.run} if self._options.run else {})
        frame: Frame | None = None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ClvolWarning)
            try:
                frame = self._rendered(picture, report)
                if self._options.max_error is not None:
                    result["request"] = self._request(self._loaded(picture))
            except (ClvolError, MemoryError) as error:
                if self._raises_device_errors and isinstance(error, DeviceError):
                    raise
                result |= _failure(picture, error)
                if not isinstance(error, (SceneError, VolumeError, UsageError)):
                    self.close()  # a device that has failed stays out of a Renderer
        told = [str(each.message) for each in caught if issubclass(each.category, ClvolWarning)]
        if told := list(dict.fromkeys(told)):
            result["warnings"] = told
        behind.add(partial(self._finish, picture, claims, frame, result, start))
        if self._last is not None and self._last.resolved.steps is not None:
            behind.finish()  # few steps are in memory at a time

    def _finish(
        self, picture: Picture, claims: Claims, frame: Frame | None, result: dict[str, Any], start: float
    ) -> None:
        """Writes a picture, then its result, while the next one is rendered. ``frame`` None: it has failed."""
        try:
            if frame is not None:
                if not claims.owns(picture.files[0]):
                    return  # this process was stopped for so long that another one has taken over
                try:
                    self._write(frame, picture)
                    told = _told_of(frame)
                    warned = list(dict.fromkeys([*told.pop("warnings", []), *result.pop("warnings", [])]))
                    result |= {"status": "rendered", **told, "total_seconds": time.perf_counter() - start}
                    result |= {"warnings": warned} if warned else {}
                except (ClvolError, MemoryError) as error:
                    result |= _failure(picture, error)
            self.outcome.counts[result["status"]] += 1
            self.outcome.status = max(self.outcome.status, result.get("exit_status", 0))
            append(self._options.results, result)
            self._emit(result)
        finally:
            claims.release(picture.files[0])

    def _report(self, number: int, name: str, done: int, total: int) -> None:
        assert self._progress is not None
        part = STEPS * done // max(total, 1)
        self._progress(number * STEPS + part, len(self._pictures) * STEPS, name)

    def _rendered(self, picture: Picture, report: Progress | None) -> Frame:
        for path in picture.files:
            if (folder := os.path.dirname(path)) not in self._checked:
                check_output(path)
                self._checked.add(folder)
        loaded, options = self._loaded(picture), self._options
        depth = any(path.lower().endswith(".exr") for path in picture.files)
        if options.max_error is not None:
            devices, cap = options.devices, options.memory_cap
            return render_to_error(
                loaded.scene, options.max_error, devices=devices, memory_cap=cap, depth=depth, progress=report
            )
        return self._renderer_of(loaded).render(progress=report, depth=depth)

    def _renderer_of(self, loaded: _Loaded) -> Renderer:
        """The Renderer that is open, if the scene's volume is its volume."""
        options = self._options
        volume = loaded.scene.load_series(options.memory_cap) or loaded.scene.load_shown(options.memory_cap)
        if self._renderer is not None and self._renderer[0] is volume:
            self._renderer[1].set_scene(loaded.resolved)
            return self._renderer[1]
        self.close()
        renderer = Renderer(loaded.resolved, options.devices, options.memory_cap, isolate=options.isolate)
        self._renderer = volume, renderer
        return renderer

    def _loaded(self, picture: Picture) -> _Loaded:
        if self._last is not None and self._last.picture is picture:
            return self._last
        scene = self._family.load(picture.source, settings=picture.settings)
        if scene.animation.frames != 1:
            where, what = f"{picture.source}: animation.frames", f"got {scene.animation.frames}"
            raise SceneError(where, what, "1 in a job; let animation.time vary, or use 'clvol render'")
        scene.load(self._options.memory_cap)
        resolved = self._family.resolve(scene, self._options.memory_cap)
        self._last = _Loaded(picture, scene, resolved, MadeFrom(resolved))
        return self._last

    def _write(self, frame: Frame, picture: Picture) -> None:
        with atomic_paths(picture.files) as temporaries:
            for path, temporary in zip(picture.files, temporaries):
                save_picture(frame, temporary, path)

    # ---- what exists

    def _is_done(self, picture: Picture) -> bool:
        """Whether its files are what would be rendered now."""
        try:
            loaded = self._loaded(picture)
        except ClvolError:
            return False  # rendering it tells why
        measured, expected = self._options.max_error is not None, loaded.made_from()
        if measured and (self._request(loaded), *picture.files) not in self._known().measured:
            return False
        return all(is_made_from(path, loaded.resolved, expected, measured) for path in picture.files)

    def _request(self, loaded: _Loaded) -> str:
        return digest_of([loaded.made_from(), loaded.resolved.source, self._options.max_error])

    def _known(self) -> _Known:
        for result in self._results.new():
            files, status = tuple(map(str, result["files"])), result.get("status")
            if status == "rendered":
                self._so_far.measured.add((str(result.get("request")), *files))
            elif status == "failed" and result.get("run") == self._options.run:
                self._so_far.failed.add(files)
        return self._so_far


def _failure(picture: Picture, error: ClvolError | MemoryError) -> dict[str, Any]:
    """What the result of a picture that has failed says of it."""
    if isinstance(error, MemoryError):
        error = SceneError(picture.source, "no memory for it", "a smaller volume, or a machine with more memory")
    return {"status": "failed", "message": str(error), "exit_status": error.exit_status}


def _told_of(frame: Frame) -> dict[str, Any]:
    stats: dict[str, Any] = dict(frame.stats)
    names = "seconds", "samples", "rays", "method", "device", "warnings"
    told = {name: stats[name] for name in names if name in stats}
    if "accuracy" in stats:
        told["error"] = {name: stats["accuracy"].get(name) for name in ("rmse", "bound", "confidence", "settings")}
    return told
