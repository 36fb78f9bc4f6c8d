"""clvol compare: how far two pictures are apart."""

from __future__ import annotations

import click

from clvol.cli.options import json_option


@click.command("compare", short_help="How far two pictures are apart.")
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    metavar="FILE",
    help="Difference picture: .png shows |A - B| with its scale, .exr and .npy hold A - B (signed, "
    "linear). Repeatable.",
)
@json_option
def command(a: str, b: str, outputs: tuple[str, ...], as_json: bool) -> None:
    """Compare the pictures A and B (.exr, .png, .npy): RMSE, largest difference, PSNR, SSIM, and
    the CIEDE2000 colour difference as displayed."""
    from clvol.cli.console import say_json, say_table
    from clvol.cli.outputs import check_outputs
    from clvol.inputs import Inputs, protected
    from clvol.errors import UsageError
    from clvol.image import load_image

    check_outputs(outputs, [], [a, b])
    first, second = load_image(a)["rgba"], load_image(b)["rgba"]
    if first.shape != second.shape:
        height, width = first.shape[:2]
        got = f"got {second.shape[1]} x {second.shape[0]} pixels"
        raise UsageError(b, got, f"{width} x {height} pixels, as in {a}")
    from clvol.accuracy.metrics import compare

    measured = compare(first, second)
    if outputs:
        _write(first, second, outputs)
    if as_json:
        say_json(measured)
    else:
        rows = [(name, f"{value:.6g}") for name, value in measured.items()]
        say_table(rows + [("difference", path) for path in outputs])


def _write(first, second, outputs: tuple[str, ...]) -> None:
    """The difference of two float32 [height, width, 4] as each of the files, all or none."""
    from clvol.accuracy.difference import difference_picture, signed_difference
    from clvol.cli.outputs import save_picture, together
    from clvol.render.frame import Frame

    with together(outputs) as temporaries:
        for path, temporary in zip(outputs, temporaries):
            if path.lower().endswith(".png"):
                from PIL import Image

                shown = difference_picture(first, second)
                Image.fromarray(shown).save(temporary, format="PNG")
            else:
                save_picture(Frame(signed_difference(first, second)), temporary, path)
