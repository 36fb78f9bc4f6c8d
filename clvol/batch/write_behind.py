"""Writing pictures in a thread, while the next one is rendered."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType


class WriteBehind:
    """Does work in a thread, one piece at a time and in order: what is added waits until the piece before is done.

    What a piece raises is raised by the next call, or at the end of the block. The block ends when all is done, also if
    it ends early: what a finished frame is written to is then whole.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "clvol-write")
        self._pending: Future[None] | None = None

    def add(self, work: Callable[[], None]) -> None:
        self.finish()
        self._pending = self._thread.submit(work)

    def finish(self) -> None:
        """Waits for what was added."""
        pending, self._pending = self._pending, None
        if pending is not None:
            pending.result()

    def __enter__(self) -> WriteBehind:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        self._thread.shutdown()
        if kind is None:
            self.finish()
