"""clvol compare: how far apart two pictures are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from clvol.cli.options import complete_file, json_option, memory_cap_option

if TYPE_CHECKING:
    import numpy as np


_WRITTEN = (".png", ".exr", ".npy")


@click.command("compare", short_help="Measure how far apart two pictures are.")
@click.argument("a", metavar="A", shell_complete=complete_file)
@click.argument("b", metavar="B", shell_complete=complete_file)
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    metavar="FILE",
    shell_complete=complete_file,
    help="Write the difference: .png shows |A - B| with a scale, .exr and .npy hold A - B (signed, linear). "
    "Repeatable.",
)
@json_option
@memory_cap_option("Largest amount of memory that each picture may take while it is read; default 1 GiB.")
def command(
    a: str, b: str, outputs: tuple[str, ...], as_json: bool, memory_cap: int | None
) -> None:
    """Compare the pictures A and B (.exr, .png, .jpg, .tif, .npy): RMSE, largest difference, PSNR, SSIM, and
    the CIEDE2000 colour difference as displayed.

    A displayed picture (.png, .jpg, .tif) includes its background, unless it is transparent. When it is compared with
    an .exr or .npy, the latter is composited over the background that the files state, and only colours are compared.
    The output states what was left out of the comparison, and the difference that rounding to 8 bits alone would
    cause.
    """
    from clvol.inputs import Inputs, protected

    with protected(Inputs([a, b])):
        _compare(a, b, outputs, as_json, memory_cap)


def _compare(
    a: str, b: str, outputs: tuple[str, ...], as_json: bool, memory_cap: int | None
) -> None:
    from clvol.accuracy.pair import comparable
    from clvol.cli.console import say_json, say_table, working
    from clvol.cli.outputs import check_outputs
    from clvol.errors import UsageError
    from clvol.image import load_image

    for path in outputs:
        if not path.lower().endswith(_WRITTEN):
            raise UsageError(path, "unknown ending of a difference", " or ".join(_WRITTEN))
    check_outputs(outputs, [])
    with working(f"comparing {a} and {b}", False, [a, b]):
        first, second = load_image(a, memory_cap), load_image(b, memory_cap)
        shape, other = first["rgba"].shape, second["rgba"].shape
        if shape != other:
            got = f"got {other[1]} x {other[0]} pixels"
            raise UsageError(b, got, f"{shape[1]} x {shape[0]} pixels, as in {a}")
        pair = comparable(first, second, (a, b))
        measured = pair.measures()
    if outputs:
        _write(pair.first, pair.second, outputs)
    if as_json:
        say_json(measured)
    else:
        say_table(_rows(measured) + [("difference", path) for path in outputs])


def _rows(measured: dict[str, Any]) -> list[tuple[str, str]]:
    rows = [(name, f"{v:.6g}") for name, v in measured.items() if isinstance(v, float)]
    rows.append(("compared", measured["compared"]))
    if measured["background"] is not None:
        color = " ".join(f"{value:.6g}" for value in measured["background"])
        rows.append(("background", f"{color}  (linear light)"))
    rows += [("left out", sentence) for sentence in measured["left_out"]]
    rounding = measured["rounding"]
    if rounding is not None:
        text = f"one of the two is rounded to {rounding['bits']} bits of sRGB"
        if "rmse" in rounding:
            alone = f"rmse {rounding['rmse']:.3g}, max_abs {rounding['max_abs']:.3g}"
            text += f", which alone causes {alone}"
        rows.append(("rounding", text))
    return rows


def _write(first: np.ndarray, second: np.ndarray, outputs: tuple[str, ...]) -> None:
    """Writes the difference of two pictures (float32 [height, width, 4]) to each of the files, to all or none."""
    from clvol.accuracy.difference import difference_picture, signed_difference
    from clvol.image import atomic_paths, save_picture
    from clvol.render.frame import Frame

    with atomic_paths(outputs) as temporaries:
        for path, temporary in zip(outputs, temporaries):
            if path.lower().endswith(".png"):
                from PIL import Image

                shown = difference_picture(first, second)
                Image.fromarray(shown).save(temporary, format="PNG")
            else:
                save_picture(Frame(signed_difference(first, second)), temporary, path)
