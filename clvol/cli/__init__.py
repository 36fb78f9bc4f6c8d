"""The command ``clvol``: one module a command, imported when that command is called.

Exit status: 0 done; 2 the input is wrong; 3 no device works; 4 the render failed; 130 interrupted;
143 ended by SIGTERM, 129 by SIGHUP (128 plus the signal's number for others that ask for an end).
Every error is one line on stderr, ``clvol: error: WHERE: WHAT, expected WHAT``. The environment
variable CLVOL_DEBUG=1 adds the traceback.

Nothing but this is imported before signals are looked after.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from clvol.interrupts import check_stopped, stoppable

COMMANDS = ("render", "explain", "info", "store", "doctor", "compare", "tradeoff")
INTERRUPTED = 130


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
    """Where standard input, output or error is closed, nothing else that is opened may get its
    number: what libraries print would go into a picture."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free


def _run(given: Sequence[str], debug: bool) -> int:
    import warnings

    with warnings.catch_warnings():
        if not (debug or sys.warnoptions):
            warnings.simplefilter("ignore")  # libraries' warnings; errors take one line alone
        try:
            from clvol.cli.group import run, told

            return run(given)
        except Exception as error:
            check_stopped()
            status, line = told(error)
            return _failed(line, status, debug)


def _failed(line: str, status: int, debug: bool) -> int:
    from clvol.text import one_line, printable_lines

    said = f"clvol: error: {one_line(line)}\n"
    if debug:
        import traceback

        said = printable_lines(traceback.format_exc()) + said
    try:
        if sys.stderr is not None:
            sys.stderr.write(said.encode(_encoding(), "backslashreplace").decode(_encoding()))
            sys.stderr.flush()
    except (OSError, ValueError):  # nobody listens on stderr, or it is closed
        pass
    return status


def _encoding() -> str:
    return getattr(sys.stderr, "encoding", None) or "utf-8"
