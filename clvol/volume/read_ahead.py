"""Two volumes of a series in memory: the one that is used, and the next one, which a thread reads."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextvars import copy_context
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clvol.volume.volume import Volume


class _Reading:
    """One volume being read by a thread. Threads are daemons: a process that ends does not wait for the file."""

    def __init__(self, number: int, read: Callable[[int], Volume]) -> None:
        self.number = number
        self._volume: Volume | None = None
        self._error: BaseException | None = None
        self._read = read
        context = copy_context()
        self._thread = threading.Thread(target=context.run, args=(self._work,), name="clvol-series", daemon=True)
        self._thread.start()

    def _work(self) -> None:
        try:
            self._volume = self._read(self.number)
        except BaseException as error:  # raised where the volume is taken
            self._error = error

    def wait(self) -> None:
        """Returns once it has ended. An interrupt of the main thread gets through."""
        while self._thread.is_alive():
            self._thread.join(0.2)

    def result(self) -> Volume:
        self.wait()
        if self._error is not None:
            raise self._error
        assert self._volume is not None
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
            self._next = _Reading(number, self._read)

    def close(self) -> None:
        """Lets go of both."""
        with self._lock:
            if self._next is not None:
                self._next.wait()
            self._next = self._current = None
