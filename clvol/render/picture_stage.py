"""A stage of a picture that devices share: what each device's thread does until all tiles are in the arrays.

A device that has shared its last tile may still fail while its pixels are fetched, so nobody leaves before all is
fetched: then its tiles are rendered by others. Nothing of a lost package is counted.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import wait as wait_for
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from clvol.errors import ClvolError
from clvol.integrators.base import PartOfPicture, PictureArrays, TiledPictureParts
from clvol.render.frame_schedule import Schedule, Span
from clvol.render.member import Member
from clvol.schedule.device_thread import DeviceThread
from clvol.schedule.dispatch import Dispatcher, Package

FAILURES = (ClvolError, MemoryError)  # of a device; anything else is a fault of the program
_TICK = 0.1  # seconds between calls of a progress function
_PATIENCE = 0.1  # seconds for devices whose last package another one has done meanwhile,
_STOPPING = 10.0  # and for all of them if the frame is interrupted
_FETCH_PATIENCE = 1.0  # seconds, and this many per byte, after which fetching counts as stalled
_FETCH_SECONDS = 5e-9
_HUNG = 60.0  # seconds, and this many times the expected time, after which a process of its own is ended
_HUNG_TIMES = 50.0


@dataclass
class Total:
    """What has been rendered of a picture, each tile once."""

    samples: int = 0
    rays: int = 0
    counters: dict[str, int] = field(default_factory=dict)

    def add(self, part: PartOfPicture) -> None:
        self.samples += part.samples
        self.rays += part.rays
        for name, count in part.counters.items():
            self.counters[name] = self.counters.get(name, 0) + count


@dataclass(eq=False)
class _Rendered:
    """A package that ``device`` has rendered. ``fetched``: its pixels are in the arrays."""

    device: int
    tiles: np.ndarray
    part: PartOfPicture
    span: Span
    fetched: bool = False


class PictureStage:
    """One stage: the dispatcher that all threads share, and what they have done.

    ``parts``: the picture on each device, by number. ``lose(member, error)`` leaves a device out, and returns the error
    to raise if it was the last one.
    """

    def __init__(
        self, members: list[Member], parts: dict[int, TiledPictureParts], stage: int, arrays: list[PictureArrays],
        dispatcher: Dispatcher, schedule: Schedule, start: float,
        lose: Callable[[Member, BaseException], BaseException | None],
    ) -> None:  # fmt: skip
        self._members, self._parts, self._stage, self._arrays = members, parts, stage, arrays
        self.dispatcher, self._schedule, self._start, self._lose = dispatcher, schedule, start, lose
        self.costs = np.zeros(dispatcher.count)  # by tile, as measured
        lock = threading.RLock()
        self._work_came = threading.Condition(lock)  # for devices that were given nothing, or at the end
        self._settled = threading.Condition(lock)  # for the thread that waits for the picture
        self._idle = 0
        self._rendered: list[_Rendered] = []
        self._fetching: dict[int, tuple[float, list[_Rendered]]] = {}  # since when, by device
        self._error: BaseException | None = None
        self._ended = False
        for k, member in enumerate(members):
            if k not in parts:
                dispatcher.lost(k, member.lost or "busy")

    def run(self, threads: dict[int, DeviceThread], report: Callable[[int], None] | None, total: Total) -> None:
        """Returns once all tiles are in the arrays; ``total`` then has what they took. The error of the last device if
        none is left.

        A device that is still busy then has ``Member.busy``: another one has done its package.
        """
        futures = {k: threads[k].submit(self._work, k) for k in self._parts if self._members[k].lost is None}
        try:
            self._watch(report)
        finally:
            with self._work_came:
                in_time = self._is_settled and self._error is None
                self._ended = True
                self._tell()
            self._leave(futures, _PATIENCE if in_time else _STOPPING)
        if self._error is not None:
            raise self._error
        for each in self._rendered:
            total.add(each.part)
        for k in self._parts:
            self._schedule.costs[k] += sum(float(r.part.costs.sum()) for r in self._rendered if r.device == k)

    def _leave(self, futures: dict[int, Future], patience: float) -> None:
        """Waits for the threads, but not for those that do not return."""
        wait_for(futures.values(), patience)
        for k, future in futures.items():
            if not future.done() and self._members[k].lost is None:
                self._members[k].leave_busy(future)
                self._schedule.states[k] = "stalled: others did its work"

    @property
    def _is_settled(self) -> bool:
        return self.dispatcher.complete and all(each.fetched for each in self._rendered)

    def _watch(self, report: Callable[[int], None] | None) -> None:
        reported, tiles = -1, self.dispatcher.count
        while True:
            with self._settled:
                if self._ended or self._is_settled:
                    break
                self._settled.wait(_TICK)
                self._look_after(perf_counter())
                done = sum(len(each.tiles) for each in self._rendered)
            if report is not None and done > reported:
                reported = done
                report(done)
        if report is not None and self._error is None:
            report(tiles)

    def _look_after(self, now: float) -> None:
        """Gives the tiles of a device that does not fetch them to others, and ends processes that hang."""
        for device, (since, taken) in list(self._fetching.items()):
            nbytes = self._arrays[self._stage].rgba.nbytes
            late = now - since > _FETCH_PATIENCE + nbytes * _FETCH_SECONDS
            others = any(k != device and k not in self._fetching and m.lost is None for k, m in self._alive())
            if late and others:
                del self._fetching[device]
                self._take_back(taken)
        for k, member in self._alive():
            hung = self.dispatcher.overdue(k, now, _HUNG, _HUNG_TIMES)
            if hung is not None:
                member.interrupt(f"no answer for {hung:.0f} s")

    def _alive(self) -> list[tuple[int, Member]]:
        return [(k, self._members[k]) for k in self._parts if self._members[k].lost is None]

    # ---- the threads

    def _work(self, device: int) -> None:
        part, member = self._parts[device], self._members[device]
        try:
            part.begin(self._stage, self._arrays)
            while (task := self._next(device)) is not None:
                if isinstance(task, Package):
                    begin = perf_counter()
                    self._finished(task, begin, member.render_part(part, self._stage, task.tiles))
                else:
                    part.end(self._stage, np.concatenate([each.tiles for each in task]))
                    self._fetched(device, task)
        except FAILURES as error:
            self._lost(device, member, error)
        except BaseException as error:  # a fault of the program: the caller gets it
            with self._work_came:
                self._error, self._ended = self._error or error, True
                self._tell()

    def _tell(self) -> None:
        """Wakes those for whom something may have changed. Nobody else: a thread that wakes takes a core from
        kernels."""
        if self._idle:
            self._work_came.notify_all()
        if self._ended or self._is_settled:
            self._settled.notify_all()

    def _next(self, device: int) -> Package | list[_Rendered] | None:
        """The next package, or what is to be fetched; waits while other devices may still fail. None at the end."""
        with self._work_came:
            while not (self._ended or self._is_settled or self._members[device].lost is not None):
                now = perf_counter()
                if not self.dispatcher.complete:
                    package = self.dispatcher.next(device, now)
                    if package is not None:
                        return package
                elif own := [each for each in self._rendered if each.device == device and not each.fetched]:
                    self._fetching[device] = now, own
                    return own
                self._idle += 1
                self._work_came.wait(min(max(self.dispatcher.ask_again(now), 1e-3), 1.0))
                self._idle -= 1
            return None

    def _finished(self, package: Package, begin: float, found: PartOfPicture) -> None:
        with self._work_came:
            end = perf_counter()
            counts = self.dispatcher.finished(package, end, found.costs)
            times = begin - self._start, end - self._start
            span = Span(package.device, self._stage, *times, package.tiles, counts)
            if not self._ended:
                self._schedule.spans.append(span)
            if counts:
                self.costs[package.tiles] = found.costs
                self._rendered.append(_Rendered(package.device, package.tiles, found, span))
            self._tell()

    def _fetched(self, device: int, done: list[_Rendered]) -> None:
        with self._work_came:
            if self._fetching.pop(device, None) is not None:
                for each in done:
                    each.fetched = True
            self._tell()

    def _lost(self, device: int, member: Member, error: BaseException) -> None:
        """What the device has rendered counts where it is in the arrays; other devices do the rest again."""
        with self._work_came:
            self.dispatcher.lost(device, str(error))
            self._fetching.pop(device, None)
            own = [each for each in self._rendered if each.device == device and not each.fetched]
            if member.writes_in_place:
                for each in own:
                    each.fetched = True
            else:
                self._take_back(own)
            last = self._lose(member, error)
            if last is not None:
                self._error, self._ended = self._error or last, True
            self._tell()

    def _take_back(self, rendered: list[_Rendered]) -> None:
        for each in rendered:
            each.span.counts = False
            self._rendered.remove(each)
            self.dispatcher.undone(each.tiles)
        self._tell()
