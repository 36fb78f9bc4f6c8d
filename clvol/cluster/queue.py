"""Hands tasks to the workers of a cluster until each is done once.

Workers are checked before they get work, also those that join later. What a worker had when it died is handed to
others by dask, and so is what a scheduler thinks is lost; answers are counted by the number of the task, so that none
counts twice. A task whose workers die again and again may be innocent, since dask blames everything that a worker
held: it is tried again alone, at the end, and is given up only then.
"""

from __future__ import annotations

import json
import secrets
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from heapq import heappop, heappush
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from clvol.cluster import worker
from clvol.cluster.connection import Connection
from clvol.cluster.facts import program_facts
from clvol.errors import ClvolWarning, DeviceError, RenderError
from clvol.text import one_line

if TYPE_CHECKING:
    from distributed import Future

AHEAD = 2  # tasks per worker that are handed out at a time
RETRIES = 2  # of a task that fails by an unexpected error
_LOOK = 0.3  # seconds between looks at the workers,
_MANY = 50  # more seldom if there are more than this many,
_PAUSE = 1.0  # before a task is tried again that others were doing,
_LOST = 5.0  # and until a scheduler counts as lost
_RESULT_SECONDS = 60.0
_WINK = 0.01  # seconds between looks at tasks that take no longer
_MOST_TRIES = 20

Request = dict[str, Any]


@dataclass(eq=False)
class _Worker:
    """``share``: number of its share of this machine's cores. ``reason``: why it is left out, or None; ``status``: the
    exit status that this would have."""

    address: str
    share: int | None
    check: Future | None
    is_good: bool = False
    reason: str | None = None
    status: int = RenderError.exit_status


@dataclass(eq=False)
class _Flight:
    """A task that is handed out, to any of ``workers``."""

    number: int
    future: Future
    workers: frozenset[str]


@dataclass
class Answer:
    """``number`` of the task, and what its worker said, or the ``future`` of that, where the queue ``keeps`` it; or
    ``error``, why there will be no answer, with the command's exit ``status``."""

    number: int
    said: dict[str, Any] = field(default_factory=dict)
    future: Future | None = None
    error: str | None = None
    status: int = RenderError.exit_status


