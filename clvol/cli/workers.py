"""The options --workers and --scheduler, and animations that are rendered so."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from clvol.batch.names import numbered
from clvol.cli.options import complete_file
from clvol.errors import ClvolError, UsageError, error_of_status

if TYPE_CHECKING:
    from clvol.cli.console import ShowProgress
    from clvol.cli.render_still import RenderElsewhere
    from clvol.cluster.connection import Connection
    from clvol.cluster.frames import MadeFrame
    from clvol.render.frame import Frame
    from clvol.scene import Scene


def workers_options(help: str) -> Callable:
    """Adds --workers, whose ``help`` this is, and --scheduler."""

    def add(command: Callable) -> Callable:
        scheduler = click.option(
            "--scheduler", metavar="ADDRESS-OR-FILE", shell_complete=complete_file,
            help="Render on the workers of a dask cluster (extra 'distributed'), by the address of its scheduler, such "
            "as tcp://host:8786, or the file that the scheduler has written. Its workers need one thread and the "
            "resource opencl=1, clvol, and the same files.",
        )  # fmt: skip
        workers = click.option("--workers", type=click.IntRange(1, 1024), metavar="N", help=help)
        return workers(scheduler(command))

    return add


def check_workers(workers: int | None, scheduler: str | None) -> bool:
    """Whether workers are wanted; UsageError if both options are given, or the extra is missing."""
    if workers is not None and scheduler is not None:
        raise UsageError("--scheduler", "given together with --workers", "one of the two")
    if workers is None and scheduler is None:
        return False
    from clvol.cluster.connection import check_installed

    check_installed("--scheduler" if workers is None else "--workers")
    return True


def check_alone(option: str, scene: Scene, **others: object) -> None:
    """UsageError if ``option``, which is for one picture, is given for an animation or with one of the ``others``, by
    the names of their arguments."""
    if scene.animation.frames != 1:
        what = f"given for an animation of {scene.animation.frames} frames"
        raise UsageError(option, what, "one frame: --set animation.frames=1")
    for name, value in others.items():
        if value is not None:
            raise UsageError(option, f"given together with --{name.replace('_', '-')}", "one of the two")


@contextmanager
def connection(workers: int | None, scheduler: str | None, quiet: bool) -> Iterator[Connection | None]:
    """Yields the cluster that the options name; None without them."""
    if not check_workers(workers, scheduler):
        yield None
        return
    from clvol.cli.console import working
    from clvol.cluster.connection import connected

    with ExitStack() as stack:
        with working("starting workers" if scheduler is None else f"joining {scheduler}", quiet):
            found = stack.enter_context(connected(workers, scheduler))
        yield found


def render_on_workers(
    cluster: Connection,
    path: str,
    overrides: Sequence[str],
    scene: Scene,
    outputs: Sequence[str],
    stats: str | None,
    *,
    resume: bool,
    frames: slice,
    quiet: bool,
    devices: list[str] | None,
    memory_cap: int | None,
    isolate: bool,
) -> None:
    """As ``clvol.cli.animation.render_animation``, on the workers of ``cluster``: frames of ``scene``, which was loaded
    from ``path`` with ``overrides``. Workers write the numbered pictures. A frame that fails does not stop the
    others; the error of the worst is raised at the end."""
    from clvol.batch.frames import Animation
    from clvol.cli.animation import Totals, checked_outputs, made_from_all, write_stats
    from clvol.cli.console import note, say_path, working
    from clvol.cli.standard_output import is_standard, kept_clean
    from clvol.cli.video_parts import VideoParts
    from clvol.cluster.frames import MadeFrame, frames_on_workers
    from clvol.image import atomic_paths, open_video

    start = time.perf_counter()
    videos, stills, others = checked_outputs(scene, outputs, stats)
    parts = VideoParts(scene, videos) if resume and videos else None
    of_all: Callable[[], dict[str, Any]] | None = None
    if videos:  # they say which voxels they show
        with working("loading", quiet, scene.input_paths):
            scene.load(memory_cap)
            of_all = partial(made_from_all, scene.resolve(memory_cap))
    numbers = list(range(scene.animation.frames))[frames]
    patterns = list(stills)
    if parts is not None:
        parts.begin()
        patterns.append(parts.pattern)
    animation = Animation(
        path, list(overrides), patterns, shown=bool(videos) and parts is None, resume=resume, devices=devices,
        memory_cap=memory_cap, isolate=isolate,
    )  # fmt: skip
    made, totals = list[MadeFrame](), Totals()
    with ExitStack() as stack:
        write_standard = stack.enter_context(kept_clean(is_standard(stats)))
        temporaries = stack.enter_context(atomic_paths([*videos, *others]))
        progress = stack.enter_context(working(f"rendering {len(numbers)} frames", quiet))
        writers = [
            stack.enter_context(open_video(each, scene.animation.fps, of_all)) for each in temporaries[: len(videos)]
        ]
        for frame in frames_on_workers(cluster, animation, [path, *scene.input_paths], numbers):
            made.append(frame)
            if frame.error is not None:
                if animation.shown:  # no video lacks a frame
                    break
                continue
            if not frame.is_kept:
                totals.add(frame.stats, frame.write)
            for writer in writers if animation.shown else ():
                assert frame.shown is not None  # as requested
                writer.add_shown(frame.shown)
            if progress is not None:
                progress(len(made), len(numbers))
        failed = [frame for frame in made if frame.error is not None]
        if failed and (videos or others):
            raise _as_error(failed)
        if parts is not None:
            parts.add_to(writers, numbers)
        for writer in writers:
            writer.finish()
        if stats is not None:
            kept = sum(frame.is_kept for frame in made)
            totals.seconds["total"] = time.perf_counter() - start
            workers = len({frame.worker for frame in made if frame.worker})
            known = totals.stats() | {"frames": len(made) - kept, "frames_kept": kept, "workers": workers}
            write_stats(known, write_standard if is_standard(stats) else temporaries[-1].write_bytes)
    if parts is not None:
        parts.remove(numbers)
    say = note if is_standard(stats) else say_path
    written = sorted(frame.index for frame in made if not frame.is_kept and frame.error is None)
    for name in [*(numbered(each, index) for index in written for each in stills), *videos, *others]:
        say(name)
    if resume and not quiet and (kept := sum(frame.is_kept for frame in made)):
        note(f"{kept} of {len(numbers)} frames existed already and were kept")
    if failed:
        raise _as_error(failed)


def picture_elsewhere(
    cluster: Connection, path: str, overrides: Sequence[str], scene: Scene, devices: list[str] | None,
    memory_cap: int | None,
) -> RenderElsewhere:  # fmt: skip
    """What renders the picture of ``scene``, loaded from ``path`` with ``overrides``, on workers that share tiles."""

    def render(progress: ShowProgress | None, depth: bool) -> Frame:
        from clvol.cluster.tiles import tiles_on_workers
        from clvol.render.frame import make_frame

        if scene.moment is not None:
            expected = "its scene (.toml), or this process"
            raise UsageError(path, "workers do not render pictures again that carry their scene", expected)
        request = {"path": path, "overrides": list(overrides), "devices": devices, "memory_cap": memory_cap,
                   "depth": depth}  # fmt: skip
        resolved, start = scene.resolve(memory_cap), time.perf_counter()
        size = resolved.image.width, resolved.image.height
        rgba, distances, counted = tiles_on_workers(cluster, request, size, [path, *scene.input_paths], progress)
        seconds = {"render": time.perf_counter() - start}
        return make_frame(resolved, rgba, distances, seconds, counted, [cluster.name])

    return render


def _as_error(failed: Sequence[MadeFrame]) -> ClvolError:
    """The error of the worst frame, with the status that it stands for."""
    worst = max(failed, key=lambda frame: (frame.status, -frame.index))
    more = f", and {len(failed) - 1} other frames failed" if len(failed) > 1 else ""
    return error_of_status(worst.status)("--workers", f"{worst.error}{more}")
