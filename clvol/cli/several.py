"""Several inputs in one call: names of outputs with {stem}, and one failure that does not stop the others."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence

import click

from clvol.batch.names import stem_of
from clvol.errors import UsageError

STEM = "{stem}"


def filled(path: str, source: str) -> str:
    """``path`` with {stem} replaced by that of ``source``."""
    return path.replace(STEM, stem_of(source))


def check_names(sources: Sequence[str], outputs: Sequence[str | None]) -> None:
    """Raises UsageError, before the work, if several ``sources`` would be written to one file."""
    if len(sources) < 2:
        return
    for path in outputs:
        if path is None:
            continue
        if STEM not in path:
            stem, ending = os.path.splitext(path)
            example = "out/{stem}.png" if path == "-" else f"{stem}_{STEM}{ending}"
            raise UsageError(path, f"one name for {len(sources)} inputs", f"a name with {STEM}, as in {example!r}")
        taken: dict[str, str] = {}
        for source in sources:
            place = os.path.realpath(filled(path, source))
            if place in taken:
                what = f"{taken[place]} and {source} are both written to {filled(path, source)!r}"
                raise UsageError(path, what, "inputs whose names differ, or calls of their own")
            taken[place] = source


def each_of(sources: Sequence[str], work: Callable[[str], None]) -> None:
    """Calls ``work`` with every source. With several, an error is printed and the others go on; the exit status is the
    largest of theirs at the end. An interrupt ends all."""
    if len(sources) == 1:
        work(sources[0])
        return
    from clvol.cli import say_error
    from clvol.cli.group import describe_error
    from clvol.interrupts import check_stopped

    worst = 0
    for source in sources:
        try:
            work(source)
        except Exception as error:
            check_stopped()
            status, line = describe_error(error)
            say_error(line)
            worst = max(worst, status)
    if worst:
        raise click.exceptions.Exit(worst)
