"""Workers of this machine: processes that are replaced when they die, at whatever moment, as dask's own are not when
they die before they have started."""

from __future__ import annotations

import os
import selectors
import subprocess
import threading
import time
from contextlib import suppress
from pathlib import Path

from clvol.errors import RenderError
from clvol.opencl.children import begin_tied_child, child_environment, end_child

MOST_EARLY_DEATHS = 5  # of processes in a row that end before they are there
_END_SECONDS = 3.0
_PROCESS = Path(__file__).with_name("process.py")


class _Process:
    """``early_deaths``: of processes in its place that ended, one after the other, before they were there."""

    def __init__(self, scheduler: str, scratch: str, early_deaths: int) -> None:
        request = {"scheduler": scheduler, "scratch": scratch}
        try:
            self.process, self._lifeline = begin_tied_child(_PROCESS, request, child_environment())
        except OSError as error:
            raise RenderError("--workers", f"processes cannot be started: {error.strerror}") from None
        assert self.process.stdout is not None
        self.output, self.early_deaths, self.is_there = self.process.stdout, early_deaths, False

    def end(self, seconds: float = 0.0) -> None:
        """Ends it, after it has had ``seconds`` to end by itself."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout=seconds)
        end_child(self.process)
        os.close(self._lifeline)
        self.output.close()


class LocalWorkers:
    """``count`` processes, workers of the scheduler at the address ``scheduler``, which listen on the loopback address
    only. A thread replaces those that end. ``scratch``: a folder for what dask keeps on disk."""

    def __init__(self, scheduler: str, count: int, scratch: str) -> None:
        self._scheduler, self._scratch = scheduler, scratch
        self._selector = selectors.DefaultSelector()
        self._changed = threading.Condition()
        self._processes: list[_Process] = []
        self._first_is_there = self._is_closing = False
        self._wake, self._woken = os.pipe()[::-1]
        self._selector.register(self._woken, selectors.EVENT_READ)
        try:
            for _ in range(count):
                self._begin(0)
        except BaseException:
            self.close()
            raise
        self._thread = threading.Thread(target=self._keep, name="clvol-workers", daemon=True)
        self._thread.start()

    def wait_for_one(self, seconds: float) -> None:
        """Returns once a worker is there. RenderError if none is after ``seconds``, or if none can be."""
        with self._changed:
            self._changed.wait_for(lambda: self._first_is_there or not self._processes, seconds)
            if not self._first_is_there:
                raise RenderError("--workers", "processes end, or take too long, before they are there")

    def stop_replacing(self) -> None:
        """From now on processes that end are not replaced."""
        if not self._is_closing:
            self._is_closing = True
            os.write(self._wake, b"\n")
            thread = getattr(self, "_thread", None)
            if thread is not None:
                thread.join()

    def close(self) -> None:
        """Ends all of them; those that end by themselves within seconds, since their scheduler has closed, may."""
        self.stop_replacing()
        until = time.monotonic() + _END_SECONDS
        for each in self._processes:
            each.end(max(until - time.monotonic(), 0.0))
        self._processes.clear()
        self._selector.close()
        os.close(self._wake)
        os.close(self._woken)

    def _begin(self, early_deaths: int) -> None:
        begun = _Process(self._scheduler, self._scratch, early_deaths)
        self._processes.append(begun)
        self._selector.register(begun.output, selectors.EVENT_READ, begun)

    def _keep(self) -> None:
        while not self._is_closing:
            for key, _ in self._selector.select():
                if key.data is not None:
                    self._hear(key.data)

    def _hear(self, each: _Process) -> None:
        if os.read(each.output.fileno(), 64):
            each.is_there, each.early_deaths = True, 0
            with self._changed:
                self._first_is_there = True
                self._changed.notify_all()
            return
        self._selector.unregister(each.output)
        deaths = 0 if each.is_there else each.early_deaths + 1
        with self._changed:  # whoever waits must not see the moment in which it is not replaced yet
            self._processes.remove(each)
            if not self._is_closing and deaths < MOST_EARLY_DEATHS:
                with suppress(RenderError):  # then the others go on without it
                    self._begin(deaths)
            self._changed.notify_all()
        each.end()
