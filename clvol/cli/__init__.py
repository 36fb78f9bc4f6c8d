"""The command ``clvol``: one module per command, imported when that command is called.

Exit status: 0 done; 2 wrong input; 3 no working device; 4 rendering failed; 130 interrupted; 143 ended by SIGTERM,
129 by SIGHUP (128 plus the signal's number for other signals that request an end). Every error is one line on stderr,
``clvol: error: WHERE: WHAT, expected WHAT``. Every warning is a line that begins with ``clvol: warning: ``; warnings
change neither the exit status nor the output. The environment variable CLVOL_DEBUG=1 adds the traceback.

Only this module is imported before the signal handlers are installed.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from clvol.interrupts import check_stopped, stoppable

INTERRUPTED = 130


def __getattr__(name: str):
    if name == "cli":  # the group of commands, imported on first use
        from clvol.cli.group import cli

        return cli
    raise AttributeError(f"module 'clvol.cli' has no attribute {name!r}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line (``sys.argv`` by default) and returns the exit status."""
    debug = os.environ.get("CLVOL_DEBUG") == "1"
    _open_standard()
    try:
        with stoppable(for_good=arguments is None):
            return _run(sys.argv[1:] if arguments is None else arguments, debug)
    except KeyboardInterrupt as stop:
        line = getattr(stop, "line", "interrupted")
        return _failed(line, getattr(stop, "status", INTERRUPTED), debug)


def _open_standard() -> None:
    """Opens the null device in place of standard input, output or error if they are closed. Otherwise the next file
    that is opened would get that descriptor, and the output of libraries would end up in a picture."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor


def _run(arguments: Sequence[str], debug: bool) -> int:
    with _warnings_kept(debug) as warned:
        try:
            from clvol.cli.group import describe_error, run

            status = run(arguments)
            for line in warned:
                _say_on_stderr("clvol: warning: ", line)
            return status
        except Exception as error:
            check_stopped()
            status, line = describe_error(error)
            return _failed(line, status, debug)


@contextmanager
def _warnings_kept(debug: bool) -> Iterator[dict[str, None]]:
    """Collects clvol's own warnings, and yields their lines. They are printed at the end, because a progress bar may be
    shown until then, and because an error must be a single line. Warnings of other packages are not shown."""
    import warnings

    from clvol.errors import ClvolWarning

    kept: dict[str, None] = {}
    with warnings.catch_warnings():
        if not (debug or sys.warnoptions):
            warnings.simplefilter("ignore")
        warnings.filterwarnings("always", category=ClvolWarning)
        show = warnings.showwarning

        def keep(message, category, *rest, **more) -> None:
            if issubclass(category, ClvolWarning):
                kept[str(message)] = None
            else:
                show(message, category, *rest, **more)

        warnings.showwarning = keep
        yield kept


def _failed(line: str, status: int, debug: bool) -> int:
    say_error(line, debug)
    return status


def say_error(line: str, debug: bool | None = None) -> None:
    """Prints the error that is being handled on stderr, as one line. ``debug``: with its traceback; None: where
    CLVOL_DEBUG requests it."""
    if os.environ.get("CLVOL_DEBUG") == "1" if debug is None else debug:
        import traceback

        from clvol.text import printable_lines

        _write_on_stderr(printable_lines(traceback.format_exc()))
    _say_on_stderr("clvol: error: ", line)


def _say_on_stderr(head: str, line: str) -> None:
    """Prints one line on stderr, with control characters as escapes."""
    from clvol.text import one_line

    _write_on_stderr(f"{head}{one_line(line)}\n")


def _write_on_stderr(text: str) -> None:
    try:
        if sys.stderr is not None:
            sys.stderr.write(text.encode(_encoding(), "backslashreplace").decode(_encoding()))
            sys.stderr.flush()
    except (OSError, ValueError):  # stderr is closed, or its reader has gone away
        pass


def _encoding() -> str:
    return getattr(sys.stderr, "encoding", None) or "utf-8"
