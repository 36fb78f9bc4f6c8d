"""Standard output as the file "-": the bytes of one output, and nothing else."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout

from clvol.errors import RenderError, UsageError

STANDARD = "-"


def is_standard(path: str | None) -> bool:
    return path == STANDARD


def check_standard(pictures: int, texts: int) -> None:
    """Raises UsageError if more than one output is "-", or if a picture would be written to a terminal."""
    if pictures + texts > 1:
        raise UsageError(STANDARD, "is given twice as an output", "standard output for one of them")
    if pictures and sys.stdout is not None and sys.stdout.isatty():
        raise UsageError(STANDARD, "standard output is a terminal", "a pipe, or the name of a file")


@contextmanager
def kept_clean(used: bool) -> Iterator[Callable[[bytes], None]]:
    """Yields a function that writes bytes to standard output. If ``used``, all else that this process prints there
    inside the block, libraries included, goes to standard error."""
    if not used:
        yield _to_stdout
        return
    _flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield lambda data: _write(kept, data)
    finally:
        _flush()
        os.dup2(kept, 1)
        os.close(kept)


def _to_stdout(data: bytes) -> None:
    _flush()
    _write(1, data)


def _write(descriptor: int, data: bytes) -> None:
    """Writes all of ``data``. A reader that has gone away is not an error, but a full disk is one."""
    rest = memoryview(data)
    try:
        while rest:
            rest = rest[os.write(descriptor, rest) :]
    except BrokenPipeError:
        pass
    except OSError as error:
        raise RenderError("standard output", f"cannot be written ({error.strerror})") from None


def _flush() -> None:
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except (OSError, ValueError):  # its reader has gone away
        pass
