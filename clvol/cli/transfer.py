"""clvol transfer: converts transfer functions between clvol and other tools."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from clvol.cli.options import complete_file

if TYPE_CHECKING:
    from clvol.transfer import TransferFunction


def _opacities(context: click.Context, parameter: click.Parameter, value: str | None) -> list[float] | None:
    if value is None:
        return None
    try:
        return [float(part) for part in value.split(",")]
    except ValueError:
        from clvol.errors import UsageError

        raise UsageError("--opacity", f"got {value!r}", "numbers from 0 to 1 with commas between") from None


@click.command("transfer", short_help="Convert a transfer function: ParaView, 3D Slicer, ITK-SNAP, VisIt, colour maps.")
@click.argument("function", metavar="FUNCTION", shell_complete=complete_file)
@click.option(
    "-o", "--output", metavar="FILE", shell_complete=complete_file,
    help="File to write: .json (ParaView), .vp, .vp.json, .ctbl (3D Slicer) or .toml (clvol). Default: print TOML.",
)  # fmt: skip
@click.option("--entry", metavar="NAME", help="Which preset of a ParaView file that has several.")
@click.option(
    "--range", "value_range", type=float, nargs=2, metavar="LOW HIGH", help="Values that the function's ends move to."
)
@click.option(
    "--opacity", metavar="A,B,…", callback=_opacities,
    help="Opacities, evenly spaced over the range, in place of the function's own.",
)  # fmt: skip
@click.option("--opacity-unit", type=float, metavar="LENGTH", help="World length that opacities refer to.")
def command(
    function: str,
    output: str | None,
    entry: str | None,
    value_range: tuple[float, float] | None,
    opacity: list[float] | None,
    opacity_unit: float | None,
) -> None:
    """Read FUNCTION and write it for another tool, or print it as the table [transfer_function] of a scene file.

    FUNCTION is a file (.json of ParaView; .vp, .vp.json, .ctbl of 3D Slicer; .txt, .label of ITK-SNAP; .ct of VisIt), a
    scene file (.toml), or the name of a colour map of matplotlib, colorcet or cmap or of a plain preset ('hot'), which
    lie between 0 and 1 without --range. Files are parsed and never executed. The output file appears whole or not at
    all.
    """
    from clvol.cli.console import say, say_path
    from clvol.cli.outputs import check_outputs
    from clvol.errors import UsageError
    from clvol.image import atomic_paths
    from clvol.inputs import Inputs, protected
    from clvol.scene.write import function_to_toml
    from clvol.transfer.exchange.files import WRITTEN, ending_of, text_of

    is_toml = output is not None and output.lower().endswith(".toml")
    if output is not None and not is_toml and ending_of(output) not in WRITTEN:
        raise UsageError("--output", f"got {output!r}", "a name that ends in " + ", ".join([*WRITTEN, ".toml"]))
    with protected(Inputs([function])):
        if output is not None:
            check_outputs([], [output])
        found = _read(function, entry, value_range, opacity, opacity_unit)
        if output is None:
            say(function_to_toml(found).rstrip("\n"))
            return
        text = function_to_toml(found) if is_toml else text_of(found, output)
        with atomic_paths([output]) as temporaries:
            temporaries[0].write_text(text, encoding="utf-8")
    say_path(output)


def _read(
    name: str,
    entry: str | None,
    value_range: tuple[float, float] | None,
    opacity: list[float] | None,
    unit: float | None,
) -> TransferFunction:
    import os

    from clvol.errors import SceneError, UsageError
    from clvol.transfer import PRESETS, TransferFunction, preset
    from clvol.transfer.exchange.files import ENDINGS, ending_of

    if name.lower().endswith(".toml"):
        given = {"--entry": entry, "--range": value_range, "--opacity": opacity, "--opacity-unit": unit}
        option = next((key for key, value in given.items() if value is not None), None)
        if option is not None:
            raise UsageError(option, "given for a scene file", "a file of another tool or a colour map")
        from clvol.scene import load_scene

        return load_scene(name).resolve().transfer_function
    if ending_of(name) is not None or os.path.exists(name):
        return TransferFunction.from_file(name, value_range, opacity, unit or 1.0, entry)
    if entry is not None:
        raise UsageError("--entry", f"given for {name!r}", "a file of ParaView with several presets")
    if name in PRESETS and opacity is None:
        return preset(name, value_range or (0.0, 1.0), unit or 1.0)
    try:
        return TransferFunction.from_colormap(name, value_range or (0.0, 1.0), opacity, unit or 1.0)
    except SceneError as error:
        if "no colour map" not in error.what:
            raise
        known = "a colour map, or a file: .toml, " + ", ".join(ENDINGS)
        raise UsageError("FUNCTION", error.what, known) from None
