"""clvol render: a picture of a scene or of a volume file."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from clvol.cli.options import memory_cap_option, overrides_option, scene_argument
from clvol.errors import UsageError

if TYPE_CHECKING:
    from clvol.scene import Scene

_OPTIONS = {"max_error": "--max-error", "time_budget": "--time-budget"}


@click.command("render", short_help="Render a scene, or a volume file with all defaults.")
@scene_argument
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    required=True,
    metavar="FILE",
    help="Picture to write: .exr, .png or .npy. Of an animation: a video (.gif, .webp, .apng, "
    ".mp4), or pictures with a number in their name, as in out_%04d.png. Repeatable.",
)
@overrides_option
@click.option(
    "--device",
    "devices",
    multiple=True,
    metavar="NAME",
    help="A name of 'clvol doctor'. Repeatable.",
)
@click.option(
    "--max-error",
    type=float,
    metavar="E",
    help="Choose the cheapest settings whose RMSE against the exact integral is at most E, and measure it.",
)
@click.option(
    "--time-budget",
    type=float,
    metavar="SECONDS",
    help="Choose the most accurate settings whose frame takes at most so long, and measure the error. "
    "By the method multiresolution: refine the picture for so long, and estimate the error.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Of an animation's numbered pictures, keep what is there, whole and made from the very same: "
    "scene, voxels, version.",
)
@click.option("--stats", metavar="FILE", help="Where to write times and counts as JSON.")
@memory_cap_option("The most memory that the volume may take, here and on the device.")
@click.option("--quiet", is_flag=True, help="No progress on the terminal.")
def command(
    scene: str,
    outputs: tuple[str, ...],
    overrides: tuple[str, ...],
    devices: tuple[str, ...],
    max_error: float | None,
    time_budget: float | None,
    resume: bool,
    stats: str | None,
    memory_cap: int | None,
    quiet: bool,
) -> None:
    """Render SCENE (.toml), or a volume file with all defaults, and print the files written.

    All files appear whole, or none does. With --max-error or --time-budget the settings of [integration]
    and of the rays of [image] are chosen anew; what was chosen and measured is told on stderr, in
    --stats and in the header of .exr.

    A store (clvol store) is rendered by the method multiresolution, from so much of it as
    multiresolution.memory allows. Then --time-budget keeps all settings and refines the picture, worst
    tiles first, until the time is up; the share of pixels with rays of their own and the estimated
    distance from the picture with all rays are told. --stats has, beside times and counts: "blocks",
    how many are at which level (full resolution first) or dropped since they show nothing, their bytes,
    and the selection's estimated error beside the least possible one; and "tiles", the share of pixels
    and the estimated RMSE.

    A scene with animation.frames above 1 gives a video or numbered pictures, which appear one by
    one.
    """
    check_targets(max_error, time_budget)
    from clvol.cli.outputs import scene_inputs
    from clvol.inputs import protected
    from clvol.scene import load_scene

    start = time.perf_counter()
    asked = load_scene(scene, overrides)
    with protected(scene_inputs(scene, asked)):
        if asked.animation.frames == 1:
            outputs = check_still(outputs, resume)
            aims = {"max_error": max_error, "time_budget": time_budget}
            _render_still(asked, outputs, stats, list(devices) or None, memory_cap, quiet, start, **aims)
            return
        from clvol.cli.animation import render_animation

        if max_error is not None or time_budget is not None:
            option = _OPTIONS["time_budget" if max_error is None else "max_error"]
            what = f"given for an animation of {asked.animation.frames} frames"
            raise UsageError(option, what, "one frame: --set animation.frames=1")
        how = {"devices": list(devices) or None, "memory_cap": memory_cap}
        render_animation(asked, outputs, stats, resume=resume, quiet=quiet, **how)


def _render_still(
    asked: Scene,
    outputs: tuple[str, ...],
    stats: str | None,
    devices: list[str] | None,
    memory_cap: int | None,
    quiet: bool,
    start: float,
    *,
    max_error: float | None,
    time_budget: float | None,
) -> None:
    """One picture as all of ``outputs``; ``start`` is when the command began (``perf_counter``)."""
    from clvol.cli.console import note, reading_blocks, say_path, to_json, working
    from clvol.cli.outputs import check_outputs, save_picture
    from clvol.image import atomic_paths
    from clvol.integrators.registry import integrator_of

    others = [] if stats is None else [stats]
    check_outputs(outputs, others)
    integrator = integrator_of(asked)
    by_blocks, refines = integrator.reads_blocks, integrator.refines_in_time(asked) and time_budget is not None
    with working(f"loading {asked.origin}", quiet):
        asked.load(memory_cap)
    load_seconds = time.perf_counter() - start

    from clvol.render import Renderer

    depth = any(path.lower().endswith(".exr") for path in outputs)
    size = f"{asked.image.width} x {asked.image.height} pixels"
    with working(f"rendering {size}", quiet) as progress:
        how = {"devices": devices, "memory_cap": memory_cap}
        if max_error is not None or (time_budget is not None and not refines):
            from clvol.accuracy.error_target import render_to_error
            from clvol.accuracy.time_target import render_in_time

            aim = max_error if max_error is not None else time_budget
            render = render_in_time if max_error is None else render_to_error
            with named_as_options():
                frame = render(asked, aim, depth=depth, progress=progress, **how)
        else:
            by_time = {"seconds": time_budget} if refines else {}
            with Renderer(asked, **how, **reading_blocks(by_blocks and progress)) as renderer:
                if by_blocks and progress is not None:
                    progress(None, None, f"rendering {size}")
                frame = renderer.render(progress=progress, depth=depth, **by_time)

    with working("writing", quiet), atomic_paths([*outputs, *others]) as temporaries:
        write_start = time.perf_counter()
        for path, temporary in zip(outputs, temporaries):
            save_picture(frame, temporary, path)
        if stats is not None:
            end = time.perf_counter()
            seconds = dict(frame.stats.get("seconds", {}))
            seconds |= {"load": load_seconds, "write": end - write_start, "total": end - start}
            text = to_json({**frame.stats, "seconds": seconds}) + "\n"
            temporaries[-1].write_text(text, encoding="utf-8")
    for path in [*outputs, *others]:
        say_path(path)
    if not quiet and "accuracy" in frame.stats:
        note(accuracy_in_words(frame.stats))
    if not quiet and refines:
        note(refinement_in_words(frame.stats))


def check_still(outputs: tuple[str, ...], resume: bool) -> tuple[str, ...]:
    """The names of a single picture's files; UsageError for what only an animation has."""
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


