"""The command group: one module per command, imported when that command is called."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib import import_module

import click

from clvol import __version__
from clvol.cli.verbose import verbose_option
from clvol.errors import ClvolError, RenderError, UsageError

# Each command is a module of this package.
COMMANDS = (
    "render", "batch", "develop", "sheet", "init", "explain", "info", "scene", "transfer", "store", "doctor",
    "compare", "tradeoff", "completion",
)  # fmt: skip
_LONGEST_WORD = 100  # longer ones get no "did you mean"
COMPLETE = "_CLVOL_COMPLETE"  # the environment variable that a shell's completion script sets


class _Commands(click.Group):
    """Imports commands by name. Each module defines its command as ``command``, and every command has -v."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        command = import_module(f"clvol.cli.{name}").command
        if not any(parameter.name == "verbose" for parameter in command.params):
            command.params.append(verbose_option())
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]):
        if args[0] not in COMMANDS:
            raise UsageError("clvol", f"unknown command {args[0]!r}", _one_command(args[0]))
        return super().resolve_command(ctx, args)


def _print_manual(context: click.Context, parameter: click.Parameter, requested: bool) -> None:
    if requested and not context.resilient_parsing:
        from clvol.cli.console import say
        from clvol.cli.manual import manual_page

        say(manual_page(cli).rstrip("\n"))
        context.exit()


@click.group(
    cls=_Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    params=[verbose_option()],
    epilog="The environment variable CLVOL_DEBUG=1 adds the Python traceback to errors. Exit status: 0 done, "
    "2 wrong input, 3 no working device, 4 rendering failed, 130 interrupted. 'clvol completion --help' explains "
    "completion in shells.",
)
@click.option(
    "--man", is_flag=True, is_eager=True, expose_value=False, callback=_print_manual,
    help="Print the manual page, to be read with: clvol --man | man -l -",
)
@click.version_option(__version__, prog_name="clvol", message="%(prog)s %(version)s")
@click.pass_context
def cli(context: click.Context) -> None:
    """Volume rendering that says how wrong its pictures are."""
    if context.invoked_subcommand is None:
        from clvol.cli.console import say

        say(context.get_help())


def run(arguments: Sequence[str]) -> int:
    """Runs the command line and returns the exit status. Errors are raised as exceptions."""
    if instruction := os.environ.get(COMPLETE):
        from click.shell_completion import shell_complete

        return shell_complete(cli, {}, "clvol", COMPLETE, instruction)
    try:
        with cli.make_context("clvol", list(arguments)) as context:
            cli.invoke(context)
        return 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.Abort:
        raise KeyboardInterrupt from None


def describe_error(error: Exception) -> tuple[int, str]:
    """The exit status and the message for an exception that ``run`` has raised."""
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
    hint = "" if os.environ.get("CLVOL_DEBUG") == "1" else " (set CLVOL_DEBUG=1 for the traceback)"
    return 4, f"internal: {type(error).__name__}: {error}{hint}"


def _one_command(given: str) -> str:
    return f"one of {', '.join(COMMANDS)}{_hint(given, COMMANDS)}; see 'clvol --help'"


def _hint(given: str, known: Sequence[str]) -> str:
    """The word of ``known`` that is most like ``given``, if any is."""
    from difflib import get_close_matches

    near = get_close_matches(given, known, n=1, cutoff=0.7) if len(given) <= _LONGEST_WORD else ()
    return f" (did you mean {near[0]!r}?)" if near else ""


def _options_of(context: click.Context | None) -> list[str]:
    """The long names of the options of a command."""
    if context is None:
        return []
    names = [name for parameter in context.command.get_params(context) if isinstance(parameter, click.Option)
             for name in (*parameter.opts, *parameter.secondary_opts)]  # fmt: skip
    return [name for name in names if name.startswith("--")]


def _usage_error(error: click.ClickException) -> ClvolError:
    """An error of click in the form of all other errors."""
    context = getattr(error, "ctx", None)
    command = context.command_path if context else "clvol"
    see = f"what '{command} --help' says"
    if isinstance(error, click.MissingParameter) and error.param is not None:
        name = error.param.opts[0] if error.param.opts[0].startswith("-") else ""
        metavar = str(error.param.metavar or error.param.name).removesuffix("...")
        wanted = " ".join(filter(None, [name, metavar]))
        return UsageError(command, f"no {wanted}", f"{wanted}; see '{command} --help'")
    if isinstance(error, click.NoSuchOption):
        known = _options_of(context)
        expected = f"one of {', '.join(known)}{_hint(error.option_name, known)}" if known else see
        return UsageError(command, f"unknown option {error.option_name}", expected)
    if isinstance(error, click.BadParameter) and error.param is not None:
        return UsageError(f"{command}: {error.param.opts[0]}", str(error.message).rstrip("."), see)
    return UsageError(command, error.format_message().rstrip("."), see)
