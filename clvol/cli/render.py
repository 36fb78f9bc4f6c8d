"""clvol render: a picture of a scene or of a volume file."""

from __future__ import annotations

import time

import click

from clvol.cli.options import memory_cap_option, overrides_option, scene_argument


@click.command("render", short_help="Render a scene, or a volume file with all defaults.")
@scene_argument
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    required=True,
    metavar="FILE",
    help="Picture to write: .exr, .png or .npy. Repeatable.",
)
@overrides_option
@click.option(
    "--device",
    "devices",
    multiple=True,
    metavar="NAME",
    help="A name of 'clvol doctor'. Repeatable.",
)
@click.option("--stats", metavar="FILE", help="Where to write times and counts as JSON.")
@memory_cap_option("The most memory that the volume may take, here and on the device.")
@click.option("--quiet", is_flag=True, help="No progress on the terminal.")
def command(
    scene: str,
    outputs: tuple[str, ...],
    overrides: tuple[str, ...],
    devices: tuple[str, ...],
    stats: str | None,
    memory_cap: int | None,
    quiet: bool,
) -> None:
    """Render SCENE (.toml), or a volume file with all defaults, and print the files written.

    All files appear whole, or none does.
    """
    start = time.perf_counter()
    from clvol.cli.console import say, to_json, working
    from clvol.cli.outputs import check_outputs, save_picture, together
    from clvol.scene import load_scene

    others = [] if stats is None else [stats]
    asked = load_scene(scene, overrides)
    volume_path = asked.volume_path
    check_outputs(outputs, others, [scene] if volume_path is None else [scene, volume_path])
    with working(f"loading {scene}", quiet):
        asked.load_volume(memory_cap)
    load_seconds = time.perf_counter() - start

    from clvol.render import Renderer

    depth = any(path.lower().endswith(".exr") for path in outputs)
    size = f"{asked.image.width} x {asked.image.height} pixels"
    with working(f"rendering {size}", quiet) as progress:
        with Renderer(asked, list(devices) or None, memory_cap) as renderer:
            frame = renderer.render(progress=progress, depth=depth)

    with working("writing", quiet), together([*outputs, *others]) as temporaries:
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
        say(click.format_filename(path))
