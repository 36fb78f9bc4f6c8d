"""Threads that share the items of a job among devices: rays, blocks to encode.

A thread per device takes packages of items from a ``Dispatcher`` until all are done. A device that fails is left out;
what it has done stays done, and the rest goes to the others. One that does not return from its package is not waited
for: others do it. (Pictures, whose tiles may be lost with a device, have ``clvol.render.picture_stage``.)
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future
from concurrent.futures import wait as wait_for
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from clvol.errors import ClvolError, ClvolWarning
from clvol.schedule.device_thread import DeviceThread
from clvol.schedule.dispatch import Dispatcher, Package

_TICK = 0.1  # seconds between calls of a progress function
_PATIENCE = 0.1  # seconds for devices whose last package another one has done meanwhile,
_STOPPING = 10.0  # and for all of them if the job is interrupted


class Hand(Protocol):
    """A device in a job."""

    def begin(self) -> None:
        """Called once, before the first package."""

    def work(self, items: np.ndarray) -> tuple[np.ndarray, Any]:
        """Does ``items`` (numbers). Returns what each cost (float64 [items], in the dispatcher's unit, the same on all
        devices), and the result. ClvolError or MemoryError if the device fails."""
        ...


class Crew:
    """Threads for devices, which are kept from job to job."""

    def __init__(self) -> None:
        self._threads: dict[int, DeviceThread] = {}
        self._working: dict[int, Future] = {}

    def submit(self, device: int, work: Callable[..., Any], *arguments: Any) -> Future:
        if device not in self._threads:
            self._threads[device] = DeviceThread(f"clvol-device-{device}")
        self._working[device] = self._threads[device].submit(work, *arguments)
        return self._working[device]

    def is_busy(self, device: int) -> bool:
        """Whether it has not returned from an earlier job, which others have ended."""
        return device in self._working and not self._working[device].done()

    def wait_for_one(self, devices: Sequence[int]) -> None:
        """Returns once one of ``devices`` is not busy."""
        while devices and all(map(self.is_busy, devices)):
            wait_for([self._working[device] for device in devices], 1.0, FIRST_COMPLETED)

    def close(self) -> None:
        """Waits a moment for devices that work."""
        wait_for(self._working.values(), _PATIENCE)
        for thread in self._threads.values():
            thread.close()
        self._threads.clear()


class Job:
    """The items of ``dispatcher``, done by ``hands`` (by number of the device).

    ``take(items, result)`` is called for each package whose result counts: another device may have been first.
    ``lost(device, error)`` is called when a device fails; it raises if no device is left. Both are called by one thread
    at a time.
    """

    def __init__(
        self,
        crew: Crew,
        dispatcher: Dispatcher,
        hands: Mapping[int, Hand],
        take: Callable[[np.ndarray, Any], None],
        lost: Callable[[int, BaseException], None],
    ) -> None:
        self._crew, self._dispatcher, self._hands = crew, dispatcher, hands
        self._take, self._on_lost = take, lost
        self._changed = threading.Condition()
        self._items_done = 0
        self._error: BaseException | None = None
        self._ended = False

    def run(self, report: Callable[[int], None] | None = None) -> None:
        """Returns once all items are done. ``report(items done)`` is called now and then; what it raises ends the job.
        Raises what ``lost`` raises if no device is left, and what is no failure of a device."""
        futures = [self._crew.submit(k, self._work, k) for k in self._hands if self._dispatcher.alive(k)]
        patience = _STOPPING
        try:
            self._watch(report)
            patience = _PATIENCE if self._error is None else _STOPPING
        finally:
            self._end()
            wait_for(futures, patience)
        if self._error is not None:
            raise self._error

    def _watch(self, report: Callable[[int], None] | None) -> None:
        reported = -1
        with self._changed:
            while not (self._ended or self._dispatcher.complete):
                self._changed.wait(_TICK)
                if report is not None and self._items_done != reported:
                    reported = self._items_done
                    report(reported)
        if report is not None and self._error is None:
            report(self._dispatcher.count)

    def _end(self, error: BaseException | None = None) -> None:
        with self._changed:
            self._error = self._error or error
            self._ended = True
            self._changed.notify_all()

    def _work(self, device: int) -> None:
        """The thread of one device."""
        hand = self._hands[device]
        try:
            hand.begin()
            while (package := self._next(device)) is not None:
                costs, result = hand.work(package.tiles)
                self._finished(package, costs, result)
        except (ClvolError, MemoryError) as error:
            self._lost(device, error)
        except BaseException as error:  # a fault of the program: the caller gets it
            self._end(error)

    def _next(self, device: int) -> Package | None:
        """The next package, waited for while other devices may still fail; None at the end."""
        with self._changed:
            while not (self._ended or self._dispatcher.complete):
                now = perf_counter()
                package = self._dispatcher.next(device, now)
                if package is not None:
                    return package
                self._changed.wait(min(max(self._dispatcher.ask_again(now), 1e-3), 1.0))
            return None

    def _finished(self, package: Package, costs: np.ndarray, result: Any) -> None:
        with self._changed:
            if self._ended:  # nobody takes it any more
                return
            if self._dispatcher.finished(package, perf_counter(), costs):
                self._take(package.tiles, result)
                self._items_done += len(package.tiles)
            self._changed.notify_all()

    def _lost(self, device: int, error: BaseException) -> None:
        with self._changed:
            self._dispatcher.lost(device, str(error))
            try:
                self._on_lost(device, error)
            except BaseException as last:
                self._error, self._ended = last, True
            self._changed.notify_all()


class Team:
    """Devices that share jobs of one kind, one after another: rays of the reference, blocks to encode. Remembers how
    fast they are, and which have failed. For one thread at a time.

    ``names``: of the devices. ``speed``: in cost per second, as a first guess; ``launch``: seconds per package.
    ``least``: items that a package has at least.
    """

    def __init__(self, names: Sequence[str], speed: float, launch: float, least: int = 1) -> None:
        self.names, self.lost = list(names), dict[int, str]()
        self._speeds = [speed] * len(self.names)
        self._launch, self._least = launch, least
        self._crew = Crew()
        self._last_error: BaseException | None = None
        self._told: set[int] = set()

    def close(self) -> None:
        self._crew.close()

    def run(
        self,
        hands: Sequence[Hand],
        costs: np.ndarray,
        take: Callable[[np.ndarray, Any], None],
        report: Callable[[int], None] | None = None,
        on_loss: Callable[[int, BaseException], None] | None = None,
    ) -> None:
        """Has ``hands``, one per device, do the items, whose expected ``costs`` are float64 [items].
        ``take(items, result)`` gets every result that counts, by one thread at a time; ``report``: as ``Job.run``.

        A ClvolWarning names a device that fails, or ``on_loss(device, error)`` is called; the error of the last one is
        raised. What a device has done stays done when it fails.
        """
        launches = [self._launch] * len(hands)
        dispatcher = Dispatcher(costs, self._speeds, launches, least_tiles=self._least)
        working = [k for k in range(len(hands)) if k not in self.lost]
        if not working and self._last_error is not None:  # the last one failed after a job that others had ended
            raise self._last_error
        self._crew.wait_for_one(working)
        for device in range(len(hands)):
            if device in self.lost or self._crew.is_busy(device):
                dispatcher.lost(device, self.lost.get(device, "busy"))

        def lost(device: int, error: BaseException) -> None:
            self.leave_out(device, error, on_loss)

        Job(self._crew, dispatcher, dict(enumerate(hands)), take, lost).run(report)
        for device, share in enumerate(dispatcher.shares):
            if share.packages:
                self._speeds[device] = share.speed
        self._tell()

    def leave_out(
        self, device: int, error: BaseException, on_loss: Callable[[int, BaseException], None] | None = None
    ) -> None:
        """``device`` has failed; raises ``error`` if it was the last one. ``on_loss``: as in ``run``."""
        self.lost[device], self._last_error = str(error), error
        if on_loss is not None:
            self._told.add(device)
            on_loss(device, error)
        if len(self.lost) == len(self.names):
            raise error

    def free_device(self) -> int:
        """One that works and is not busy, waited for if need be."""
        working = [k for k in range(len(self.names)) if k not in self.lost]
        self._crew.wait_for_one(working)
        return next(k for k in working if not self._crew.is_busy(k))

    def _tell(self) -> None:
        left = [name for device, name in enumerate(self.names) if device not in self.lost]
        for device, reason in self.lost.items():
            if device not in self._told:
                self._told.add(device)
                warnings.warn(left_out(self.names[device], reason, left), stacklevel=3)


def left_out(name: str, reason: str, left: Sequence[str]) -> ClvolWarning:
    """The warning that a device has failed; ``left``: those that have done its work."""
    what = f"failed and is left out from now on ({' '.join(reason.split())})"
    return ClvolWarning(f"device {name}", what, f"nothing: {' and '.join(left)} did its work")