def check_targets(max_error: float | None, time_budget: float | None) -> None:
    """UsageError now, before anything is loaded, for what could not be aimed at."""
    if max_error is None and time_budget is None:
        return
    from clvol.accuracy.error_target import check_max_error
    from clvol.accuracy.time_target import check_time_budget

    if max_error is not None and time_budget is not None:
        raise UsageError("--time-budget", "given beside --max-error", "one of the two")
    with named_as_options():
        if max_error is not None:
            check_max_error(max_error)
        else:
            check_time_budget(time_budget)


@contextmanager
def named_as_options() -> Iterator[None]:
    """Errors inside name the options of the command, not the arguments of the function."""
    from clvol.errors import ClvolError

    try:
        yield
    except ClvolError as error:
        where = _OPTIONS.get(error.where, error.where)
        raise type(error)(where, error.what, error.expected) from None


def refinement_in_words(stats: dict) -> str:
    """One line: how far a picture for a given time has come."""
    tiles, taken = stats.get("tiles"), f"{stats['seconds']['render']:.3g} s"
    if tiles is None or tiles.get("estimated_rmse") is None:
        return f"nothing is to be seen; {taken} a frame"
    share, rmse = tiles["share_of_pixels"], tiles["estimated_rmse"]
    return f"{share:.0%} of pixels have rays of their own, estimated RMSE {rmse:.3g}; {taken} a frame"


def accuracy_in_words(stats: dict) -> str:
    """One line: the error as measured, and with which settings."""
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
        f"{stats['seconds']['render']:.3g} s a frame with {chosen}"
    )
