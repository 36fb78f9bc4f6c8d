"""The command group: one module a command, imported when that command is called."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib import import_module

import click

from clvol import __version__
from clvol.errors import ClvolError, RenderError, UsageError

COMMANDS = ("render", "explain", "info", "store", "doctor", "compare", "tradeoff")  # each a module of this package


class _Commands(click.Group):
    """Commands that are imported by name; each module calls its own ``command``."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        return import_module(f"clvol.cli.{name}").command if name in COMMANDS else None

    def resolve_command(self, ctx: click.Context, args: list[str]):
        if args[0] not in COMMANDS:
            raise UsageError("clvol", f"unknown command {args[0]!r}", _one_command())
        return super().resolve_command(ctx, args)


@click.group(
    cls=_Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="clvol", message="%(prog)s %(version)s")
@click.pass_context
def cli(context: click.Context) -> None:
    """Volume rendering that says how wrong its pictures are."""
    if context.invoked_subcommand is None:
        raise UsageError("clvol", "no command", _one_command())


def run(given: Sequence[str]) -> int:
    """Runs the command line ``given`` and returns the exit status; raises what goes wrong."""
    try:
        with cli.make_context("clvol", list(given)) as context:
            cli.invoke(context)
        return 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.Abort:
        raise KeyboardInterrupt from None


def told(error: Exception) -> tuple[int, str]:
    """Exit status and line of what ``run`` has raised."""
    if isinstance(error, click.ClickException):
        error = _usage_error(error)
    if isinstance(error, ClvolError):
        return error.exit_status, str(error)
    if isinstance(error, MemoryError):
        line = "memory: not enough for this scene, expected a smaller volume or image"
        return RenderError.exit_status, line
    if isinstance(error, OSError) and error.strerror:
        named = isinstance(error.filename, (str, bytes, os.PathLike))
        where = os.fsdecode(error.filename) if named else "system"
        return 4, str(ClvolError(where, error.strerror, "a file that can be read and written"))
    return 4, f"internal: {type(error).__name__}: {error}"


def _one_command() -> str:
    return "one of " + ", ".join(COMMANDS) + "; see 'clvol --help'"


def _usage_error(error: click.ClickException) -> ClvolError:
    """click's words in the form of all other errors."""
    context = getattr(error, "ctx", None)
    command = context.command_path if context else "clvol"
    see = f"what '{command} --help' says"
    if isinstance(error, click.MissingParameter) and error.param is not None:
        name = error.param.opts[0] if error.param.opts[0].startswith("-") else ""
        wanted = " ".join(filter(None, [name, str(error.param.metavar or error.param.name)]))
        return UsageError(command, f"no {wanted}", f"{wanted}; see '{command} --help'")
    if isinstance(error, click.NoSuchOption):
        near = " or ".join(error.possibilities or ())
        return UsageError(command, f"unknown option {error.option_name}", near or see)
    if isinstance(error, click.BadParameter) and error.param is not None:
        command = f"{command}: {error.param.opts[0]}"
    return UsageError(command, error.format_message().rstrip("."), see)
