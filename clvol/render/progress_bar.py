"""Progress that shows itself, in notebooks and on terminals: ``renderer.render(progress=True)``."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager

from clvol.errors import UsageError
from clvol.integrators.base import Progress
from clvol.quietly import without_warnings

_DELAY = 1.0  # seconds before a bar is shown


@contextmanager
def shown(progress: Progress | bool | None, what: str) -> Iterator[Progress | None]:
    """Yields a function (done, total) that moves a bar with the remaining time, if ``progress`` is True; ``progress``
    itself, if it is a function; None for None and False. The bar is that of tqdm.auto: a widget in notebooks that have
    them, else text on stderr. It appears after a second.

    Raises UsageError where tqdm, of the extra "notebook", is not installed.
    """
    if progress is not True:
        yield progress or None
        return
    if importlib.util.find_spec("tqdm") is None:
        expected = "pip install 'clvol[notebook]', or a function (done, total)"
        raise UsageError("progress", "needs the package tqdm", expected)
    with without_warnings():  # that there are no widgets is no reason to warn
        from tqdm.auto import tqdm

    layout = "{desc}: {percentage:3.0f}%|{bar}| {elapsed} left {remaining}"
    with tqdm(total=1, desc=what, bar_format=layout, leave=False, delay=_DELAY) as bar:

        def move(done: int, total: int) -> None:
            if bar.total != total:
                bar.total = total
            bar.update(max(done - bar.n, 0))

        yield move
