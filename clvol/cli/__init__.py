"""The command ``clvol``: one module per command, imported when that command is called.

Exit status: 0 done; 2 the input is wrong; 3 no device works; 4 the render failed; 130 interrupted;
143 ended by SIGTERM, 129 by SIGHUP (128 plus the signal's number for others that ask for an end).
Every error is one line on stderr, ``clvol: error: WHERE: WHAT, expected WHAT``, and every warning one that begins
``clvol: warning: ``; warnings change neither the status nor what is written. The environment variable CLVOL_DEBUG=1
adds the traceback.

Nothing but this is imported before signals are looked after.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from clvol.interrupts import check_stopped, stoppable

INTERRUPTED = 130


def __getattr__(name: str):
    if name == "cli":  # the group of commands, once somebody asks
        from clvol.cli.group import cli

        return cli
    raise AttributeError(f"module 'clvol.cli' has no attribute {name!r}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (``sys.argv`` by default) and return the exit status."""
    debug = os.environ.get("CLVOL_DEBUG") == "1"
    _open_standard()
    try:
        with stoppable(for_good=arguments is None):
            return _run(sys.argv[1:] if arguments is None else arguments, debug)
    except KeyboardInterrupt as stop:
        line = getattr(stop, "line", "interrupted")
        return _failed(line, getattr(stop, "status", INTERRUPTED), debug)


def _open_standard() -> None:
    """Opens the null device wherever standard input, output or error is closed: otherwise the next file that is
    opened would get its number, and what libraries print would end up in a picture."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free


def _run(given: Sequence[str], debug: bool) -> int:
    with _warnings_kept(debug) as warned:
        try:
            from clvol.cli.group import run, told

            status = run(given)
            for line in warned:
                _say_on_stderr("clvol: warning: ", line)
            return status
        except Exception as error:
            check_stopped()
            status, line = told(error)
            return _failed(line, status, debug)


@contextmanager
def _warnings_kept(debug: bool) -> Iterator[dict[str, None]]:
    """Yields the lines of clvol's own warnings. They are printed at the end, because a progress bar may be on the
    screen until then, and because an error is one line alone. Warnings of other packages are not shown."""
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
    if debug:
        import traceback

        from clvol.text import printable_lines

        _write_on_stderr(printable_lines(traceback.format_exc()))
    _say_on_stderr("clvol: error: ", line)
    return status


def _say_on_stderr(head: str, line: str) -> None:
    """One line, in which nothing can move a terminal's cursor."""
    from clvol.text import one_line

    _write_on_stderr(f"{head}{one_line(line)}\n")


def _write_on_stderr(text: str) -> None:
    try:
        if sys.stderr is not None:
            sys.stderr.write(text.encode(_encoding(), "backslashreplace").decode(_encoding()))
            sys.stderr.flush()
    except (OSError, ValueError):  # nobody listens on stderr, or it is closed
        pass


def _encoding() -> str:
    return getattr(sys.stderr, "encoding", None) or "utf-8"
