"""clvol tradeoff: measures what accuracy costs in time for one scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clvol.cli.devices import measure_for_all
from clvol.cli.options import memory_cap_option, overrides_option, scene_argument
from clvol.cli.verbose import log_scene

if TYPE_CHECKING:
    from clvol.scene import Scene


@click.command("tradeoff", short_help="Measure error against time, over all settings that trade one for the other.")
@scene_argument
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR", help="Folder to write; created if it does not exist."
)
@overrides_option
@click.option(
    "--device", "devices", multiple=True, metavar="NAME",
    help="Device to render on, by its name in 'clvol doctor'. Repeatable: devices share each picture. 'all': one per "
    "processor. NAME:k/n: the k-th of n equal parts of a device.",
)
@click.option(
    "--frames", type=click.IntRange(1, 1000), default=7, show_default=True,
    help="Number of frames; times are medians over them.",
)  # fmt: skip
@click.option(
    "--settings", type=click.IntRange(1, 100_000), default=160, show_default=True,
    help="Largest number of settings to try.",
)  # fmt: skip
@click.option(
    "--pixel-area", is_flag=True,
    help="Errors against the integral over each pixel, not along the ray through its middle; the number of rays per "
    "pixel is tried, too. So it is for scenes with image.samples above 1.",
)  # fmt: skip
@memory_cap_option("Largest amount of memory that the volume may take, on the host and on the device.")
@click.option("--quiet", is_flag=True, help="Show no progress on the terminal.")
def command(
    scene: str,
    folder: str,
    overrides: tuple[str, ...],
    devices: tuple[str, ...],
    frames: int,
    settings: int,
    pixel_area: bool,
    memory_cap: int | None,
    quiet: bool,
) -> None:
    """Render SCENE with many settings; measure the time of each, and its error against the exact integral.

    Writes index.html (a report), tradeoff.json, tradeoff.png and images to DIR, and prints which settings to use for
    which error. This takes minutes; nothing else should run at the same time.
    """
    from clvol.cli.console import say, say_path
    from clvol.cli.outputs import scene_inputs
    from clvol.inputs import protected
    from clvol.scene import load_scene
    from clvol.text import printable

    loaded = load_scene(scene, overrides)
    measure_for_all(devices, quiet)
    options = {"devices": list(devices) or None, "frames": frames, "settings": settings, "pixel_area": pixel_area}
    with protected(scene_inputs(scene, loaded)):
        result, paths = _report(loaded, folder, memory_cap, quiet, **options)
    for sentence in result["sentences"]:
        say(printable(sentence["text"]))
    say_path(next(path for path in paths if path.name == "index.html"))


def _report(
    scene: Scene, folder: str, memory_cap: int | None, quiet: bool, **options: Any
) -> tuple[dict[str, Any], list[Path]]:
    """Measures and writes the report; returns the result and the files."""
    from clvol.cli.console import working
    from clvol.cli.outputs import check_folder

    check_folder(folder)
    with working(f"loading {scene.origin}", quiet, scene.input_paths):
        scene.load(memory_cap)
    log_scene(scene, memory_cap)

    from clvol.accuracy.report import write_report
    from clvol.accuracy.tradeoff import measure_tradeoff

    with working("measuring", quiet) as progress:
        result, pictures = measure_tradeoff(scene, memory_cap=memory_cap, progress=progress, **options)
    with working("writing", quiet):
        return result, write_report(result, pictures, Path(folder))
