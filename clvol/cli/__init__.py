"""The command ``clvol``: one module a command, imported when that command is called.

Exit status: 0 done; 2 the input is wrong; 3 no device works; 4 the render failed; 130 interrupted.
Every error is one line on stderr, ``clvol: error: WHERE: WHAT, expected WHAT``, and every warning one that begins
``clvol: warning: ``; warnings change neither the status nor what is written. The environment variable CLVOL_DEBUG=1
adds the traceback.
"""

from __future__ import annotations

import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module

import click

from clvol import __version__
from clvol.errors import ClvolError, ClvolWarning, RenderError, UsageError

COMMANDS = ("render", "explain", "info", "store", "doctor", "compare", "tradeoff")
INTERRUPTED = 130


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (``sys.argv`` by default) and return the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    debug = os.environ.get("CLVOL_DEBUG") == "1"
    with _warnings_kept(debug) as told:
        try:
            with cli.make_context("clvol", given) as context:
                cli.invoke(context)
            for line in told:
                _say_on_stderr("clvol: warning: " + line)
            return 0
        except click.exceptions.Exit as stop:
            return stop.exit_code
        except (KeyboardInterrupt, click.Abort):
            return _failed("interrupted", INTERRUPTED, debug)
        except click.ClickException as error:
            return _failed(str(_usage_error(error)), UsageError.exit_status, debug)
        except ClvolError as error:
            return _failed(str(error), error.exit_status, debug)
        except MemoryError:
            line = "memory: not enough for this scene, expected a smaller volume or image"
            return _failed(line, RenderError.exit_status, debug)
        except Exception as error:
            return _failed(f"internal: {type(error).__name__}: {error}", 4, debug)


@contextmanager
def _warnings_kept(debug: bool) -> Iterator[dict[str, None]]:
    """Yields the lines of clvol's own warnings, to be told at the end: a bar may be drawn meanwhile, and an error
    is one line alone. Of others none is shown."""
    told: dict[str, None] = {}
    with warnings.catch_warnings():
        if not (debug or sys.warnoptions):
            warnings.simplefilter("ignore")
        warnings.filterwarnings("always", category=ClvolWarning)
        show = warnings.showwarning

        def keep(message, category, *rest, **more) -> None:
            if issubclass(category, ClvolWarning):
                told[str(message)] = None
            else:
                show(message, category, *rest, **more)

        warnings.showwarning = keep
        yield told


def _failed(line: str, status: int, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    _say_on_stderr("clvol: error: " + line)
    return status


def _say_on_stderr(line: str) -> None:
    """One line, in which nothing can move a terminal's cursor."""
    line = " ".join(line.split())
    shown = "".join(c if c.isprintable() else repr(c)[1:-1] for c in line)
    try:
        click.echo(shown, err=True)
    except OSError:  # nobody listens on stderr
        pass


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
