"""clvol scene: prints the keys that a scene file may contain."""

from __future__ import annotations

import click

from clvol.errors import UsageError


def _complete_table(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    from clvol.scene.reference import table_names

    return [name for name in table_names() if name.startswith(incomplete)]


@click.command("scene", short_help="Print the keys of a scene file, with ranges, defaults and meaning.")
@click.argument("table", required=False, metavar="[TABLE]", shell_complete=_complete_table)
@click.option("--keys", is_flag=True, help="Print every key of TABLE, or of all tables, as a commented scene.")
@click.option("--schema", is_flag=True, help="Print the JSON schema of scene files, for editors.")
def command(table: str | None, keys: bool, schema: bool) -> None:
    """Print every key of a scene file: type, range, default and one line of meaning.

    The output of --keys is itself a scene file in TOML, in which keys without a default are commented out. Editors
    that read '#:schema' lines complete and check scene files by the output of --schema.
    """
    from clvol.cli.console import say, say_json
    from clvol.scene.reference import scene_reference, scene_schema

    if keys == schema:
        raise UsageError("clvol scene", "neither --keys nor --schema" if not keys else "--keys and --schema",
                         "one of --keys and --schema")  # fmt: skip
    if schema and table is not None:
        raise UsageError("clvol scene: TABLE", f"got {table!r} beside --schema", "no TABLE")
    if schema:
        say_json(scene_schema())
    else:
        say(scene_reference(table).rstrip("\n"))
