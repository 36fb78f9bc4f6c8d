"""Divides the tiles of one picture among devices while they render, so that all of them end at the same time.

A device that is free requests a package. Its size follows from the moment at which all devices would end if the rest
were divided ideally (``_common_end``): a device receives what it would do until then, or only a part of that while the
costs of tiles are uncertain, so that later packages can make up for errors. With known costs there are two or three
packages per device, with unknown ones about five. This is guided self-scheduling (Polychronopoulos and Kuck, IEEE
Transactions on Computers C-36, 1987) for devices of different speeds that are not free at the same time, with the
uncertainty measured in place of a fixed factor. Expensive tiles come first, in the order of the picture; cheap ones
fill packages up to the size that is wanted. What tiles have cost corrects what their neighbours are expected to.

Packages of devices that fail return to the queue. Packages that take much longer than expected are issued again to
devices that have nothing else to do; the first of two results counts.

There are no threads, clocks or OpenCL here: the caller states the time, and must not call from several threads at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

_LEAST_LAUNCHES = 2.5  # a package takes at least this many times a launch's cost, unless nothing more is left
_UNKNOWN = 0.6  # relative uncertainty of the cost of a tile that nobody has measured,
_MEASURED = 0.1  # and of one that was measured in an earlier picture
_LEAST_UNCERTAINTY = 0.03  # of a package
_DOUBTED = 0.2  # uncertainty of tiles above which costs are corrected
_CAUTION = 1.0  # the share handed out is 1 / (1 + caution * uncertainty), where caution is this plus the
# largest of as many normal deviations as there are devices, about the root of twice the logarithm of their number
_STEADY = 0.05  # differences of speed up to which a device counts as steady
_NEWEST = 0.4  # how much the newest package says of uncertainties, beside those before
_STALLED = 5.0  # times the expected time after which a package is issued again,
_PATIENCE = 1.0  # plus this many seconds
_LATE = 2.0  # times the expected time after which a device is expected to be late by as much again
_ALIKE = 1.5  # ratio of costs within which tiles count as equally expensive
_CHEAP = 0.25  # share of a picture's cost kept for the end, in its cheapest tiles, which fill packages up
_RUN = 4  # tiles that stay together where packages are scattered
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_REACH = 3  # tiles over which a measured cost says something about others
_WEIGHT_OF_ALL = 0.02  # how much the mean of all tiles counts beside that of near ones, in tiles


@dataclass(frozen=True, eq=False)
class Package:
    """``tiles`` (numbers, ascending), handed to ``device`` at time ``since``; ``cost`` as expected then. ``number``
    counts packages."""

    number: int
    device: int
    tiles: np.ndarray
    since: float
    cost: float


@dataclass
class Share:
    """What a device has done for a picture. ``speed`` is in cost per second, ``launch`` in seconds per package;
    ``unsteady``: by what share its speed differs from one package to the next, as on a processor that other programs
    use; None if that does not matter."""

    speed: float
    launch: float
    unsteady: float | None = 0.0
    tiles: int = 0
    packages: int = 0
    busy: float = 0.0  # seconds
    cost: float = 0.0  # as measured, or else as expected
    lost: str | None = None  # why it is not used any more
    running: list[Package] = field(default_factory=list)


class Dispatcher:
    """The packages of one picture.

    ``costs`` float [tiles], > 0: expected relative costs; ``measured``: whether they come from an earlier picture.
    ``speeds`` [devices] in cost per second, and ``launches`` [devices] in seconds per package. ``least_tiles``: tiles
    that a launch takes at least. ``columns``: tiles per row of the picture; 0 where tiles have no neighbours.
    ``unsteady`` [devices]: ``Share.unsteady`` of an earlier picture; None for devices that run on the same threads,
    where one that ends early leaves them to the others.
    """

    def __init__(
        self,
        costs: np.ndarray,
        speeds: Sequence[float],
        launches: Sequence[float],
        *,
        measured: bool = False,
        least_tiles: int = 1,
        columns: int = 0,
        unsteady: Sequence[float | None] | None = None,
    ) -> None:
        self.count = len(costs)
        self._costs = np.maximum(np.asarray(costs, np.float64), 1e-12)
        self._neighbours = _Neighbours(self._costs, columns)
        self._spread = _MEASURED if measured else _UNKNOWN  # relative uncertainty of tiles, as if independent,
        self._miss = _LEAST_UNCERTAINTY  # and of packages besides
        unsteady = [0.0] * len(speeds) if unsteady is None else unsteady
        self.shares = [Share(float(a), float(b), c) for a, b, c in zip(speeds, launches, unsteady)]
        self._waiting = _order(self._costs, scattered=not measured)
        self._done = np.zeros(self.count, bool)
        self._least_tiles = least_tiles
        self._number = 0
        self._caution = _CAUTION + math.sqrt(2 * math.log(max(len(self.shares), 1)))
        self._unit_is_known = measured
        self.history: list[tuple[Package, float, bool]] = []  # package, when it ended, whether its result counts

    # ---- state

    @property
    def complete(self) -> bool:
        return bool(self._done.all())

    @property
    def waiting_tiles(self) -> int:
        """Number of tiles that no device has."""
        return len(self._waiting)

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
        if not len(self._waiting):
            return self._again(device, now)
        if sum(each.lost is None for each in self.shares) == 1:
            return self._handed(device, self._take(len(self._waiting), 0), now)
        costs = self._costs[self._waiting]
        sums = np.cumsum(costs)
        rest = float(sums[-1])
        common_end = self._common_end(now, rest)
        ideal = share.speed * (common_end - self._free_at(device, now) - share.launch)
        uncertainty = math.hypot(self._uncertainty(costs, sums, ideal), share.unsteady or 0.0)
        part = ideal / (1 + self._caution * uncertainty)
        least = share.speed * share.launch * _LEAST_LAUNCHES
        wanted = ideal if ideal - part < least else max(part, least)
        head, tail, cost = self._fitting(costs, sums, wanted)
        if self._others_are_better(device, now, cost, common_end):
            return None
        return self._handed(device, self._take(head, tail), now)

    def _take(self, head: int, tail: int) -> np.ndarray:
        """The first ``head`` and the last ``tail`` of the waiting tiles, ascending."""
        waiting, last = self._waiting, len(self._waiting) - tail
        self._waiting = waiting[head:last]
        return np.sort(np.concatenate([waiting[:head], waiting[last:]]))

    def _fitting(self, costs: np.ndarray, sums: np.ndarray, wanted: float) -> tuple[int, int, float]:
        """How many of the waiting tiles from the front and from the back cost about ``wanted``, and their cost: cheap
        ones from the back fill up, so that a single expensive tile does not make a package too large. ``sums``: running
        sums of ``costs``."""
        if sums[-1] <= wanted:
            return len(costs), 0, float(sums[-1])
        head = int(np.searchsorted(sums, wanted, side="right"))
        left = wanted - (sums[head - 1] if head else 0.0)
        from_back = sums[-1] - sums  # the cost of what lies behind each tile
        tail = len(costs) - int(np.searchsorted(-from_back, -left, side="left")) - 1
        tail = max(min(tail, len(costs) - head), 0)
        short = self._least_tiles - head - tail
        tail += max(min(short, len(costs) - head - tail), 0)
        cost = (sums[head - 1] if head else 0.0) + (costs[len(costs) - tail :].sum() if tail else 0.0)
        return head, tail, float(cost)

    def _uncertainty(self, costs: np.ndarray, sums: np.ndarray, wanted: float) -> float:
        """The relative uncertainty of a package that costs ``wanted``, of waiting tiles with these ``costs``."""
        count = max(int(np.searchsorted(sums, wanted, side="right")), 1)
        some = costs[:count]
        alone = float(np.dot(some, some)) / float(some.sum()) ** 2  # 1 / number of tiles, were all alike
        return math.sqrt(self._miss**2 + self._spread**2 * min(alone * _RUN, 1.0))

    def _others_are_better(self, device: int, now: float, cost: float, common_end: float) -> bool:
        """Whether tiles of ``cost`` would be done sooner by another device that is still busy. That is only so at the
        end, on devices that are much slower than others."""
        share = self.shares[device]
        end = self._free_at(device, now) + share.launch + cost / share.speed
        if end <= common_end + share.launch:
            return False
        return any(
            self._free_at(other, now) + their.launch + cost / their.speed < end
            for other, their in enumerate(self.shares)
            if other != device and their.lost is None and their.running
        )

    def _handed(self, device: int, tiles: np.ndarray, now: float) -> Package:
        self._number += 1
        package = Package(self._number, device, tiles, now, float(self._costs[tiles].sum()))
        self.shares[device].running.append(package)
        return package

    def _again(self, device: int, now: float) -> Package | None:
        """A stalled package of another device, issued again."""
        for other, share in enumerate(self.shares):
            if other == device:
                continue
            for package in share.running:
                late = now - package.since - _PATIENCE > _STALLED * self.expected_seconds(package)
                if late and not self._done[package.tiles].all() and not self._is_copied(package):
                    return self._handed(device, package.tiles, now)
        return None

    def _is_copied(self, package: Package) -> bool:
        return any(
            p.number > package.number and p.tiles is package.tiles for share in self.shares for p in share.running
        )

    def finished(self, package: Package, now: float, costs: np.ndarray | float | None = None) -> bool:
        """Takes the end of ``package``; returns whether its result counts, which it does not if another device was
        first. ``costs`` float64 [tiles of the package], or their sum: as measured, in the unit of ``costs``."""
        share = self.shares[package.device]
        began = max((p.since for p in share.running if p.number < package.number), default=package.since)
        began = max(began, max((end for p, end, _ in self.history if p.device == package.device), default=began))
        share.running = [p for p in share.running if p.number != package.number]
        counts = not self._done[package.tiles].any()
        self.history.append((package, now, counts))
        share.busy += now - began
        if not counts:
            return False
        self._done[package.tiles] = True
        share.tiles += len(package.tiles)
        share.packages += 1
        found = float(np.sum(costs)) if costs is not None else max(now - began - share.launch, 0.0) * share.speed
        share.cost += found
        self._calibrate(package.device, found, now - began)
        self._learn(package, found, costs)
        return True

    def _calibrate(self, device: int, cost: float, seconds: float) -> None:
        """Corrects the speed of ``device`` by what it took for a package, and at first that of all others in
        proportion: at first it is unknown how fast devices are with this scene."""
        share = self.shares[device]
        if seconds <= 2 * share.launch or cost <= 0:
            return
        found = cost / (seconds - share.launch)
        if self._unit_is_known:
            if share.unsteady is not None:
                miss = min(abs(math.log(found / share.speed)), 1.0)
                share.unsteady += _NEWEST * (max(miss - _STEADY, 0.0) - share.unsteady)
            share.speed = found if share.packages == 1 else 0.5 * (share.speed + found)
            return
        self._unit_is_known = True
        ratio = found / share.speed
        for other in self.shares:
            other.speed *= ratio

    def lost(self, device: int, reason: str) -> int:
        """``device`` renders no more: its packages return to the queue. Returns the number of tiles that did."""
        share = self.shares[device]
        share.lost = share.lost or reason
        packages, share.running = share.running, []
        elsewhere = [p.tiles for each in self.shares for p in each.running]
        again = [
            p.tiles
            for p in packages
            if not self._done[p.tiles].all() and not any(tiles is p.tiles for tiles in elsewhere)
        ]
        return sum(map(self._wait_again, again))

    def undone(self, tiles: np.ndarray) -> None:
        """``tiles``, which were done, are waiting again."""
        self._done[tiles] = False
        self._wait_again(tiles)

    def _wait_again(self, tiles: np.ndarray) -> int:
        self._waiting = np.concatenate([tiles, self._waiting])
        return len(tiles)

    def ask_again(self, now: float) -> float:
        """Seconds after which a device that was given nothing should request again although nothing has ended: until
        some package counts as stalled that was not issued again, or, while tiles wait, until those who would do them
        sooner are late, and then twice as late; inf if none runs."""
        alive = [share for share in self.shares if share.lost is None]
        times = [
            p.since + _PATIENCE + _STALLED * self.expected_seconds(p)
            for share in alive
            for p in share.running
            if not self._is_copied(p)
        ]
        if len(self._waiting):
            times += [self._free_at(k, now) for k, share in enumerate(self.shares) if share in alive and share.running]
        return max(min(times, default=math.inf) - now, 0.0)

    def overdue(self, device: int, now: float, patience: float, times: float) -> float | None:
        """The seconds that ``device`` has spent on its package, if they are more than ``patience`` and ``times`` what
        was expected; None otherwise, and while it is not known what to expect."""
        running = self.shares[device].running
        if not running or not self._unit_is_known:
            return None
        spent = now - running[0].since
        return spent if spent > patience + times * self.expected_seconds(running[0]) else None

    # ---- arithmetic

    def _free_at(self, device: int, now: float) -> float:
        """When ``device`` will have ended its packages, as expected. One that takes more than _LATE times
        what was expected will be late by as much again: one that never returns must not be waited for because it was
        fast."""
        share = self.shares[device]
        if not share.running:
            return now
        since = share.running[0].since
        seconds = sum(share.launch + float(self._costs[p.tiles].sum()) / share.speed for p in share.running)
        return max(since + seconds, now, now + (now - since - _LATE * seconds))

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

    def _learn(self, package: Package, found: float, costs: np.ndarray | float | None) -> None:
        """Corrects the costs of the tiles that wait or are being rendered by what those of ``package`` have cost."""
        if found <= 0:
            return
        expected = self._costs[package.tiles]
        by_tile = costs if isinstance(costs, np.ndarray) else expected * (found / float(expected.sum()))
        off = np.log(by_tile / expected)
        mean = float(np.dot(off, by_tile)) / found
        spread = math.sqrt(float(np.dot((off - mean) ** 2, by_tile)) / found)
        self._spread += _NEWEST * (min(spread, 1.0) - self._spread)
        miss = abs(math.log(found / package.cost))
        self._miss = max(self._miss + _NEWEST * (min(miss, 1.0) - self._miss), _LEAST_UNCERTAINTY)
        self._neighbours.saw(package.tiles, by_tile)
        if len(self._waiting) and max(self._spread, self._miss) > _DOUBTED:
            self._costs = self._neighbours.expected()


class _Neighbours:
    """Costs of tiles (``prior`` float64 [tiles] as expected at first, ``columns`` per row; 0: in no order), corrected
    by those that were measured: by the ratio in tiles nearby as far as it is known there, else by that of all."""

    def __init__(self, prior: np.ndarray, columns: int) -> None:
        self._prior = prior
        columns = columns or 1
        rows = -(-len(prior) // columns)
        self._shape = rows, columns
        self._sums = np.zeros((2, rows * columns))  # of tiles that were measured: prior and measured cost
        self._reach = _REACH if columns > 1 else 0

    def saw(self, tiles: np.ndarray, costs: np.ndarray) -> None:
        self._sums[0, tiles], self._sums[1, tiles] = self._prior[tiles], costs

    def expected(self) -> np.ndarray:
        every = self._sums.sum(axis=1)
        near = self._sums.reshape(2, *self._shape)
        for axis in (1, 2):
            near = _blurred(near, axis, self._reach)
        mean = _WEIGHT_OF_ALL * every[0] / self.measured_tiles
        before, after = near.reshape(2, -1)[:, : len(self._prior)]
        return self._prior * (after + mean * every[1] / every[0]) / (before + mean)

    @property
    def measured_tiles(self) -> int:
        return int(np.count_nonzero(self._sums[0]))


def _blurred(values: np.ndarray, axis: int, reach: int) -> np.ndarray:
    """Means over 2 ``reach`` + 1 places along ``axis``, twice, so that near places count more."""
    if not reach:
        return values
    for _ in range(2):
        padding = [(0, 0)] * values.ndim
        padding[axis] = (reach + 1, reach)
        sums = np.cumsum(np.pad(values, padding), axis=axis)
        length = values.shape[axis]
        upper = np.take(sums, range(2 * reach + 1, 2 * reach + 1 + length), axis=axis)
        values = (upper - np.take(sums, range(length), axis=axis)) / (2 * reach + 1)
    return values


def _order(costs: np.ndarray, scattered: bool) -> np.ndarray:
    """Tiles in the order in which they are handed out: the expensive ones by place, then the cheap ones, which are
    _CHEAP of all costs, the cheapest last. Costs are compared roughly: the last ones would otherwise be those whose
    costs were underestimated most. ``scattered``: not by place but in short runs from all over the picture, so that
    errors of expectations, which neighbours share, cancel within packages."""
    falling = np.argsort(-np.floor(np.log(costs) / math.log(_ALIKE)), kind="stable")
    sums = np.cumsum(costs[falling])
    expensive = int(np.searchsorted(sums, (1 - _CHEAP) * sums[-1]))
    first = np.sort(falling[:expensive])
    if scattered:
        runs = np.arange(len(first)) // _RUN
        first = first[np.lexsort((np.arange(len(first)), runs * _GOLDEN % 1.0))]
    return np.concatenate([first, falling[expensive:]])
