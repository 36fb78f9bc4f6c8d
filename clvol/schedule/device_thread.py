"""A thread per device, which does not keep the process alive: a driver may never return from a call."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any


class DeviceThread:
    """Runs what is submitted, one after the other. (Python waits at its exit for the threads of a
    ``ThreadPoolExecutor``, for ever if one is in a driver that hangs.)"""

    def __init__(self, name: str) -> None:
        self._queue: SimpleQueue[tuple[Future, Callable[..., Any], tuple] | None] = SimpleQueue()
        threading.Thread(target=_run, args=(self._queue,), name=name, daemon=True).start()

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future:
        future: Future = Future()
        self._queue.put((future, work, arguments))
        return future

    def close(self) -> None:
        """Ends the thread after what was submitted, without waiting for it."""
        self._queue.put(None)


def _run(queue: SimpleQueue) -> None:
    while (task := queue.get()) is not None:
        future, work, arguments = task
        try:
            future.set_result(work(*arguments))
        except BaseException as error:
            future.set_exception(error)
        del task, future, work, arguments  # nothing of a frame is kept until the next one
