"""Divides the tiles of one picture among devices while they render, so that all of them end at the same time.

A device that is free requests a package, a run of consecutive tiles. Its size follows from the moment at which all
devices would end if the rest were divided ideally (``_common_end``): a device receives what it would do until then,
or only a part of that while the costs of tiles are uncertain, so that later packages can make up for errors. With known
costs there are two or three packages per device, with unknown ones about five. This is guided self-scheduling (Polychronopoulos and
Kuck, IEEE Transactions on Computers C-36, 1987) for devices of different speeds that are not free at the same time, with
the uncertainty measured in place of a fixed factor.

Packages of devices that fail return to the queue. Packages that take much longer than expected are issued again to
devices that have nothing else to do; the first of two results counts.

There are no threads, clocks or OpenCL here: the caller states the time, and must not call from several threads at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

_LEAST_LAUNCHES = 5.0  # a package takes at least this many times a launch's cost, unless nothing more is left
_UNKNOWN = 0.6  # relative uncertainty of costs that nobody has measured
_LEAST_UNCERTAINTY = 0.03
_CAUTION = 1.6  # the share handed out is 1 / (1 + _CAUTION * uncertainty)
_STALLED = 5.0  # times the expected time after which a package is issued again,
_PATIENCE = 1.0  # plus this many seconds
_MISFIT = 0.1  # share of the wanted cost by which a package may miss it before others are looked for,
_FINE = 64  # among packages of fewer tiles than this
_REACH = 256.0  # tiles over which a measured cost says something about others


@dataclass(frozen=True)
class Package:
    """Tiles ``first`` ... ``last - 1``, handed to ``device`` at time ``since``; ``cost`` as expected then. ``number``
    counts packages."""

    number: int
    device: int
    first: int
    last: int
    since: float
    cost: float

    @property
    def tiles(self) -> int:
        return self.last - self.first


@dataclass
class Share:
    """What a device has done for a picture. ``speed`` is in cost per second, ``launch`` in seconds per package."""

    speed: float
    launch: float
    tiles: int = 0
    packages: int = 0
    busy: float = 0.0  # seconds
    cost: float = 0.0  # as measured, or else as expected
    lost: str | None = None  # why it is not used any more
    running: list[Package] = field(default_factory=list)


class Dispatcher:
    """The packages of one picture.

    ``costs`` float [tiles], > 0: expected relative costs; ``measured``: whether they come from an earlier picture, with
    ``uncertainty`` (relative, root mean square) if known. ``speeds`` [devices] in cost per second, and ``launches``
    [devices] in seconds per package. ``least_tiles``: tiles that a launch takes at least.
    """

    def __init__(
        self,
        costs: np.ndarray,
        speeds: Sequence[float],
        launches: Sequence[float],
        *,
        measured: bool = False,
        uncertainty: float | None = None,
        least_tiles: int = 1,
    ) -> None:
        self.count = len(costs)
        self._prior = np.maximum(np.asarray(costs, np.float64), 1e-12)
        self._costs = self._prior.copy()
        self._sums = _sums(self._costs)
        self._doubt = uncertainty if uncertainty is not None else _LEAST_UNCERTAINTY if measured else _UNKNOWN
        self._learns = not measured
        self._seen: list[tuple[float, float, float]] = []  # middle tile, log of measured over expected cost, weight
        self.shares = [Share(float(speed), float(launch)) for speed, launch in zip(speeds, launches)]
        self._queue: list[tuple[int, int]] = [(0, self.count)]
        self._done = np.zeros(self.count, bool)
        self._least_tiles = least_tiles
        self._number = 0
        self.history: list[tuple[Package, float, bool]] = []  # package, when it ended, whether its result counts

    # ---- state

    @property
    def complete(self) -> bool:
        return bool(self._done.all())

    @property
    def waiting_tiles(self) -> int:
        """Tiles that no device has."""
        return sum(last - first for first, last in self._queue)

    def alive(self, device: int) -> bool:
        return self.shares[device].lost is None

    @property
    def all_lost(self) -> bool:
        return not any(share.lost is None for share in self.shares)

    def expected_seconds(self, package: Package) -> float:
        share = self.shares[package.device]
        return share.launch + package.cost / share.speed

    # ---- packages

    def next(self, device: int, now: float) -> Package | None:
        """A package for ``device``, or None if there is nothing for it now (``complete`` may still be false: another
        device may fail)."""
        share = self.shares[device]
        if share.lost is not None:
            return None
        if not self._queue:
            return self._again(device, now)
        rest = self._rest()
        ideal = share.speed * (self._common_end(now, rest) - self._free_at(device, now) - share.launch)
        part = ideal / (1 + _CAUTION * self._doubt)
        least = share.speed * share.launch * _LEAST_LAUNCHES
        wanted = ideal if ideal - part < least else max(part, least)
        return self._handed(device, *self._taken(wanted, least), now)

    def _taken(self, wanted: float, least: float) -> tuple[int, int]:
        """Tiles that cost about ``wanted``, out of the queue: its next ones if they fit, or else those that fit
        best, because a single expensive tile may be too much for a slow device."""
        first, last = self._queue[0]
        end = self._cut(first, last, wanted, least)
        place = 0
        if abs(self._cost(first, end) - wanted) > _MISFIT * wanted and end - first < _FINE:
            for k, (low, high) in enumerate(self._queue):
                starts = np.arange(low, high)
                ends = np.minimum(np.searchsorted(self._sums, self._sums[starts] + wanted, side="right") - 1, high)
                ends = np.maximum(ends, np.minimum(starts + self._least_tiles, high))
                misfit = np.abs(self._sums[ends] - self._sums[starts] - wanted)
                best = int(misfit.argmin())
                if misfit[best] < abs(self._cost(first, end) - wanted):
                    first, end, place = int(starts[best]), int(ends[best]), k
        low, high = self._queue[place]
        self._queue[place : place + 1] = [part for part in ((low, first), (end, high)) if part[0] < part[1]]
        return first, end

    def _handed(self, device: int, first: int, last: int, now: float) -> Package:
        self._number += 1
        package = Package(self._number, device, first, last, now, self._cost(first, last))
        self.shares[device].running.append(package)
        return package

    def _again(self, device: int, now: float) -> Package | None:
        """A stalled package of another device, issued again."""
        for other, share in enumerate(self.shares):
            if other == device:
                continue
            for package in share.running:
                late = now - package.since - _PATIENCE > _STALLED * self.expected_seconds(package)
                undone = not self._done[package.first : package.last].all()
                if late and undone and not self._is_copied(package):
                    return self._handed(device, package.first, package.last, now)
        return None

    def _is_copied(self, package: Package) -> bool:
        same = (p for share in self.shares for p in share.running)
        return any(p.number > package.number and p.first == package.first for p in same)

    def finished(self, package: Package, now: float, cost: float | None = None) -> bool:
        """Takes the end of ``package``; returns whether its result counts, which it does not if another device was
        first. ``cost``: as measured, in the unit of ``costs``."""
        share = self.shares[package.device]
        began = max((p.since for p in share.running if p.number < package.number), default=package.since)
        began = max(began, max((end for p, end, _ in self.history if p.device == package.device), default=began))
        share.running = [p for p in share.running if p.number != package.number]
        counts = not self._done[package.first : package.last].any()
        self.history.append((package, now, counts))
        share.busy += now - began
        if not counts:
            return False
        self._done[package.first : package.last] = True
        share.tiles += package.tiles
        share.packages += 1
        found = cost if cost is not None else max(now - began - share.launch, 0.0) * share.speed
        share.cost += found
        self._learn(package, found)
        return True

    def lost(self, device: int, reason: str) -> int:
        """``device`` renders no more: its packages return to the queue. Returns the number of tiles that did."""
        share = self.shares[device]
        share.lost = share.lost or reason
        returned = [p for p in share.running if not self._done[p.first : p.last].any() and not self._held_elsewhere(p)]
        share.running = []
        for package in returned:
            self._queue.insert(0, (package.first, package.last))
        return sum(p.tiles for p in returned)

    def returned(self, package: Package) -> None:
        """``package`` failed, but its device goes on with others."""
        share = self.shares[package.device]
        share.running = [p for p in share.running if p.number != package.number]
        if not self._done[package.first : package.last].any() and not self._held_elsewhere(package):
            self._queue.insert(0, (package.first, package.last))

    def _held_elsewhere(self, package: Package) -> bool:
        others = (p for k, share in enumerate(self.shares) if k != package.device for p in share.running)
        return any(p.first == package.first and p.last == package.last for p in others)

    def next_stall(self, now: float) -> float:
        """Seconds until some package counts as stalled; inf if none runs."""
        running = [p for share in self.shares if share.lost is None for p in share.running]
        ends = [p.since + _PATIENCE + _STALLED * self.expected_seconds(p) for p in running]
        return max(min(ends, default=math.inf) - now, 0.0)

    # ---- arithmetic

    def _rest(self) -> float:
        return sum(self._cost(first, last) for first, last in self._queue)

    def _cost(self, first: int, last: int) -> float:
        return float(self._sums[last] - self._sums[first])

    def _free_at(self, device: int, now: float) -> float:
        """When ``device`` will have ended its packages, as expected."""
        share = self.shares[device]
        if not share.running:
            return now
        seconds = share.running[0].since + sum(
            share.launch + self._cost(p.first, p.last) / share.speed for p in share.running
        )
        return max(seconds, now)

    def _common_end(self, now: float, rest: float) -> float:
        """When all devices end that take part, if ``rest`` is divided so that they end together: those that are free
        later than that take no part. Each part costs one more launch."""
        ready = sorted(
            (self._free_at(k, now) + share.launch, share.speed)
            for k, share in enumerate(self.shares)
            if share.lost is None
        )
        speed = moment = 0.0
        end = math.inf
        for at, own in ready:
            if at >= end:
                break
            speed += own
            moment += own * at
            end = (rest + moment) / speed
        return end

    def _cut(self, first: int, last: int, wanted: float, least: float) -> int:
        """The end of a package from ``first`` that costs about ``wanted``."""
        end = int(np.searchsorted(self._sums, self._sums[first] + wanted))
        if end > first and self._sums[min(end, last)] - self._sums[first] - wanted > 0:
            over = self._sums[min(end, last)] - self._sums[first] - wanted
            under = wanted - (self._sums[end - 1] - self._sums[first])
            end -= over > under and end - 1 > first
        end = min(max(end, first + self._least_tiles), last)
        left = self._cost(end, last)
        return last if left < least / 2 and len(self._queue) == 1 else end

    def _learn(self, package: Package, found: float) -> None:
        """Corrects the costs of tiles near those of ``package``."""
        if not self._learns or found <= 0:
            return
        expected = float(self._prior[package.first : package.last].sum())
        now = self._cost(package.first, package.last)
        miss = abs(math.log(max(found, 1e-12) / now))
        self._doubt = max(0.6 * self._doubt + 0.4 * min(miss, 1.0), _LEAST_UNCERTAINTY)
        ratio = math.log(max(found, 1e-12) / expected)
        self._seen.append(((package.first + package.last) / 2, ratio, math.sqrt(package.tiles)))
        middles, ratios, weights = np.array(self._seen).T
        tiles = np.arange(self.count)
        near = weights[:, None] / (1 + np.abs(tiles[None, :] - middles[:, None]) / _REACH) ** 4
        self._costs = self._prior * np.exp((near * ratios[:, None]).sum(axis=0) / near.sum(axis=0))
        self._sums = _sums(self._costs)


def _sums(costs: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(costs)])