class TaskQueue:
    """``function(request)`` of ``clvol.cluster.worker`` is called for each request on some worker. ``folder``: the
    working folder of all tasks. A worker that does not fit is left out, with a ``ClvolWarning`` that says why.

    An answer of {"mismatch": reason} leaves the worker that it comes from out, and {"busy": true} has the task tried
    again later. A queue that ``keeps`` answers leaves them with the workers, unread: see ``told``. An array in
    ``request["data"]`` becomes a second argument.
    """

    def __init__(
        self, connection: Connection, function: Callable[..., Any], folder: str, keeps: bool = False
    ) -> None:
        self._keeps = keeps
        self._connection, self._client, self._function = connection, connection.client, function
        self._common = {"facts": program_facts(), "folder": folder}
        self._name = f"clvol-{secrets.token_hex(6)}"
        self._tries: Counter[int] = Counter()
        self._events: SimpleQueue[_Flight | None] = SimpleQueue()  # None: a check has ended
        self._workers: dict[str, _Worker] = {}
        self._flights: dict[int, _Flight] = {}
        self._todo: list[int] = []
        self._later: deque[tuple[float, int]] = deque()
        self._alone: deque[int] = deque()
        self._suspects: set[int] = set()
        self._since_none = self._well = time.monotonic()
        self._looked = 0.0

    @property
    def left_out(self) -> dict[str, str]:
        """The reason by address."""
        return {each.address: each.reason for each in self._workers.values() if each.reason is not None}

    def run(self, requests: Sequence[Request], ahead: int | None = None) -> Iterator[Answer]:
        """The answers in the order in which they come, one for each request. ``ahead``: no request is handed out while
        one that comes this many before it has no answer.

        RenderError if the scheduler is lost, or if there is no worker that fits.
        """
        self._todo = list(range(len(requests)))  # a heap: the first ones first
        left = set(self._todo)
        try:
            while left:
                self._look()
                self._hand_out(requests, left, ahead)
                for flight in self._finished():
                    answer = self._answer(flight)
                    if answer is not None and answer.number in left:
                        left.remove(answer.number)
                        yield answer
        finally:
            self._cancel()

    def told(self, answers: Sequence[Answer]) -> list[dict[str, Any]]:
        """What workers said in ``answers`` that are kept, without their pixels. A worker that does not fit is left out:
        what it has said is no answer."""
        told = self.results([self._client.submit(worker.told_of, each.future, pure=False) for each in answers])
        for said in told:
            if "mismatch" in said:
                self._mismatch(said)
        return told

    def results(self, futures: Sequence[Future]) -> list[Any]:
        """The results of tasks. What they need and a worker had that has died is made again, by dask. RenderError for a
        task that fails, and if the scheduler is lost."""
        found = []
        for future in futures:
            self._well = time.monotonic()
            while not future.done():
                time.sleep(_WINK)
                now = time.monotonic()
                if self._client.status == "running":
                    self._well = now
                else:
                    self._check_scheduler(now)
            result = _result(future)
            if result is None:
                self._check_scheduler(time.monotonic())
                reason = future.exception() if future.status == "error" else f"it is {future.status}"
                raise RenderError(self._connection.name, one_line(f"a task has failed: {reason}"))
            found.append(result)
        return found

    # ---- workers

    def _look(self) -> None:
        """Checks workers that are new, and forgets those that are gone."""
        now = time.monotonic()
        self._end_checks()
        if now - self._looked < _LOOK * max(1.0, len(self._workers) / _MANY):
            return
        self._looked = now
        known = self._known_workers()
        if known is None:
            self._check_scheduler(now)
            return
        self._well = now
        for address in self._workers.keys() - known.keys():
            if self._workers[address].reason is None:
                del self._workers[address]
        for address in known.keys() - self._workers.keys():
            self._begin_check(address, known[address].get("resources", {}))
        self._end_checks()
        self._hand_back({each.address for each in self._workers.values() if each.address in known})
        if any(each.reason is None for each in self._workers.values()):  # also those that are being checked
            self._since_none = now
            return
        if self.left_out:
            reasons = "; ".join(f"{address}: {reason}" for address, reason in self.left_out.items())
            without_device = all(each.status == DeviceError.exit_status for each in self._workers.values())
            kind = DeviceError if without_device else RenderError
            raise kind(self._connection.name, f"no worker fits ({reasons})")
        if now - self._since_none > self._connection.wait:
            what = f"no worker is there after {self._connection.wait:.0f} s"
            raise RenderError(self._connection.name, what, "a worker: dask worker --nthreads 1 --resources opencl=1")

    def _end_checks(self) -> None:
        for each in list(self._workers.values()):
            if each.check is not None and each.check.done():
                self._end_check(each)

    def _known_workers(self) -> dict[str, Any] | None:
        """What the scheduler knows of its workers, by address; None if it does not answer."""
        if self._client.status != "running":
            return None
        try:
            told = self._client.sync(self._client.scheduler.identity, n_workers=-1, callback_timeout=_LOST)
        except Exception:  # a closed connection, a time-out: whatever dask makes of a loss
            return None
        return dict(told["workers"])

    def _check_scheduler(self, now: float) -> None:
        if now - self._well > _LOST or self._client.status in ("closed", "closing"):
            what = "its scheduler is lost; what is finished is kept, and the same command with --resume goes on"
            raise RenderError(self._connection.name, what)

    def _begin_check(self, address: str, resources: dict[str, Any]) -> None:
        if not resources.get("opencl"):
            found = _Worker(address, None, None)
            self._leave_out(found, "it has no resource opencl (dask worker --nthreads 1 --resources opencl=1)")
        else:
            shares = range(len(self._connection.cores))
            free = [k for k in shares if all(each.share != k for each in self._workers.values())]
            share = free[0] if free else None
            cores = [] if share is None else self._connection.cores[share]
            request = json.dumps({**self._common, "cores": cores})
            key = f"{self._name}-check-{secrets.token_hex(4)}"
            future = self._client.submit(
                worker.check, request, key=key, workers=[address], allow_other_workers=False, pure=False,
                resources={"opencl": 1}, priority=10,
            )  # fmt: skip
            future.add_done_callback(lambda _: self._events.put(None))
            found = _Worker(address, share, future)
        self._workers[address] = found

    def _end_check(self, found: _Worker) -> None:
        future, found.check = found.check, None
        assert future is not None
        if future.status == "finished":
            reason = _result(future)
        elif future.status == "error":
            reason = f"it cannot run clvol: {future.exception()}"
        else:  # it died meanwhile, or the scheduler is lost
            return
        if reason:
            self._leave_out(found, reason)
        elif reason == "":
            found.is_good = True

    def _leave_out(self, found: _Worker, reason: str, status: int = RenderError.exit_status) -> None:
        found.reason, found.is_good, found.status = reason, False, status
        warnings.warn(ClvolWarning(f"worker {found.address}", f"is left out: {reason}"), stacklevel=2)

    # ---- tasks

    def _hand_out(self, requests: Sequence[Request], left: set[int], ahead: int | None) -> None:
        now = time.monotonic()
        while self._later and self._later[0][0] <= now:
            heappush(self._todo, self._later.popleft()[1])
        good = frozenset(each.address for each in self._workers.values() if each.is_good)
        furthest = len(requests) if ahead is None else min(left) + ahead
        while self._todo and self._todo[0] < furthest and len(self._flights) < AHEAD * len(good):
            self._submit(heappop(self._todo), requests, good)
        if good and self._alone and not (self._todo or self._later or self._flights):
            self._submit(self._alone.popleft(), requests, good)

    def _submit(self, number: int, requests: Sequence[Request], good: frozenset[str]) -> None:
        self._tries[number] += 1
        key = f"{self._name}-{number}-{self._tries[number]}"
        those = sorted(good) if self.left_out else None  # any worker, if all of them fit
        request = {**self._common, **requests[number]}
        data = [request.pop("data")] if "data" in request else []
        future = self._client.submit(
            self._function, json.dumps(request), *data, key=key, workers=those, allow_other_workers=False, pure=False,
            resources={"opencl": 1}, retries=RETRIES,
        )  # fmt: skip
        flight = self._flights[number] = _Flight(number, future, frozenset(those or ()))
        future.add_done_callback(lambda _: self._events.put(flight))

    def _hand_back(self, there: set[str]) -> None:
        """Takes back tasks for workers none of which is there any more."""
        for number, flight in list(self._flights.items()):
            if flight.workers and flight.workers.isdisjoint(there):
                del self._flights[number]
                flight.future.cancel()
                heappush(self._todo, number)

    def _finished(self) -> list[_Flight]:
        """Tasks that have ended; none if that takes a while."""
        found: list[_Flight | None] = []
        with suppress(Empty):
            found.append(self._events.get(timeout=_LOOK))
            while True:
                found.append(self._events.get_nowait())
        return [flight for flight in found if flight is not None and self._flights.get(flight.number) is flight]

    def _answer(self, flight: _Flight) -> Answer | None:
        """The answer to a task; None if it is to be tried again."""
        del self._flights[flight.number]
        number, future = flight.number, flight.future
        if self._keeps and future.status == "finished":
            return Answer(number, future=future)
        said = _result(future)
        if said is not None:
            if said.get("busy"):
                self._later.append((time.monotonic() + _PAUSE, number))
                return None
            if "mismatch" not in said:
                return Answer(number, said)
            self._mismatch(said)
        elif future.status == "error":
            error = future.exception()
            if type(error).__name__ == "KilledWorker":
                return self._killed(number)
            if not isinstance(error, (ImportError, AttributeError)) or self._tries[number] > _MOST_TRIES:
                return Answer(number, error=one_line(f"{type(error).__name__}: {error}"))
            # A worker without clvol, or with another version of it, has joined and will be left out.
            self._later.append((time.monotonic() + _PAUSE, number))
            return None
        heappush(self._todo, number)  # also if it was cancelled: its scheduler is lost, or has been for a moment
        return None

    def _killed(self, number: int) -> Answer | None:
        if number in self._suspects:
            return Answer(number, error="the workers that had this task died again and again, also without any other")
        self._suspects.add(number)
        self._alone.append(number)
        return None

    def _mismatch(self, said: dict[str, Any]) -> None:
        address = str(said.get("worker"))
        found = self._workers.get(address) or _Worker(address, None, None)
        self._workers[address] = found
        if found.reason is None:
            self._leave_out(found, str(said["mismatch"]), int(said.get("status", RenderError.exit_status)))

    def _cancel(self) -> None:
        with suppress(Exception):  # the scheduler may be lost
            self._client.cancel([flight.future for flight in self._flights.values()], force=True)
        self._flights.clear()


def _result(future: Future) -> Any:
    """The result of a task that is done; None if there is none, or if it died with its worker."""
    if future.status != "finished":
        return None
    try:
        return future.result(timeout=_RESULT_SECONDS)
    except Exception:  # a closed connection, a lost key, a time-out: whatever dask makes of a loss
        return None
