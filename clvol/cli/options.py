"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable

import click
from click.shell_completion import CompletionItem


def complete_file(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Lets the shell itself complete the name of a file."""
    return [CompletionItem(incomplete, type="file")]


def _complete_key(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """TABLE.KEY= for every key of a scene; for lists of tables, the keys of the first table."""
    from clvol.scene.reference import override_keys

    return [f"{key}=" for key in override_keys() if key.startswith(incomplete)]


def complete_preset(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """The names of presets."""
    from clvol.scene.preset_file import preset_names
    from clvol.transfer import PRESETS

    known = dict.fromkeys([*PRESETS, *preset_names()])
    return [name for name in known if name.startswith(incomplete)]


def complete_view(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """The six sides, and those between two of them."""
    across, along, upright = ("front", "back"), ("left", "right"), ("top", "bottom")
    sides = [*across, *along, *upright, *(f"{a}-{b}" for a in across for b in along)]
    return [side for side in sides if side.startswith(incomplete)]


scene_argument = click.argument("scene", metavar="SCENE", shell_complete=complete_file)
volume_argument = click.argument("volume", metavar="VOLUME", shell_complete=complete_file)
overrides_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="TABLE.KEY=VALUE",
    shell_complete=_complete_key,
    help="Override a value of the scene, in TOML syntax ('clvol scene --keys' lists the keys). Repeatable.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")


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


def color_of(option: str, text: str) -> tuple[float, float, float]:
    """A colour as on the screen: a name, "#rrggbb", or three numbers from 0 to 1 with commas between them."""
    from clvol.errors import UsageError
    from clvol.transfer.color_names import EXPECTED, parse_color

    expected = EXPECTED
    try:
        parts = text.strip("[] ").split(",")
        if len(parts) != 3:
            return parse_color(text)
        red, green, blue = (float(part) for part in parts)
        if all(0.0 <= level <= 1.0 for level in (red, green, blue)):
            return red, green, blue
    except ValueError as error:
        expected = str(error) if len(parts) != 3 else EXPECTED
    raise UsageError(option, f"got {text!r}", expected)
