"""Prints the output of commands: results on stdout, progress on stderr."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import click

from clvol.errors import RenderError
from clvol.json_values import plain
from clvol.text import json_escaped, printable, printable_lines


class ShowProgress(Protocol):
    """Moves a progress display: ``done`` of ``total`` (None: unknown), and ``what`` is being done, if that changes."""

    def __call__(self, done: int | None, total: int | None, what: str | None = None) -> None: ...


def say(text: str) -> None:
    """Prints ``text`` on stdout, with control characters except line breaks as escapes. A reader that has gone away is
    not an error, but a full disk is one."""
    try:
        click.echo(_encodable(printable_lines(text), sys.stdout))
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        _silence()
    except OSError as error:
        _silence()
        raise RenderError("standard output", f"cannot be written ({error.strerror})") from None


def say_json(value: Any) -> None:
    say(to_json(value))


def say_path(path: str | os.PathLike) -> None:
    """Prints the name of a file that was written, on a line of its own."""
    say(printable(os.fspath(path)))


def note(text: str) -> None:
    """Prints one line on stderr, in addition to the result. A closed stderr is not an error."""
    try:
        click.echo(_encodable(printable(text), sys.stderr), err=True)
    except OSError:
        pass


def to_json(value: Any) -> str:
    """``value`` as JSON. Numpy numbers become numbers, infinities and NaN become null, and characters that are not
    printable become escapes."""
    return json_escaped(json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False))


def say_table(rows: Iterable[tuple[str, str]]) -> None:
    """Prints names and values in two columns, one pair per line."""
    rows = [(printable(name), printable(value)) for name, value in rows]
    width = max((len(name) for name, _ in rows), default=0)
    say("\n".join(f"{name:<{width}}  {value}".rstrip() for name, value in rows))


@contextmanager
def working(
    message: str, quiet: bool, reads: Sequence[str | os.PathLike] = ()
) -> Iterator[ShowProgress | None]:
    """Shows ``message`` and a clock on stderr while the block runs, if stderr is a terminal.

    Yields None if nothing is shown. Otherwise it yields a function of (done, total), which turns the display into a
    bar with the remaining time; its optional third argument says what is being done. ``reads``: files and folders that
    are read meanwhile; the bar then shows how much of them has been read.
    """
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import (
        BarColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(escape(printable(message)), total=None)

        def update(done: int | None, total: int | None, what: str | None = None) -> None:
            description = None if what is None else escape(printable(what))
            progress.update(task, total=total, completed=done, description=description)

        if not reads:
            yield update
            return
        from clvol.cli.reading import reported

        with reported(reads, update):
            yield update


def preparing(
    progress: ShowProgress | None, *, encodes: bool, by_blocks: bool
) -> Callable[[int, int], None] | None:
    """The ``progress`` of ``Renderer``, which reports voxels being encoded, or blocks being read; None where no
    progress is shown, or where the scene does neither."""
    if progress is None or not (encodes or by_blocks):
        return None
    what = "encoding voxels" if encodes else "reading blocks"
    return lambda done, total: progress(done, total, what)


def _encodable(text: str, stream: Any) -> str:
    """``text`` with escapes for characters that the stream's encoding lacks."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def _silence() -> None:
    """Discards all further output on stdout, including the flush at exit."""
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
    except (OSError, ValueError, AttributeError):
        pass
