"""clvol compare: how far two pictures are apart."""

from __future__ import annotations

import click

from clvol.cli.options import json_option


@click.command("compare", short_help="How far two pictures are apart.")
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@json_option
def command(a: str, b: str, as_json: bool) -> None:
    """Compare the pictures A and B (.exr, .png, .npy): RMSE, largest difference, PSNR, SSIM, and
    the CIEDE2000 colour difference as displayed."""
    from clvol.cli.console import say_json, say_table
    from clvol.errors import UsageError
    from clvol.image import load_image

    first, second = load_image(a)["rgba"], load_image(b)["rgba"]
    if first.shape != second.shape:
        height, width = first.shape[:2]
        got = f"got {second.shape[1]} x {second.shape[0]} pixels"
        raise UsageError(b, got, f"{width} x {height} pixels, as in {a}")
    from clvol.accuracy.metrics import compare

    measured = compare(first, second)
    if as_json:
        say_json(measured)
    else:
        say_table((name, f"{value:.6g}") for name, value in measured.items())
