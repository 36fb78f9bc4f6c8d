"""clvol init: writes a complete, commented scene for a volume."""

from __future__ import annotations

import click

from clvol.cli.options import complete_file, complete_preset, memory_cap_option, overrides_option, volume_argument


@click.command("init", short_help="Write a complete, commented scene with what is chosen for a volume.")
@volume_argument
@click.option(
    "-o", "--output", required=True, metavar="SCENE", shell_complete=complete_file,
    help="Scene file to write (.toml).",
)  # fmt: skip
@click.option(
    "--preset", metavar="NAME", shell_complete=complete_preset,
    help="Preset instead of what would be chosen: a name, or a preset file (*.toml).",
)  # fmt: skip
@overrides_option
@memory_cap_option("Largest amount of memory that the volume may take.")
def command(
    volume: str, output: str, preset: str | None, overrides: tuple[str, ...], memory_cap: int | None
) -> None:
    """Write a scene for VOLUME that renders as 'clvol render VOLUME' does, with every choice in it and a comment beside
    it: a file to go on from.

    The transfer function, lights, material, filter, background and camera are chosen from the voxels. --set states
    values instead; --preset uses a preset's transfer function and technique. The scene file appears whole or not at
    all, and names the volume relative to its own folder.
    """
    import os

    from clvol.cli.console import note, say_path, working
    from clvol.cli.outputs import check_outputs, scene_inputs
    from clvol.errors import UsageError
    from clvol.image import atomic_paths
    from clvol.inputs import protected
    from clvol.scene import load_scene
    from clvol.scene.initial import initial_scene
    from clvol.scene.write import format_value

    if not output.lower().endswith(".toml"):
        raise UsageError("--output", f"got {output!r}", "a file name that ends in .toml")
    if preset is not None:
        if preset.lower().endswith(".toml"):
            preset = os.path.abspath(preset)
        overrides = (*overrides, f"transfer_function.preset={format_value(preset)}")
    scene = load_scene(volume, overrides)
    with protected(scene_inputs(volume, scene)):
        check_outputs([], [output])
        with working(f"loading {scene.origin}", False, scene.input_paths):
            completed = scene.completed(memory_cap)
        text = initial_scene(completed, os.path.dirname(os.path.abspath(output)))
        with atomic_paths([output]) as temporaries:
            temporaries[0].write_text(text, encoding="utf-8")
    say_path(output)
    if completed.chosen is not None:
        note(completed.chosen["in_words"])
