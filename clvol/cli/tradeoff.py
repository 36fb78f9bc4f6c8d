"""clvol tradeoff: what accuracy costs in time, for one scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clvol.cli.options import memory_cap_option, overrides_option, scene_argument

if TYPE_CHECKING:
    from clvol.scene import Scene


@click.command("tradeoff", short_help="Error against time, over everything that trades one for the other.")
@scene_argument
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR", help="Folder to write, made if need be."
)
@overrides_option
@click.option(
    "--device", "devices", multiple=True, metavar="NAME", help="A name of 'clvol doctor'."
)
@click.option(
    "--frames", type=click.IntRange(1, 1000), default=7, show_default=True,
    help="Frames that each time is the median of.",
)  # fmt: skip
@click.option(
    "--settings", type=click.IntRange(1, 100_000), default=160, show_default=True,
    help="Settings to try at most.",
)  # fmt: skip
@memory_cap_option("The most memory that the volume may take, here and on the device.")
@click.option("--quiet", is_flag=True, help="No progress on the terminal.")
def command(
    scene: str,
    folder: str,
    overrides: tuple[str, ...],
    devices: tuple[str, ...],
    frames: int,
    settings: int,
    memory_cap: int | None,
    quiet: bool,
) -> None:
    """Render SCENE under many settings and measure each one's error, against the exact integral, and time.

    Writes index.html (to look at), tradeoff.json, tradeoff.png and images to DIR, and says which
    settings to use for which error. Takes minutes; nothing else should run meanwhile.
    """
    from clvol.cli.console import say, say_path
    from clvol.cli.outputs import scene_inputs
    from clvol.inputs import protected
    from clvol.scene import load_scene
    from clvol.text import printable

    asked = load_scene(scene, overrides)
    how = {"devices": list(devices) or None, "frames": frames, "settings": settings}
    with protected(scene_inputs(scene, asked)):
        result, paths = _report(asked, folder, memory_cap, quiet, **how)
    for sentence in result["sentences"]:
        say(printable(sentence["text"]))
    say_path(next(path for path in paths if path.name == "index.html"))


def _report(
    asked: Scene, folder: str, memory_cap: int | None, quiet: bool, **how: Any
) -> tuple[dict[str, Any], list[Path]]:
    """Measures and writes; what was measured, and the files."""
    from clvol.cli.console import working
    from clvol.cli.outputs import check_folder

    check_folder(folder)
    with working(f"loading {asked.origin}", quiet):
        asked.load(memory_cap)

    from clvol.accuracy.report import write_report
    from clvol.accuracy.tradeoff import measure_tradeoff

    with working("measuring", quiet) as progress:
        result, pictures = measure_tradeoff(asked, memory_cap=memory_cap, progress=progress, **how)
    with working("writing", quiet):
        return result, write_report(result, pictures, Path(folder))
