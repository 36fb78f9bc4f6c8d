"""clvol render: renders a scene or a volume file."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from clvol.cli.devices import measure_for_all
from clvol.cli.options import complete_file, memory_cap_option, overrides_option, scene_argument
from clvol.cli.verbose import log_scene
from clvol.errors import UsageError

if TYPE_CHECKING:
    from clvol.scene import Scene

_OPTIONS = {"max_error": "--max-error", "time_budget": "--time-budget"}


@click.command("render", short_help="Render a scene, or a volume file with default settings.")
@scene_argument
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    required=True,
    metavar="FILE",
    shell_complete=complete_file,
    help="Picture to write: .exr, .png or .npy. For an animation: a video (.gif, .webp, .apng, .mp4), or "
    "pictures with a number in their name, as in out_%04d.png. Repeatable.",
)
@overrides_option
@click.option(
    "--device",
    "devices",
    multiple=True,
    metavar="NAME",
    help="Device to render on, by its name in 'clvol doctor'. Repeatable: devices share each picture. 'all': one per "
    "processor. NAME:k/n: the k-th of n equal parts of a device.",
)
@click.option(
    "--isolate",
    is_flag=True,
    help="Use each device in a process of its own: a driver that crashes or hangs costs no more than what it was "
    "rendering.",
)
@click.option(
    "--max-error",
    type=float,
    metavar="E",
    help="Choose the cheapest settings whose RMSE against the exact integral is at most E, and measure the error.",
)
@click.option(
    "--time-budget",
    type=float,
    metavar="SECONDS",
    help="Choose the most accurate settings whose frame takes at most this long, and measure the error. "
    "With the method 'multiresolution': refine the picture for this long, and estimate the error.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Keep the numbered pictures of an animation that exist, are whole and were made from the same scene, "
    "voxels and version; render the others. Several processes, also of several machines, may do so in one folder: "
    "no frame is rendered twice.",
)
@click.option(
    "--frames",
    metavar="A:B",
    help="Render the frames of an animation from number A, counted from 0, up to but without B.",
)
@click.option("--stats", metavar="FILE", shell_complete=complete_file, help="Write times and counts as JSON to FILE.")
@click.option(
    "--show-schedule", metavar="FILE", shell_complete=complete_file,
    help="Write a picture (.png) of which device rendered what, and when; for several devices.",
)
@memory_cap_option("Largest amount of memory that the volume may take, on the host and on the device.")
@click.option("--quiet", is_flag=True, help="Show no progress on the terminal.")
def command(
    scene: str,
    outputs: tuple[str, ...],
    overrides: tuple[str, ...],
    devices: tuple[str, ...],
    isolate: bool,
    max_error: float | None,
    time_budget: float | None,
    resume: bool,
    frames: str | None,
    stats: str | None,
    show_schedule: str | None,
    memory_cap: int | None,
    quiet: bool,
) -> None:
    """Render SCENE (.toml), or a volume file with default settings, and print the files written.

    Output files appear whole or not at all. With --max-error or --time-budget, clvol chooses the settings of
    [integration] and the ray spacing of [image]; the chosen settings and the measured error are printed to
    standard error, and are in --stats and in the header of .exr files.

    A store (made by 'clvol store') is rendered by the method 'multiresolution', within multiresolution.memory. With
    that method, --time-budget keeps all settings and refines the picture, worst tiles first, until the time is up; it
    prints the share of pixels that have a ray, and an estimate of the difference from the picture with all rays. The
    file of --stats then also contains "blocks": the number of blocks at each level of detail (full resolution first)
    and of those that are left out because they are invisible, their bytes, the estimated error and the smallest
    possible one; and "tiles": the share of pixels that have a ray, and the estimated RMSE.

    A scene with animation.frames above 1 is rendered as a video, or as numbered pictures that appear one by one.
    """
    check_targets(max_error, time_budget)
    from clvol.cli.outputs import scene_inputs
    from clvol.inputs import protected
    from clvol.scene import load_scene

    start = time.perf_counter()
    loaded = load_scene(scene, overrides)
    measure_for_all(devices, quiet)
    with protected(scene_inputs(scene, loaded)):
        if loaded.animation.frames == 1:
            if frames is not None:
                raise UsageError("--frames", "given for a single picture", "a scene with animation.frames above 1")
            outputs = check_still(outputs, resume)
            _render_still(
                loaded, outputs, stats, list(devices) or None, memory_cap, quiet, start,
                isolate=isolate, max_error=max_error, time_budget=time_budget, show_schedule=show_schedule,
            )  # fmt: skip
            return
        from clvol.cli.animation import frame_range, render_animation

        if max_error is not None or time_budget is not None:
            option = _OPTIONS["time_budget" if max_error is None else "max_error"]
            what = f"given for an animation of {loaded.animation.frames} frames"
            raise UsageError(option, what, "one frame: --set animation.frames=1")
        if show_schedule is not None:
            what = f"given for an animation of {loaded.animation.frames} frames"
            raise UsageError("--show-schedule", what, "one frame: --set animation.frames=1")
        wanted = slice(None) if frames is None else frame_range(frames, loaded.animation.frames)
        render_animation(
            loaded, outputs, stats, resume=resume, frames=wanted, quiet=quiet, devices=list(devices) or None,
            memory_cap=memory_cap, isolate=isolate,
        )  # fmt: skip


def _render_still(
    scene: Scene,
    outputs: tuple[str, ...],
    stats: str | None,
    devices: list[str] | None,
    memory_cap: int | None,
    quiet: bool,
    start: float,
    *,
    isolate: bool,
    max_error: float | None,
    time_budget: float | None,
    show_schedule: str | None,
) -> None:
    """Renders one picture and writes it to all ``outputs``. ``start``: when the command began (``perf_counter``)."""
    from clvol.cli.console import note, preparing, say_path, to_json, working
    from clvol.cli.outputs import check_outputs, save_picture
    from clvol.image import atomic_paths
    from clvol.integrators.registry import integrator_of

    check_show_schedule(show_schedule, max_error, time_budget)
    others = [path for path in (show_schedule, stats) if path is not None]
    check_outputs(outputs, others)
    integrator = integrator_of(scene)
    by_blocks, refines = integrator.reads_blocks, integrator.refines_in_time(scene) and time_budget is not None
    if isolate and (max_error is not None or (time_budget is not None and not refines)):
        option = _OPTIONS["time_budget" if max_error is None else "max_error"]
        raise UsageError("--isolate", f"given together with {option}", "one of the two")
    with working(f"loading {scene.origin}", quiet):
        scene.load(memory_cap)
    load_seconds = time.perf_counter() - start
    log_scene(scene, memory_cap)

    from clvol.render import Renderer

    schedule = None
    depth = any(path.lower().endswith(".exr") for path in outputs)
    size = f"{scene.image.width} x {scene.image.height} pixels"
    with working(f"rendering {size}", quiet) as progress:
        if max_error is not None:
            from clvol.accuracy.error_target import render_to_error

            with named_as_options():
                frame = render_to_error(
                    scene, max_error, devices=devices, memory_cap=memory_cap, depth=depth, progress=progress
                )
        elif time_budget is not None and not refines:
            from clvol.accuracy.time_target import render_in_time

            with named_as_options():
                frame = render_in_time(
                    scene, time_budget, devices=devices, memory_cap=memory_cap, depth=depth, progress=progress
                )
        else:
            encodes = scene.compression.codec != "none"
            reading = preparing(progress, encodes=encodes, by_blocks=by_blocks)
            with Renderer(
                scene, devices=devices, memory_cap=memory_cap, progress=reading, isolate=isolate
            ) as renderer:
                if reading is not None and progress is not None:
                    progress(None, None, f"rendering {size}")
                frame = renderer.render(progress=progress, depth=depth, seconds=time_budget)
                schedule = renderer.schedule

    if show_schedule is not None and schedule is None:
        raise UsageError("--show-schedule", "given for one device", "several: --device NAME --device NAME")
    with working("writing", quiet), atomic_paths([*outputs, *others]) as temporaries:
        write_start = time.perf_counter()
        for path, temporary in zip(outputs, temporaries):
            save_picture(frame, temporary, path)
        if show_schedule is not None and schedule is not None:
            from clvol.render.schedule_picture import save_schedule

            save_schedule(schedule, (scene.image.width, scene.image.height), temporaries[len(outputs)])
        if stats is not None:
            end = time.perf_counter()
            seconds = dict(frame.stats.get("seconds", {}))
            seconds |= {"load": load_seconds, "write": end - write_start, "total": end - start}
            text = to_json({**frame.stats, "seconds": seconds}) + "\n"
            temporaries[-1].write_text(text, encoding="utf-8")
    for path in [*outputs, *others]:
        say_path(path)
    if not quiet and "chosen" in frame.stats:
        note(frame.stats["chosen"]["in_words"])
    if not quiet and "accuracy" in frame.stats:
        note(accuracy_in_words(frame.stats))
    if not quiet and refines:
        note(refinement_in_words(frame.stats))


def check_still(outputs: tuple[str, ...], resume: bool) -> tuple[str, ...]:
    """The file names of a single picture. Raises UsageError for options and files that only animations have."""
    from clvol.cli.outputs import numbered
    from clvol.image import ENDINGS, is_video

    expected = "animation.frames above 1 in the scene"
    if resume:
        raise UsageError("--resume", "given for a single picture", expected)
    for path in outputs:
        if is_video(path):
            known = " or ".join(ENDINGS)
            raise UsageError(path, "a video of a single picture", f"{known}, or {expected}")
    return tuple(numbered(path, 0) for path in outputs)


def check_show_schedule(path: str | None, max_error: float | None, time_budget: float | None) -> None:
    """Raises UsageError for a picture of the schedule that cannot be written."""
    if path is None:
        return
    if not path.lower().endswith(".png"):
        raise UsageError("--show-schedule", f"got {path!r}", "a file name that ends in .png")
    for name, value in (("--max-error", max_error), ("--time-budget", time_budget)):
        if value is not None:
            raise UsageError("--show-schedule", f"given together with {name}", "one of the two")


def check_targets(max_error: float | None, time_budget: float | None) -> None:
    """Raises UsageError for an impossible target, before anything is loaded."""
    if max_error is None and time_budget is None:
        return
    from clvol.accuracy.error_target import check_max_error
    from clvol.accuracy.time_target import check_time_budget

    if max_error is not None and time_budget is not None:
        raise UsageError("--time-budget", "given together with --max-error", "one of the two")
    with named_as_options():
        if max_error is not None:
            check_max_error(max_error)
        elif time_budget is not None:
            check_time_budget(time_budget)


@contextmanager
def named_as_options() -> Iterator[None]:
    """Makes errors raised in the block name the command's options instead of the function's arguments."""
    from clvol.errors import ClvolError

    try:
        yield
    except ClvolError as error:
        where = _OPTIONS.get(error.where, error.where)
        raise type(error)(where, error.what, error.expected) from None


def refinement_in_words(stats: dict) -> str:
    """Describes in one line how far a picture was refined within its time."""
    tiles, taken = stats.get("tiles"), f"{stats['seconds']['render']:.3g} s"
    if tiles is None or tiles.get("estimated_rmse") is None:
        return f"nothing is visible; {taken} per frame"
    share, rmse = tiles["share_of_pixels"], tiles["estimated_rmse"]
    return f"{share:.0%} of pixels have rays of their own, estimated RMSE {rmse:.3g}; {taken} per frame"


def accuracy_in_words(stats: dict) -> str:
    """Describes in one line the measured error and the chosen settings."""
    from clvol.accuracy.settings import format_setting

    measured = stats["accuracy"]
    if stats["method"] == "reference":
        sure = "the exact integral's own error estimate"
    elif measured["confidence"] < 1:
        sure = f"{measured['confidence']:.0%} sure"
    else:
        sure = "all pixels measured"
    chosen = ", ".join(
        format_setting(key.split(".")[1].replace("_", " "), value)
        for key, value in measured["settings"].items()
    )
    return (
        f"RMSE {measured['rmse']:.3g}, at most {measured['bound']:.3g} ({sure}); "
        f"{stats['seconds']['render']:.3g} s per frame with {chosen}"
    )
