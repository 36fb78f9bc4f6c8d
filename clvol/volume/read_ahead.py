"""Two volumes of a series in memory: the one that is used, and the next one, which a thread reads."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextvars import copy_context
from functools import partial
from queue import SimpleQueue
from typing import TYPE_CHECKING
from weakref import finalize

if TYPE_CHECKING:
    from clvol.volume.volume import Volume


class _Worker:
    """A thread that does what it is given, one after the other. It is always the same one, so that the allocator, which
    keeps memory for every thread, takes for a volume what an earlier one has left. It is a daemon: a process that ends
    does not wait for a file."""

    def __init__(self) -> None:
        self.queue: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread = threading.Thread(target=_serve, args=(self.queue,), name="clvol-series", daemon=True)
        self._thread.start()
        finalize(self, self.queue.put, None).atexit = False

    @property
    def is_alive(self) -> bool:
        return self._thread.is_alive()


def _serve(queue: SimpleQueue[Callable[[], None] | None]) -> None:
    while (work := queue.get()) is not None:
        work()
        del work  # with the volume that it has read


class _Reading:
    """One volume being read by the thread of ``worker``."""

    def __init__(self, number: int, read: Callable[[int], Volume], worker: _Worker) -> None:
        self.number = number
        self._volume: Volume | None = None
        self._error: BaseException | None = None
        self._read, self._worker, self._done = read, worker, threading.Event()
        worker.queue.put(partial(copy_context().run, self._work))

    def _work(self) -> None:
        try:
            self._volume = self._read(self.number)
        except BaseException as error:  # raised where the volume is taken
            self._error = error
        finally:
            self._done.set()

    def wait(self) -> None:
        """Returns once it has ended. An interrupt of the main thread gets through."""
        while not self._done.wait(0.2) and self._worker.is_alive:
            pass

    def result(self) -> Volume:
        self.wait()
        if self._error is not None:
            raise self._error
        if self._volume is None:  # in a process that was forked while the thread was reading
            return self._read(self.number)
        return self._volume


class ReadAhead:
    """``read(number)`` reads a volume. At most one is kept beside the one that is being read, or has been read ahead.

    Any thread may call this; they take turns.
    """

    def __init__(self, read: Callable[[int], Volume]) -> None:
        self._read = read
        self._lock = threading.RLock()
        self._current: tuple[int, Volume] | None = None
        self._next: _Reading | None = None
        self._worker: _Worker | None = None
        self.reads = 0
        self.ready = 0  # volumes that had been read ahead, or begun, when they were used

    def current(self, number: int) -> Volume | None:
        """Volume ``number`` if it is the one in use; it is not read."""
        current = self._current
        return current[1] if current is not None and current[0] == number else None

    def take(self, number: int) -> Volume:
        """Volume ``number``, which becomes the one in use."""
        with self._lock:
            if self._current is not None and self._current[0] == number:
                return self._current[1]
            reading, self._next = self._next, None
            if reading is not None and reading.number == number:
                self.ready += 1
                volume = reading.result()
            else:
                if reading is not None:
                    reading.wait()
                    del reading  # its voxels are not needed
                self.reads += 1
                volume = self._read(number)
            self._current = number, volume
            return volume

    def put(self, number: int, volume: Volume) -> None:
        """``volume``, which someone else has read, becomes the one in use."""
        with self._lock:
            self._current = number, volume

    def begin(self, number: int) -> None:
        """Begins to read volume ``number`` in a thread, unless it is at hand or another one is still being read."""
        with self._lock:
            if self._current is not None and self._current[0] == number:
                return
            if self._next is not None:
                if self._next.number == number:
                    return
                self._next.wait()
                self._next = None
            self.reads += 1
            if self._worker is None or not self._worker.is_alive:
                self._worker = _Worker()
            self._next = _Reading(number, self._read, self._worker)

    def close(self) -> None:
        """Lets go of both."""
        with self._lock:
            if self._next is not None:
                self._next.wait()
            self._next = self._current = None
