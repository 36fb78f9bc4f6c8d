"""clvol render for animations: numbered pictures that appear one by one, and videos."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

from click.exceptions import Exit

from clvol.batch.claims import Claims
from clvol.batch.shared import unmade
from clvol.batch.write_behind import WriteBehind
from clvol.cli import say_error
from clvol.cli.console import note, preparing, say_path, to_json, working
from clvol.cli.outputs import check_frames
from clvol.cli.standard_output import STANDARD, is_standard, kept_clean
from clvol.cli.verbose import log_scene
from clvol.cli.video_parts import VideoParts
from clvol.errors import UsageError, VolumeError

if TYPE_CHECKING:
    from clvol.batch.frames import Frames, Timed
    from clvol.cli.console import ShowProgress
    from clvol.render.frame import Frame
    from clvol.scene import Scene
    from clvol.scene.resolve import ResolvedScene

_SHARES = 1000  # units of progress per frame


def render_animation(
    scene: Scene,
    outputs: Sequence[str],
    stats: str | None,
    *,
    resume: bool,
    frames: slice = slice(None),
    quiet: bool,
    devices: list[str] | None,
    memory_cap: int | None,
    isolate: bool = False,
) -> None:
    """Renders ``frames`` of ``scene``, and prints the names of the files written.

    The pictures of a frame appear together when it is done, while the next one is rendered, and stay even if a later
    frame fails. Videos and stats appear at the end or not at all. ``resume``: a frame is not rendered again if all its
    pictures exist, are whole, and were made from the same scene, voxels and version (``clvol.render.made_from``);
    frames are claimed (``clvol.batch.claims``), so that several processes can share a folder. A video's frames are then
    kept as pictures until it is complete (``clvol.cli.video_parts``).

    Of a series, the step of the next frame is read while one is rendered. Where a step cannot be read, pictures of the
    other frames are rendered all the same, and the exit status at the end is that of the error.
    """
    from clvol.image import atomic_paths, open_video

    start = time.perf_counter()
    videos, stills, others = checked_outputs(scene, outputs, stats)
    kept = VideoParts(scene, videos) if resume and videos else None
    fps = scene.animation.fps
    with working("loading", quiet, scene.input_paths):
        scene.load(memory_cap)
        resolved = scene.resolve(memory_cap)
    load_seconds = time.perf_counter() - start
    log_scene(scene, memory_cap)

    from clvol.batch.frames import Frames
    from clvol.integrators.registry import integrator_of
    from clvol.render import Renderer

    if kept is not None:
        kept.begin()
    film = Frames(scene, resolved, stills + ([] if kept is None else [kept.pattern]))
    wanted = film.all[frames]
    todo = wanted
    if resume:
        with working("checking which frames exist", quiet):
            todo = [frame for frame in wanted if not film.is_there(frame)]
    written: list[str] = []
    failed: list[int] = []  # frames whose steps cannot be read
    totals = Totals()
    depth = any(path.lower().endswith(".exr") for path in stills)
    of_all = partial(made_from_all, resolved)
    size = f"{resolved.image.width} x {resolved.image.height} pixels"
    with ExitStack() as stack:
        write_standard = stack.enter_context(kept_clean(is_standard(stats)))
        temporaries = stack.enter_context(atomic_paths([*videos, *others]))
        progress = stack.enter_context(working(f"rendering {len(todo)} frames of {size}", quiet))
        parts = temporaries[: len(videos)]
        writers = [stack.enter_context(open_video(path, fps, of_all)) for path in parts]
        if todo:
            by_blocks = integrator_of(resolved).reads_blocks
            reading = preparing(progress, encodes=resolved.compression.codec != "none", by_blocks=by_blocks)
            renderer = Renderer(
                scene, devices=devices, memory_cap=memory_cap, progress=reading, isolate=isolate
            )
            if reading is not None and progress is not None:
                progress(None, None, f"rendering {len(todo)} frames of {size}")
            stack.enter_context(renderer)
        claims = stack.enter_context(Claims()) if resume and todo else None
        behind = stack.enter_context(WriteBehind())
        rendered, places_of = 0, {frame[0]: place for place, frame in enumerate(todo)}
        for timed in _shared(todo, claims, film, progress):
            index = timed[0]
            at = places_of[index]
            following = todo[at + 1] if claims is None and at + 1 < len(todo) else None
            try:
                frame = film.render(renderer, timed, _part(progress, at, len(todo)), depth, following)
            except VolumeError as error:
                if videos or resolved.steps is None:
                    raise
                failed.append(index)
                say_error(f"frame {index}: {error}")
                if claims is not None:
                    claims.release(film.names(index)[0])
                continue

            def write(frame: Frame = frame, index: int = index) -> None:
                nonlocal rendered
                if claims is not None and not claims.owns(film.names(index)[0]):
                    return  # this process was stopped for so long that another one has taken over
                begun = time.perf_counter()
                written.extend(film.write(frame, index)[: len(stills)])
                for writer in () if kept is not None else writers:
                    writer.add(frame)
                totals.add(frame.stats, time.perf_counter() - begun)
                rendered += 1
                if claims is not None:
                    claims.release(film.names(index)[0])

            behind.add(write)
            if resolved.steps is not None:
                behind.finish()  # few steps are in memory at a time
        behind.finish()
        if progress is not None:
            progress(None, None, "writing")
        write_start = time.perf_counter()
        if kept is not None:
            kept.add_to(writers, [frame[0] for frame in wanted])
        for writer in writers:
            writer.finish()
        totals.seconds["write"] = totals.seconds.get("write", 0) + time.perf_counter() - write_start
        if stats is not None:
            totals.seconds |= {"load": load_seconds, "total": time.perf_counter() - start}
            known = totals.stats() | {"frames": rendered, "frames_kept": len(wanted) - rendered - len(failed)}
            known |= {"frames_failed": failed} if failed else {}
            write_stats(known, write_standard if is_standard(stats) else temporaries[-1].write_bytes)
    if kept is not None:
        kept.remove(frame[0] for frame in wanted)
    for path in [*written, *videos, *others]:
        (note if is_standard(stats) else say_path)(path)
    if resume and not quiet:
        if there := len(wanted) - len(todo):
            note(f"{there} of {len(wanted)} frames existed already and were kept")
        if others_made := len(todo) - rendered - len(failed):
            note(f"{others_made} of {len(wanted)} frames were made by other processes")
    if failed:
        raise Exit(VolumeError.exit_status)


def write_stats(known: dict[str, Any], write: Callable[[bytes], object]) -> None:
    """Writes ``known`` as JSON by ``write``."""
    write(f"{to_json(known)}\n".encode())


def frame_range(text: str, count: int) -> slice:
    """The frames that ``--frames`` requests, of ``count``: "A:B" from A up to but without B, as in Python, either of
    which may be missing; or one number. UsageError for anything else, and for frames that do not exist."""
    expected = f"A:B with 0 <= A < B <= {count} (frame B is not rendered), or the number of one frame"
    first, colon, last = text.partition(":")
    digits = all(each == "" or (each.isascii() and each.isdecimal()) for each in (first, last))
    if not digits or not (first or colon):
        raise UsageError("--frames", f"got {text!r}", expected)
    begin = int(first or 0)
    end = int(last or count) if colon else begin + 1
    if not begin < end <= count:
        raise UsageError("--frames", f"got {text!r} for an animation of {count} frames", expected)
    return slice(begin, end)


def checked_outputs(
    scene: Scene, outputs: Sequence[str], stats: str | None
) -> tuple[list[str], list[str], list[str]]:
    """The videos, the patterns of pictures and the other files that are to be written. UsageError for those that
    cannot."""
    from clvol.image import check_video, is_video

    if STANDARD in outputs:
        what = f"one picture for {scene.animation.frames} frames"
        raise UsageError(STANDARD, what, "one frame: --set animation.frames=1")
    videos = [path for path in outputs if is_video(path)]
    stills = [path for path in outputs if not is_video(path)]
    others = [] if stats is None or is_standard(stats) else [stats]
    for path in videos:
        check_video(path, scene.animation.fps, scene.image.width, scene.image.height)
    check_frames(stills, videos, others, scene.animation.frames)
    return videos, stills, others


def _shared(
    todo: list[Timed], claims: Claims | None, film: Frames, progress: ShowProgress | None
) -> Iterator[Timed]:
    """The frames of ``todo`` that this process renders."""
    if claims is None:
        yield from todo
        return

    def waiting(count: int) -> None:
        if progress is not None:
            progress(None, None, f"waiting for {count} frames that other processes render")

    yield from unmade(todo, claims, lambda frame: film.names(frame[0]), film.is_there, waiting, releases=False)


def made_from_all(resolved: ResolvedScene) -> dict[str, Any]:
    from clvol.render.made_from import MadeFrom

    return {**MadeFrom(resolved)(), "frames": resolved.animation.frames}


class Totals:
    """Stats of all frames: the sums of times and counts, and the other entries of the last frame."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._known: dict[str, Any] = {"samples": 0, "rays": 0}

    def add(self, stats: dict[str, Any], write_seconds: float) -> None:
        summed = {name: self._known[name] + stats.get(name, 0) for name in ("samples", "rays")}
        counters = dict(self._known.get("counters", {}))
        for name, value in stats.get("counters", {}).items():
            counters[name] = counters.get(name, 0) + value
        coherence = _summed(self._known.get("coherence", {}), stats.get("coherence", {}))
        warned = [*self._known.get("warnings", []), *stats.get("warnings", [])]
        self._known = {**stats, **summed} | ({"counters": counters} if counters else {})
        self._known |= {"coherence": coherence} if coherence else {}
        if warned:
            self._known["warnings"] = list(dict.fromkeys(warned))
        for stage, seconds in {**stats.get("seconds", {}), "write": write_seconds}.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds

    def stats(self) -> dict[str, Any]:
        return {**self._known, "seconds": self.seconds}


def _summed(before: dict[str, Any], now: dict[str, Any]) -> dict[str, Any]:
    """What is said of coherence: sums of numbers, in how many frames rays started afresh ("reinitialised"), and how
    often for which "reason"."""
    found = dict(before)
    for name, value in now.items():
        if name == "reason":
            reasons = dict(found.get(name, {}))
            found[name] = reasons if value is None else {**reasons, value: reasons.get(value, 0) + 1}
        else:
            found[name] = value if isinstance(value, str) else found.get(name, 0) + value
    return found


def _part(progress: ShowProgress | None, done: int, count: int) -> Callable[[int, int], None] | None:
    """The progress of one frame, reported as a share of all ``count`` frames."""
    if progress is None:
        return None
    return lambda part, whole: progress(
        done * _SHARES + _SHARES * part // max(whole, 1), count * _SHARES
    )
