"""clvol render for one picture."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from clvol.cli.standard_output import STANDARD, check_standard, is_standard, kept_clean
from clvol.cli.verbose import log_scene
from clvol.errors import UsageError

if TYPE_CHECKING:
    from clvol.cli.console import ShowProgress
    from clvol.render.frame import Frame
    from clvol.render.frame_schedule import Schedule
    from clvol.scene import Scene

RenderElsewhere = Callable[["ShowProgress | None", bool], "Frame"]
OPTIONS = {"max_error": "--max-error", "time_budget": "--time-budget"}


def render_still(
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
    pixel_area: bool = False,
    show_schedule: str | None,
    elsewhere: RenderElsewhere | None = None,
) -> None:
    """Renders one picture and writes it to all ``outputs``. ``start``: when the command began (``perf_counter``).
    ``elsewhere(progress, depth)`` renders it in place of this process."""
    from clvol.cli.console import note, say_path, to_json, working
    from clvol.cli.outputs import check_outputs
    from clvol.image import atomic_paths, save_picture, write_frame

    check_show_schedule(show_schedule, max_error, time_budget)
    files = [path for path in outputs if not is_standard(path)]
    others = [path for path in (show_schedule, stats) if path is not None and not is_standard(path)]
    check_standard(len(outputs) - len(files), int(is_standard(stats)))
    check_outputs(files, others)
    refines = _check_settings(scene, isolate, max_error, time_budget)
    if refines and pixel_area:
        raise UsageError("--pixel-area", "given for a picture that is refined in time", "another method, or neither")
    with kept_clean(STANDARD in (*outputs, stats)) as write_standard:
        with working(f"loading {scene.origin}", quiet, scene.input_paths):
            scene.load(memory_cap)
        load_seconds = time.perf_counter() - start
        log_scene(scene, memory_cap)
        target = {"max_error": max_error, "time_budget": time_budget}
        how: dict[str, Any] = {"devices": devices, "memory_cap": memory_cap, "isolate": isolate, **target}
        depth = any(path.lower().endswith(".exr") for path in outputs)
        with working(f"rendering {scene.image.width} x {scene.image.height} pixels", quiet) as progress:
            if elsewhere is not None:
                frame, schedule = elsewhere(progress, depth), None
            else:
                frame, schedule = _frame_of(scene, progress, depth, refines, pixel_area, **how)
        if show_schedule is not None and schedule is None:
            raise UsageError("--show-schedule", "given for one device", "several: --device NAME --device NAME")
        standard = io.BytesIO()
        with working("writing", quiet), atomic_paths([*files, *others]) as temporaries:
            write_start = time.perf_counter()
            for path, temporary in zip(files, temporaries):
                save_picture(frame, temporary, path)
            if STANDARD in outputs:
                write_frame(frame, standard)
            if show_schedule is not None and schedule is not None:
                from clvol.render.schedule_picture import save_schedule

                save_schedule(schedule, (scene.image.width, scene.image.height), temporaries[len(files)])
            if stats is not None:
                end = time.perf_counter()
                seconds = dict(frame.stats.get("seconds", {}))
                seconds |= {"load": load_seconds, "write": end - write_start, "total": end - start}
                text = (to_json({**frame.stats, "seconds": seconds}) + "\n").encode()
                if is_standard(stats):
                    standard.write(text)
                else:
                    temporaries[-1].write_bytes(text)
        write_standard(standard.getvalue())
        for path in [*files, *others]:
            say_path(path)
        _compare_with_picture(scene, frame)
        if not quiet and "chosen" in frame.stats:
            note(frame.stats["chosen"]["in_words"])
        if not quiet and "accuracy" in frame.stats:
            note(accuracy_in_words(frame.stats))
        if not quiet and refines:
            note(refinement_in_words(frame.stats))


def _check_settings(scene: Scene, isolate: bool, max_error: float | None, time_budget: float | None) -> bool:
    """Whether the picture is refined within the time; UsageError for options that exclude each other."""
    from clvol.integrators.registry import integrator_of

    refines = integrator_of(scene).refines_in_time(scene) and time_budget is not None
    if isolate and (max_error is not None or (time_budget is not None and not refines)):
        option = OPTIONS["time_budget" if max_error is None else "max_error"]
        raise UsageError("--isolate", f"given together with {option}", "one of the two")
    return refines


def _frame_of(
    scene: Scene,
    progress: ShowProgress | None,
    depth: bool,
    refines: bool,
    pixel_area: bool,
    *,
    devices: list[str] | None,
    memory_cap: int | None,
    isolate: bool,
    max_error: float | None,
    time_budget: float | None,
) -> tuple[Frame, Schedule | None]:
    from clvol.cli.console import preparing
    from clvol.integrators.registry import integrator_of
    from clvol.render import Renderer

    moment = scene.moment
    camera = None if moment is None else moment.camera
    options: dict[str, Any] = {"devices": devices, "memory_cap": memory_cap}
    if max_error is not None or (time_budget is not None and not refines):
        from clvol.accuracy.error_target import render_to_error
        from clvol.accuracy.time_target import render_in_time

        if camera is not None:
            scene = scene.model_copy(update={"camera": camera})
        options |= {"depth": depth, "progress": progress, "pixel_area": pixel_area}
        with named_as_options():
            if max_error is not None:
                return render_to_error(scene, max_error, **options), None
            assert time_budget is not None
            return render_in_time(scene, time_budget, **options), None
    _build_ahead(scene, memory_cap, depth)
    encodes, by_blocks = scene.compression.codec != "none", integrator_of(scene).reads_blocks
    reading = preparing(progress, encodes=encodes, by_blocks=by_blocks)
    with Renderer(scene, progress=reading, isolate=isolate, **options) as renderer:
        if reading is not None and progress is not None:
            progress(None, None, f"rendering {scene.image.width} x {scene.image.height} pixels")
        shown: dict[str, Any] = {} if moment is None else {"camera": camera, "time": moment.time}
        frame = renderer.render(progress=progress, depth=depth, seconds=time_budget, **shown)
        return frame, renderer.schedule


def _build_ahead(scene: Scene, memory_cap: int | None, depth: bool) -> None:
    """In the first process of a machine: begins to build what the scene needs, while devices are looked for."""
    from clvol.errors import ClvolError
    from clvol.opencl.devices import build_ahead, is_looking_ahead

    if not is_looking_ahead():
        return
    from clvol.explanation import scene_programs
    from clvol.opencl.build import foreseen_program
    from clvol.opencl.context import compile_options

    try:
        programs = []
        for file, switches in scene_programs(scene.resolve(memory_cap)).items():
            known = {**switches, "WITH_DEPTH": int(depth)} if "WITH_DEPTH" in switches else switches
            programs.append(foreseen_program(file, compile_options(known)))
    except ClvolError:  # rendering meets it
        return
    build_ahead(programs)


# What a picture and its scene, rendered again, may differ in: key of made_from -> in words.
_MADE_OF = {
    "voxels": "voxels", "fields": "fields", "label_tables": "label tables", "environment": "environment",
    "clip_meshes": "meshes of clips",
    "look": "transfer function or image",
}  # fmt: skip


def _compare_with_picture(scene: Scene, frame: Frame) -> None:
    """Warns if the scene that a picture carries was rendered again from data that are not the picture's. What --set
    changes is not reported."""
    if scene.moment is None or frame.made_from is None or not scene.moment.made_from:
        return
    import warnings

    from clvol.errors import ClvolWarning

    was, made_from = scene.moment.made_from, frame.made_from()
    keys = [key for key in _MADE_OF if key != "look" and was.get(key) != made_from.get(key)]
    if was.get("scene") == made_from.get("scene") and was.get("look") != made_from.get("look"):
        keys.append("look")
    if keys:
        what = f"made of other data than the picture shows: {', '.join(_MADE_OF[key] for key in keys)}"
        warnings.warn(ClvolWarning(scene.origin, what), stacklevel=2)


def check_still(outputs: tuple[str, ...], resume: bool) -> tuple[str, ...]:
    """The file names of a single picture. Raises UsageError for options and files that only animations have."""
    from clvol.batch.names import numbered
    from clvol.image import ENDINGS, is_video

    expected = "animation.frames above 1 in the scene"
    if resume:
        raise UsageError("--resume", "given for a single picture", expected)
    for path in outputs:
        if is_standard(path):
            continue
        if is_video(path):
            known = " or ".join(ENDINGS)
            raise UsageError(path, "a video of a single picture", f"{known}, or {expected}")
    return tuple(path if is_standard(path) else numbered(path, 0) for path in outputs)


def check_show_schedule(path: str | None, max_error: float | None, time_budget: float | None) -> None:
    """Raises UsageError for a picture of the schedule that cannot be written."""
    if path is None:
        return
    if not path.lower().endswith(".png"):
        raise UsageError("--show-schedule", f"got {path!r}", "a file name that ends in .png")
    for name, value in (("--max-error", max_error), ("--time-budget", time_budget)):
        if value is not None:
            raise UsageError("--show-schedule", f"given together with {name}", "one of the two")


def check_targets(max_error: float | None, time_budget: float | None, pixel_area: bool = False) -> None:
    """Raises UsageError for an impossible target, before anything is loaded."""
    if max_error is None and time_budget is None:
        if pixel_area:
            raise UsageError("--pixel-area", "given without a target", "--max-error or --time-budget with it")
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
        where = OPTIONS.get(error.where, error.where)
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
    of = " over pixel areas" if measured.get("of") == "pixel areas" else ""
    return (
        f"RMSE {measured['rmse']:.3g}{of}, at most {measured['bound']:.3g} ({sure}); "
        f"{stats['seconds']['render']:.3g} s per frame with {chosen}"
    )
