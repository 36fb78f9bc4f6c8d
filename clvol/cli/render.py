"""clvol render: renders a scene or a volume file."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click

from clvol.cli.bricks import picture_in_bricks
from clvol.cli.devices import measure_for_all
from clvol.cli.options import complete_file, memory_cap_option, overrides_option
from clvol.cli.workers import check_alone, connection, picture_elsewhere, render_on_workers, workers_options
from clvol.errors import UsageError

if TYPE_CHECKING:
    from clvol.cluster.connection import Connection
    from clvol.scene import Scene


@click.command("render", short_help="Render scenes, or volume files with default settings.")
@click.argument("scenes", metavar="SCENE...", nargs=-1, required=True, shell_complete=complete_file)
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    required=True,
    metavar="FILE",
    shell_complete=complete_file,
    help="Picture to write: .exr, .png, .jpg, .tif (16 bits) or .npy; '-' is standard output, as PNG. For an "
    "animation: a video (.gif, .webp, .apng, .mp4), or pictures with a number in their name, as in out_%04d.png. "
    "{stem} stands for the name of the scene without its ending. Repeatable.",
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
@workers_options("Render in N processes of this machine, which share the cores (extra 'distributed').")
@click.option(
    "--bricks", type=click.IntRange(1, 4096), metavar="N",
    help="Divide the volume into N parts, which are rendered one after the other, or by workers, none of which holds "
    "the whole; for one picture of emission and absorption.",
)  # fmt: skip
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
    "--pixel-area",
    is_flag=True,
    help="With --max-error or --time-budget: errors against the integral over each pixel, not along the ray through "
    "its middle; the number of rays per pixel is chosen, too. So it is for scenes with image.samples above 1.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Keep the numbered pictures of an animation that exist, are whole and were made from the same scene, "
    "voxels and version; render the others. The frames of a video are kept as pictures in the folder VIDEO.frames "
    "until it is complete. Several processes, also of several machines, may do so in one folder: "
    "no frame is rendered twice.",
)
@click.option(
    "--frames",
    metavar="A:B",
    help="Render the frames of an animation from number A, counted from 0, up to but without B; ':' stands for all.",
)
@click.option(
    "--stats", metavar="FILE", shell_complete=complete_file,
    help="Write times and counts as JSON to FILE; '-' is standard output.",
)  # fmt: skip
@click.option(
    "--show-schedule", metavar="FILE", shell_complete=complete_file,
    help="Write a picture (.png) of which device rendered what, and when; for several devices.",
)
@memory_cap_option("Largest amount of memory that the volume may take, on the host and on the device.")
@click.option("--quiet", is_flag=True, help="Show no progress on the terminal.")
def command(
    scenes: tuple[str, ...],
    outputs: tuple[str, ...],
    overrides: tuple[str, ...],
    devices: tuple[str, ...],
    isolate: bool,
    workers: int | None,
    scheduler: str | None,
    bricks: int | None,
    max_error: float | None,
    time_budget: float | None,
    pixel_area: bool,
    resume: bool,
    frames: str | None,
    stats: str | None,
    show_schedule: str | None,
    memory_cap: int | None,
    quiet: bool,
) -> None:
    """Render each SCENE (.toml), or volume file with default settings, and print the files written. A picture (.exr,
    .png, .jpg) that clvol has rendered is a scene, too: the one that it carries is rendered again.

    With several scenes, every output has {stem} in its name, as in 'out/{stem}.png'. If one of them fails, the others
    are rendered all the same, and the exit status is the largest.

    Output files appear whole or not at all. With --max-error or --time-budget, clvol chooses the settings of
    [integration] and the ray spacing of [image]; the chosen settings and the measured error are printed to
    standard error, and are in --stats and in the header of .exr files.

    A store (made by 'clvol store') is rendered by the method 'multiresolution', within multiresolution.memory. With
    that method, --time-budget keeps all settings and refines the picture, worst tiles first, until the time is up; it
    prints the share of pixels that have a ray, and an estimate of the difference from the picture with all rays. The
    file of --stats then also contains "blocks": the number of blocks at each level of detail (full resolution first)
    and of those that are left out because they are invisible, their bytes, the estimated error and the smallest
    possible one; and "tiles": the share of pixels that have a ray, and the estimated RMSE.

    A scene with animation.frames above 1 is rendered as a video, or as numbered pictures that appear one by one. Of a
    series of volumes (volume.file is a pattern or a list, or volume.time is "all") without animation.frames, a video,
    numbered pictures and --frames show one step per frame; any other picture shows the step of animation.time, or
    volume.step. A step that cannot be read is reported, and the other frames are rendered.
    """
    from clvol.cli.render_still import check_targets
    from clvol.cli.several import check_names, each_of, filled
    from clvol.inputs import Inputs, protected

    check_targets(max_error, time_budget, pixel_area)
    check_names(scenes, [*outputs, stats, show_schedule])
    measure_for_all(devices, quiet)
    if not isolate and workers is None and scheduler is None and not {*devices} - {"pocl"}:
        from clvol.opencl.devices import look_ahead

        look_ahead()

    def render(scene: str) -> None:
        start = time.perf_counter()
        names = tuple(filled(path, scene) for path in outputs)
        more = [None if path is None else filled(path, scene) for path in (stats, show_schedule)]
        _render(
            scene, names, overrides, start, stats=more[0], show_schedule=more[1], devices=list(devices) or None,
            memory_cap=memory_cap, quiet=quiet, isolate=isolate, max_error=max_error, time_budget=time_budget,
            pixel_area=pixel_area, resume=resume, frames=frames, cluster=cluster, bricks=bricks,
        )  # fmt: skip

    with protected(Inputs(scenes)), connection(workers, scheduler, quiet) as cluster:
        each_of(scenes, render)


def _render(
    scene: str,
    outputs: tuple[str, ...],
    overrides: tuple[str, ...],
    start: float,
    *,
    stats: str | None,
    show_schedule: str | None,
    devices: list[str] | None,
    memory_cap: int | None,
    quiet: bool,
    isolate: bool,
    max_error: float | None,
    time_budget: float | None,
    pixel_area: bool,
    resume: bool,
    frames: str | None,
    cluster: Connection | None,
    bricks: int | None,
) -> None:
    """Renders one scene, a picture or an animation. ``start``: when that began (``perf_counter``)."""
    from clvol.cli.outputs import scene_inputs
    from clvol.cli.render_still import OPTIONS, check_still, render_still
    from clvol.inputs import protected
    from clvol.scene import load_scene

    loaded = load_scene(scene, overrides)
    with protected(scene_inputs(scene, loaded)):
        if bricks is not None:
            check_alone(
                "--bricks", loaded, max_error=max_error, time_budget=time_budget, frames=frames,
                show_schedule=show_schedule, pixel_area=pixel_area or None, isolate=isolate or None,
            )  # fmt: skip
            outputs = check_still(outputs, resume)
            render_still(
                loaded, outputs, stats, devices, memory_cap, quiet, start, isolate=False, max_error=None,
                time_budget=None, show_schedule=None,
                elsewhere=picture_in_bricks(cluster, scene, overrides, loaded, bricks, devices, memory_cap),
            )  # fmt: skip
            return
        steps = _frames_by_step(loaded, outputs, frames, memory_cap)
        if steps is not None:
            overrides = (*overrides, f"animation.frames={steps}")
            loaded = load_scene(scene, overrides)
        if loaded.animation.frames == 1 and steps is None:
            if frames is not None:
                raise UsageError("--frames", "given for a single picture", "a scene with animation.frames above 1")
            outputs = check_still(outputs, resume)
            elsewhere = None
            if cluster is not None:
                check_alone("--workers", loaded, max_error=max_error, time_budget=time_budget,
                            show_schedule=show_schedule, pixel_area=pixel_area or None)  # fmt: skip
                elsewhere = picture_elsewhere(cluster, scene, overrides, loaded, devices, memory_cap)
            render_still(
                loaded, outputs, stats, devices, memory_cap, quiet, start,
                isolate=isolate, max_error=max_error, time_budget=time_budget, pixel_area=pixel_area,
                show_schedule=show_schedule, elsewhere=elsewhere,
            )  # fmt: skip
            return
        from clvol.cli.animation import frame_range, render_animation

        if max_error is not None or time_budget is not None:
            option = OPTIONS["time_budget" if max_error is None else "max_error"]
            what = f"given for an animation of {loaded.animation.frames} frames"
            raise UsageError(option, what, "one frame: --set animation.frames=1")
        if show_schedule is not None:
            what = f"given for an animation of {loaded.animation.frames} frames"
            raise UsageError("--show-schedule", what, "one frame: --set animation.frames=1")
        wanted = slice(None) if frames is None else frame_range(frames, loaded.animation.frames)
        if cluster is not None:
            render_on_workers(
                cluster, scene, overrides, loaded, outputs, stats, resume=resume, frames=wanted, quiet=quiet,
                devices=devices, memory_cap=memory_cap, isolate=isolate,
            )  # fmt: skip
            return
        render_animation(
            loaded, outputs, stats, resume=resume, frames=wanted, quiet=quiet, devices=devices, memory_cap=memory_cap,
            isolate=isolate,
        )  # fmt: skip


def _frames_by_step(
    scene: Scene, outputs: tuple[str, ...], frames: str | None, memory_cap: int | None
) -> int | None:
    """How many frames ``scene`` has if they follow from the steps of its series: where it states no number of frames,
    and is to be rendered as an animation. None otherwise."""
    from clvol.batch.names import numbered
    from clvol.image import is_video

    animated = frames is not None or any(is_video(path) or numbered(path, 0) != path for path in outputs)
    return scene.frames_of_series(memory_cap) if animated else None
