"""clvol develop: displays a picture in another way, without rendering it again."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from clvol.cli.options import complete_file, memory_cap_option
from clvol.errors import UsageError

if TYPE_CHECKING:
    from clvol.render.frame import Frame

TABLES = ("display", "overlay")
_DISPLAYED = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


def _complete_key(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    from clvol.scene.reference import override_keys

    known = [key for key in override_keys() if key.split(".")[0] in TABLES or key == "image.background"]
    return [f"{key}=" for key in known if key.startswith(incomplete)]


def _complete_curve(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    from clvol.image.develop import TONE_CURVES

    return [name for name in TONE_CURVES if name.startswith(incomplete)]


@click.command("develop", short_help="Display a picture with another exposure, tone curve or background.")
@click.argument("pictures", metavar="PICTURE...", nargs=-1, required=True, shell_complete=complete_file)
@click.option(
    "-o", "--output", "outputs", multiple=True, required=True, metavar="FILE", shell_complete=complete_file,
    help="Picture to write: .png, .jpg or .tif (16 bits); '-' is standard output, as PNG. {stem} stands for the name "
    "of PICTURE without its ending. Repeatable.",
)  # fmt: skip
@click.option("--exposure", type=float, metavar="STOPS", help="Factor on the light, in stops: 1 doubles it.")
@click.option(
    "--tone-curve", metavar="NAME", shell_complete=_complete_curve, help="clip, reinhard or filmic."
)
@click.option("--white", type=float, metavar="LIGHT", help="Light that the curves reinhard and filmic show as white.")
@click.option("--transparent/--opaque", default=None, help="An alpha channel in place of the background, or none.")
@click.option(
    "--background", metavar="COLOR",
    help="Colour behind the volume: a name, '#rrggbb', or three numbers as in '0.1,0.1,0.2'.",
)  # fmt: skip
@click.option(
    "--set", "overrides", multiple=True, metavar="TABLE.KEY=VALUE", shell_complete=_complete_key,
    help="A key of [display] or [overlay], or image.background, in TOML syntax. Repeatable.",
)  # fmt: skip
@memory_cap_option("Largest amount of memory that a picture may take while it is read; default 1 GiB.")
def command(
    pictures: tuple[str, ...],
    outputs: tuple[str, ...],
    exposure: float | None,
    tone_curve: str | None,
    white: float | None,
    transparent: bool | None,
    background: str | None,
    overrides: tuple[str, ...],
    memory_cap: int | None,
) -> None:
    """Display each PICTURE (.exr or .npy, as clvol writes them) with another exposure, tone curve, background or
    overlay. Nothing is rendered, and the picture stays as it is.

    What is not stated is as in [display] and [overlay] of the scene that the picture carries. The colour bar of a
    picture that was rendered without one has no histogram. With several pictures, every output has {stem} in its name.
    """
    from clvol.cli.several import check_names, each_of, filled
    from clvol.inputs import Inputs, protected

    stated = {"exposure": exposure, "tone_curve": tone_curve, "white": white, "transparent": transparent}
    stated = {key: value for key, value in stated.items() if value is not None}
    check_names(pictures, outputs)

    def develop(picture: str) -> None:
        _develop(picture, [filled(path, picture) for path in outputs], stated, background, overrides, memory_cap)

    with protected(Inputs(pictures)):
        each_of(pictures, develop)


def _develop(
    picture: str, outputs: Sequence[str], stated: dict[str, Any], background: str | None, overrides: Sequence[str],
    memory_cap: int | None,
) -> None:  # fmt: skip
    from pathlib import Path

    from clvol.cli.console import say_path, working
    from clvol.cli.outputs import check_outputs
    from clvol.cli.standard_output import STANDARD, check_standard, kept_clean
    from clvol.image import atomic_paths, save_picture, write_frame
    from clvol.render.frame import Frame
    from clvol.render.load_frame import load_frame

    files = [path for path in outputs if path != STANDARD]
    check_standard(len(outputs) - len(files), 0)
    for path in files:
        if Path(path).suffix.lower() not in _DISPLAYED:
            what = f'unknown ending "{Path(path).suffix}" of a displayed picture'
            raise UsageError(path, what, " or ".join(_DISPLAYED))
    check_outputs(files, [])
    with kept_clean(STANDARD in outputs) as write_standard:
        with working(f"developing {picture}", quiet=False):
            frame = load_frame(Frame, picture, memory_cap)
            _change(frame, picture, stated, background, overrides)
            standard = io.BytesIO()
            with atomic_paths(files) as temporaries:
                for path, temporary in zip(files, temporaries):
                    save_picture(frame, temporary, path)
                if STANDARD in outputs:
                    write_frame(frame, standard)
        write_standard(standard.getvalue())
        for path in files:
            say_path(path)


def _change(
    frame: Frame, picture: str, stated: dict[str, Any], background: str | None, overrides: Sequence[str]
) -> None:
    """Gives ``frame`` what the options state, and the scene that it carries the same keys."""
    from clvol.cli.options import color_of
    from clvol.overlay import DrawnOverlay
    from clvol.scene import Display, Overlay
    from clvol.scene.carried import tables_of
    from clvol.scene.load import override
    from clvol.transfer import srgb_to_linear

    data = tables_of(frame.scene_source or "", picture)
    if background is not None:
        data["image"] = {**_table(data, "image"), "background": list(color_of("--background", background))}
    data["display"] = {**_table(data, "display"), **stated}
    for text in overrides:
        key = text.partition("=")[0].strip()
        if key.split(".")[0].strip() not in TABLES and key != "image.background":
            raise UsageError(f"--set {key}", "changes what would have to be rendered again",
                             "a key of [display] or [overlay], or image.background")  # fmt: skip
        override(data, text, picture)
    frame.display = Display(**_table(data, "display"))
    settings = Overlay(**_table(data, "overlay"))
    if frame.overlay is not None:
        frame.overlay = DrawnOverlay(frame.overlay.description.model_copy(update={"settings": settings}))
    elif settings.draws:
        raise UsageError(picture, "carries no description of its view, from which an overlay is drawn",
                         "an .exr or .npy that this version of clvol has rendered")  # fmt: skip
    is_changed = background is not None or any(text.strip().startswith("image.") for text in overrides)
    if is_changed:
        color = _checked_color(_table(data, "image").get("background"))
        is_linear = _table(data, "transfer_function").get("color_space") == "linear" and background is None
        frame.background = srgb_to_linear(color) if not is_linear else color
        if background is not None and _table(data, "transfer_function").get("color_space") == "linear":
            data["image"]["background"] = frame.background.tolist()
    _restate(frame, data, picture)


def _restate(frame: Frame, data: dict[str, Any], picture: str) -> None:
    """Makes the scene that ``frame`` carries state what it is displayed with; a scene whose voxels were an array, which
    cannot be read back, stays as it is."""
    from pathlib import Path

    from clvol.errors import SceneError
    from clvol.scene import Scene

    if frame.scene_source is None:
        return
    try:
        frame.scene_source = Scene.from_data({k: v for k, v in data.items() if v != {}}, picture, Path()).to_toml()
    except SceneError:
        pass


def _table(data: dict[str, Any], name: str) -> dict[str, Any]:
    table = data.get(name, {})
    return table if isinstance(table, dict) else {}


def _checked_color(value: Any) -> Any:
    import numpy as np

    from clvol.scene import ImageSettings

    return np.array(ImageSettings(background=value).background, dtype=np.float64)
