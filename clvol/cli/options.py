"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable

import click

scene_argument = click.argument("scene", metavar="SCENE")
overrides_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="TABLE.KEY=VALUE",
    help="Override a value of the scene, in TOML syntax. Repeatable.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="JSON instead of text.")


def _size(context: click.Context, parameter: click.Parameter, value: str | None) -> int | None:
    if value is None:
        return None
    from clvol.errors import UsageError
    from clvol.scene.sizes import parse_size

    try:
        return parse_size(value)
    except ValueError:
        raise UsageError("--memory-cap", f"got {value!r}", "a size such as '2 GiB'") from None


def memory_cap_option(help: str) -> Callable:
    return click.option("--memory-cap", metavar="SIZE", callback=_size, help=help)
