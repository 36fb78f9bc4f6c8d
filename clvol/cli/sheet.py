"""clvol sheet: a contact sheet of volumes or scenes, presets and views."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from clvol.cli.options import complete_file, complete_preset, complete_view, memory_cap_option, overrides_option
from clvol.errors import UsageError

if TYPE_CHECKING:
    import numpy as np

    from clvol.overlay.sheet import Cell
    from clvol.scene import Scene

_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".tif": "TIFF", ".tiff": "TIFF"}
_LARGEST_SIDE = 8192


@click.command("sheet", short_help="Render a contact sheet of volumes, presets and views.")
@click.argument("scenes", metavar="SCENE...", nargs=-1, required=True, shell_complete=complete_file)
@click.option(
    "-o", "--output", "outputs", multiple=True, required=True, metavar="FILE", shell_complete=complete_file,
    help="Sheet to write: .png, .jpg or .tif; '-' is standard output, as PNG. Repeatable.",
)  # fmt: skip
@click.option(
    "--view", "views", multiple=True, metavar="SIDE", shell_complete=complete_view,
    help="Side to show, as camera.view: front, front-left, … Repeatable.",
)  # fmt: skip
@click.option(
    "--preset", "presets", multiple=True, metavar="NAME", shell_complete=complete_preset,
    help="Preset to show, or a preset file (*.toml). Repeatable.",
)  # fmt: skip
@click.option(
    "--step", "steps", multiple=True, metavar="N",
    help="Step of a series to show: its number, 'A:B' or 'A:B:STRIDE' for several, ':' for all. Repeatable.",
)  # fmt: skip
@click.option("--columns", type=click.IntRange(1, 1000), metavar="N", help="Pictures in a row.")
@click.option(
    "--size", type=click.IntRange(16, _LARGEST_SIDE), default=320, show_default=True, metavar="PIXELS",
    help="Width and height of each picture.",
)  # fmt: skip
@click.option("--title", metavar="TEXT", default="", help="Title above the pictures.")
@click.option("--page", metavar="COLOR", default="#18191e", help="Colour of the sheet: a name, '#rrggbb' or 'r,g,b'.")
@overrides_option
@click.option(
    "--device", "devices", multiple=True, metavar="NAME", help="Device to render on, as for clvol render. Repeatable."
)
@memory_cap_option("Largest amount of memory that a volume may take, on the host and on the device.")
@click.option("--quiet", is_flag=True, help="Show no progress on the terminal.")
def command(
    scenes: tuple[str, ...],
    outputs: tuple[str, ...],
    views: tuple[str, ...],
    presets: tuple[str, ...],
    steps: tuple[str, ...],
    columns: int | None,
    size: int,
    title: str,
    page: str,
    overrides: tuple[str, ...],
    devices: tuple[str, ...],
    memory_cap: int | None,
    quiet: bool,
) -> None:
    """Render each SCENE, or volume file, with each of the presets from each of the views, and put the pictures on one
    sheet, with captions. With --step, each of these steps of a series is a picture.

    Without --preset a scene is as it is, and a volume as 'clvol render' shows it; without --view the camera is the
    scene's. A picture that fails is replaced by its error; the others are rendered, and the exit status is the largest.
    """
    from clvol.cli import say_error
    from clvol.cli.console import say_path, working
    from clvol.cli.devices import measure_for_all
    from clvol.cli.options import color_of
    from clvol.cli.outputs import check_outputs
    from clvol.cli.standard_output import STANDARD, check_standard, kept_clean
    from clvol.image import atomic_paths
    from clvol.inputs import Inputs, protected
    from clvol.overlay.sheet import SheetLayout, compose

    files = [path for path in outputs if path != STANDARD]
    check_standard(len(outputs) - len(files), 0)
    for path in files:
        _format_of(path)
    page_color = color_of("--page", page)
    _check_views(views)
    with protected(Inputs(scenes)), kept_clean(STANDARD in outputs) as write_standard:
        check_outputs([], files)
        keys = (*overrides, f"image.width={size}", f"image.height={size}")
        wanted = [
            _Wanted(scene, preset, step) for scene in scenes for step in _steps(scene, steps, keys, memory_cap)
            for preset in presets or (None,)
        ]  # fmt: skip
        count = len(wanted) * max(1, len(views))
        per_row = columns or (len(views) if len(views) > 1 else math.ceil(math.sqrt(count * 1.2)))
        layout = SheetLayout(count, size, size, per_row, title)
        measure_for_all(devices, quiet)
        cells: list[Cell] = []
        worst = 0
        with working(f"rendering {count} pictures", quiet) as progress:
            for one in wanted:
                for cell, status in _cells(one, views, keys, devices, memory_cap):
                    cells.append(cell)
                    if cell.error is not None:
                        say_error(cell.error)
                        worst = max(worst, status)
                    if progress is not None:
                        progress(len(cells), count)
        sheet = compose(cells, layout, page_color)
        with atomic_paths(files) as temporaries:
            for path, temporary in zip(files, temporaries):
                temporary.write_bytes(_encoded(sheet, _format_of(path)))
        if STANDARD in outputs:
            write_standard(_encoded(sheet, "PNG"))
        for path in files:
            say_path(path)
    if worst:
        raise click.exceptions.Exit(worst)


@dataclass(frozen=True)
class _Wanted:
    """A scene with a preset, and a step of its series; None: as it is."""

    scene: str
    preset: str | None
    step: int | None


def _steps(
    scene: str, texts: Sequence[str], overrides: Sequence[str], memory_cap: int | None
) -> Sequence[int | None]:
    """The numbers of the steps of ``scene`` that ``texts`` name; None alone where there are no ``texts``."""
    from clvol.scene import load_scene

    if not texts:
        return [None]
    series = load_scene(scene, overrides).load_series(memory_cap)
    if series is None:
        raise UsageError("--step", f"given for {scene}, which is no series", "a pattern or a list of volumes")
    found: list[int] = []
    for text in texts:
        numbers = text.split(":")
        if not all(each.isascii() and each.isdecimal() or each == "" and len(numbers) > 1 for each in numbers):
            raise UsageError("--step", f"got {text!r}", "a number, A:B, A:B:STRIDE, or ':' for all")
        if len(numbers) == 1:
            found.append(series.index(int(text), "--step"))
            continue
        parts = [int(each) if each else None for each in numbers]
        chosen = range(len(series))[slice(*parts)] if len(parts) <= 3 and 0 not in parts[2:] else range(0)
        if not chosen:
            raise UsageError("--step", f"got {text!r}, none of {len(series)} steps", f"0:{len(series)} or part of it")
        found += chosen
    return list(dict.fromkeys(found))


def _check_views(views: Sequence[str]) -> None:
    from clvol.choice.view import is_view

    for view in views:
        if not is_view(view):
            expected = "front, back, left, right, top, bottom, or up to three that meet, as in front-left"
            raise UsageError("--view", f"got {view!r}", expected)


def _format_of(path: str) -> str:
    import os

    ending = os.path.splitext(path)[1].lower()
    if ending not in _FORMATS:
        raise UsageError(path, f'unknown ending "{ending}" of a sheet', " or ".join(_FORMATS))
    return _FORMATS[ending]


def _cells(
    wanted: _Wanted, views: Sequence[str], overrides: Sequence[str], devices: Sequence[str], memory_cap: int | None
) -> Iterator[tuple[Cell, int]]:
    """The cells of one scene, and the exit status of each: a picture, or the error, for each view."""
    from clvol.cli.group import describe_error
    from clvol.cli.several import stem_of
    from clvol.interrupts import check_stopped
    from clvol.overlay.sheet import Cell

    base: Scene | None = None
    for view in views or (None,):
        name = stem_of(wanted.scene)
        shown_step = None if wanted.step is None else f"step {wanted.step}"
        told = ", ".join(filter(None, [shown_step, wanted.preset, view]))
        try:
            base = _loaded(wanted, overrides, memory_cap) if base is None else base
            picture, kind = _picture(base, view, list(devices) or None, memory_cap)
            yield Cell(picture, name, told or kind), 0
        except Exception as error:
            check_stopped()
            status, line = describe_error(error)
            yield Cell(None, name, told, line), status


def _loaded(wanted: _Wanted, overrides: Sequence[str], memory_cap: int | None) -> Scene:
    import os

    from clvol.scene import load_scene
    from clvol.scene.write import format_value

    keys = list(overrides)
    if wanted.preset is not None:
        name = os.path.abspath(wanted.preset) if wanted.preset.lower().endswith(".toml") else wanted.preset
        keys.append(f"transfer_function={{preset={format_value(name)}}}")
    if wanted.step is not None:
        keys.append(f"volume.step={wanted.step}")
    scene = load_scene(wanted.scene, keys)
    scene.load(memory_cap)
    return scene


def _picture(
    scene: Scene, view: str | None, devices: list[str] | None, memory_cap: int | None
) -> tuple[np.ndarray, str]:
    """uint8 [height, width, 3] of ``scene`` from ``view``, and the kind of volume that was recognised."""
    from clvol.image.develop import shown_picture
    from clvol.render import Renderer
    from clvol.scene import Camera

    if view is not None:
        stated = scene.camera
        keys: dict[str, Any] = {}
        if stated is not None:
            keys = {"projection": stated.projection, "fov_degrees": stated.fov_degrees}
        scene = scene.model_copy(update={"camera": Camera(view=view, **keys)})
    with Renderer(scene, devices=devices, memory_cap=memory_cap) as renderer:
        frame = renderer.render(depth=False)
    shown = shown_picture(frame, frame.rgba, may_be_transparent=False)
    return shown, str(frame.stats.get("chosen", {}).get("kind", ""))


def _encoded(sheet: np.ndarray, format: str) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    options: dict[str, Any] = {"quality": 93, "subsampling": 0} if format == "JPEG" else {}
    if format == "TIFF":
        options = {"compression": "tiff_deflate"}
    Image.fromarray(sheet).save(file, format=format, **options)
    return file.getvalue()
