"""Compressed files of several volumes, read one volume after another: what was decoded is not decoded again.

Without it each volume of a series would take decoding all of the file before it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import IO

Blocks = Iterator[bytes]


class ForwardReader:
    """One stream of decoded bytes, which stays open between volumes."""

    def __init__(self) -> None:
        self._key: object = None
        self._blocks: Blocks = iter(())
        self._file: IO[bytes] | None = None
        self._position = 0  # in the decoded bytes, of what ``_pending`` begins with
        self._pending = b""

    def read(self, key: object, start: int, view: memoryview, opened: Callable[[], tuple[IO[bytes], Blocks]]) -> int:
        """Fills ``view`` with the decoded bytes from ``start`` on, and returns how many there were. ``opened()``
        returns the file, and its blocks from the beginning; ``key`` tells streams apart. Raises what decoding raises.
        """
        if key != self._key or start < self._position:
            self.close()
            self._file, self._blocks = opened()
            self._key = key
        got = 0
        try:
            while got < len(view):
                if not self._pending:
                    self._pending = next(self._blocks, b"")
                    if not self._pending:
                        break
                skip = min(start - self._position, len(self._pending)) if not got else 0
                part = self._pending[skip : skip + len(view) - got]
                view[got : got + len(part)] = part
                got += len(part)
                self._pending = self._pending[skip + len(part) :]
                self._position += skip + len(part)
        except BaseException:
            self.close()
            raise
        return got

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
        self._key, self._blocks, self._file, self._position, self._pending = None, iter(()), None, 0, b""


_current: ContextVar[ForwardReader | None] = ContextVar("forward", default=None)


def current_forward() -> ForwardReader | None:
    """That of the series that is being read; None where a single volume is."""
    return _current.get()


@contextmanager
def forward(reader: ForwardReader) -> Iterator[None]:
    """A context in which volumes are read one after another by ``reader``."""
    token = _current.set(reader)
    try:
        yield
    finally:
        _current.reset(token)
