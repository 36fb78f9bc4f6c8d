"""Devices that render in virtual time: what a ``Dispatcher`` does with given costs of tiles, speeds and failures."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from clvol.schedule.dispatch import Dispatcher, Package

LEAST_WAIT = 1e-3  # seconds between requests of a device that is given nothing
Fault = Callable[[Package], str | float | None]


@dataclass(frozen=True)
class Simulated:
    """``makespan`` and ``ideal`` in seconds; ``spans``: (package, begin, end) of each; ``complete``: all tiles done."""

    makespan: float
    ideal: float
    spans: list[tuple[Package, float, float]]
    complete: bool

    @property
    def efficiency(self) -> float:
        return self.ideal / self.makespan if self.makespan else 1.0


def simulate(
    dispatcher: Dispatcher,
    true_costs: np.ndarray,
    speeds: Sequence[float],
    launches: Sequence[float],
    fault: Fault | None = None,
    in_flight: int = 1,
) -> Simulated:
    """Runs ``dispatcher`` against devices whose tiles really cost ``true_costs``. ``fault(package)``: a reason if the
    device fails with it, a factor by which it takes longer, or None."""
    events: list[tuple[float, int, Package, str | None]] = []
    free = [0.0] * len(speeds)
    spans = []
    now = 0.0

    def feed(device: int) -> None:
        while len(dispatcher.shares[device].running) < in_flight:
            package = dispatcher.next(device, now)
            if package is None:
                return
            trouble = fault(package) if fault is not None else None
            cost = float(true_costs[package.tiles].sum())
            seconds = launches[device] + cost / speeds[device]
            if isinstance(trouble, float):
                seconds *= trouble
            begin = max(now, free[device])
            free[device] = begin + seconds
            spans.append((package, begin, free[device]))
            failure = trouble if isinstance(trouble, str) else None
            heapq.heappush(events, (free[device], package.number, package, failure))

    def feed_all() -> None:
        for device in range(len(speeds)):
            if dispatcher.alive(device):
                feed(device)

    def is_idle() -> bool:
        return any(share.lost is None and not share.running for share in dispatcher.shares)

    feed_all()
    while events and not dispatcher.complete:
        again = now + max(dispatcher.ask_again(now), LEAST_WAIT)
        if again < events[0][0] and is_idle():
            now = again
            feed_all()
            continue
        now, _, package, failed = heapq.heappop(events)
        if failed is not None:
            dispatcher.lost(package.device, failed)
            feed_all()
            continue
        if dispatcher.alive(package.device):
            dispatcher.finished(package, now, true_costs[package.tiles])
            feed(package.device)
    ideal = float(true_costs.sum()) / math.fsum(speeds)
    return Simulated(now, ideal, spans, dispatcher.complete)
