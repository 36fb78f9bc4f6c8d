"""clvol explain: lists the effects that a scene uses, and says why."""

from __future__ import annotations

import click

from clvol.cli.options import json_option, memory_cap_option, overrides_option, scene_argument


@click.command("explain", short_help="Explain which effects a scene uses, which not, and why.")
@scene_argument
@json_option
@overrides_option
@memory_cap_option("Largest amount of memory that the volume may take.")
def command(
    scene: str, as_json: bool, overrides: tuple[str, ...], memory_cap: int | None
) -> None:
    """Explain which effects SCENE uses, which it does not, and why.

    Only the effects that are used are compiled; scenes with the same kernel hash share one kernel.
    """
    from clvol.cli.console import say, say_json, say_table, working
    from clvol.scene import load_scene

    loaded = load_scene(scene, overrides)
    with working(f"loading {scene}", False, loaded.input_paths):
        resolved = loaded.resolve(memory_cap)
        from clvol.explanation import explain

        explanation = explain(resolved)
    if as_json:
        say_json(explanation)
        return
    say_table(
        (f"{'yes' if effect['called_for'] else 'no':<3}  {effect['name']}", effect["reason"])
        for effect in explanation["effects"]
    )
    compression = explanation.get("compression")
    if compression is not None:
        say(f"compression {compression['codec']}: {compression['does']}. {compression['costs'].capitalize()}.")
    classification = explanation["classification"]
    say(f"classification {classification['name']}: {classification['reason']}")
    rays = explanation["rays"]
    say(f"rays per pixel {rays['per_pixel']}: {rays['reason']}")
    coherence = explanation.get("coherence")
    if coherence is not None:
        say(f"coherence {coherence['mode']}: {coherence['reason']}")
    minification = explanation.get("minification")
    if minification is not None and minification["mode"] != "off":
        first, last = minification["levels"]
        say(f"minification by levels {first} to {last}: {minification['reason']}")
    say(f"kernel {explanation['kernel_hash']}")
    for warning in explanation["warnings"]:
        say(f"warning: {warning}")
