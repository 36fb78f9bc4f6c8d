"""One picture on several devices: a thread per device takes packages of tiles from a ``Dispatcher`` and renders them.

All devices write the same arrays. A device that fails is left out from then on; its packages go to the others, and the
picture is the same. Integrators whose pictures cannot be divided render on the fastest device alone.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from clvol.device.view import EVERY_PIXEL, PixelLattice
from clvol.errors import ClvolError, DeviceError, RenderError
from clvol.integrators.base import (
    FrameData,
    PartOfPicture,
    PictureArrays,
    Prepared,
    Progress,
    RendersParts,
    TiledPictureParts,
)
from clvol.opencl.context import DeviceContext, shared_array
from clvol.render.prepared_cache import PreparedCache
from clvol.scene.camera import Camera
from clvol.schedule.dispatch import Dispatcher, Package

_LAUNCH = 5e-4  # seconds that a package takes besides its tiles, as a first guess
_SPEED = 2e8  # cost per second and compute unit, as a first guess
_TICK = 0.1  # seconds between calls of a progress function
_LEAST_TILES = 8


@dataclass(eq=False)
class Member:
    """A device of a group, with the scene that is prepared on it. ``speed`` is in cost per second. ``lost``: why it is
    not used any more."""

    context: DeviceContext
    cache: PreparedCache
    prepared: Prepared | None = None
    speed: float = 0.0
    lost: str | None = None

    def __post_init__(self) -> None:
        self.speed = self.speed or _SPEED * max(int(self.context.device.max_compute_units), 1)


@dataclass(frozen=True)
class Span:
    """``device`` (number) rendered ``tiles`` tiles from ``begin`` to ``end``, in seconds since the frame began.
    ``counts``: whether its result was used."""

    device: int
    stage: int
    begin: float
    end: float
    tiles: np.ndarray
    counts: bool


@dataclass
class Schedule:
    """Who rendered what of a frame, over time. ``seconds``: of the whole frame. ``tile``: pixels (width, height)."""

    names: list[str]
    tile: tuple[int, int] = (1, 1)
    seconds: float = 0.0
    spans: list[Span] = field(default_factory=list)
    costs: list[float] = field(default_factory=list)  # by device
    states: list[str] = field(default_factory=list)

    def describe(self) -> dict[str, Any]:
        """For stats. ``efficiency``: the seconds that the frame would take if all devices that took part had been busy
        at their speeds until the end, over the seconds that it took."""
        busy = [sum(s.end - s.begin for s in self.spans if s.device == k) for k in range(len(self.names))]
        tiles = [sum(len(s.tiles) for s in self.spans if s.device == k and s.counts) for k in range(len(self.names))]
        speeds = [cost / seconds for cost, seconds in zip(self.costs, busy) if seconds > 0 and cost > 0]
        ideal = sum(self.costs) / sum(speeds) if speeds else self.seconds
        every = max(sum(tiles), 1)
        devices = [
            {
                "name": name, "tiles": tiles[k], "share": tiles[k] / every, "busy_seconds": busy[k],
                "idle_share": max(1.0 - busy[k] / self.seconds, 0.0) if self.seconds else 0.0,
                "state": self.states[k],
            }
            for k, name in enumerate(self.names)
        ]  # fmt: skip
        return {"efficiency": min(ideal / self.seconds, 1.0) if self.seconds else 1.0, "devices": devices}


class _Stopped(Exception):
    """The caller's progress function, or a signal, ended the frame."""


class DeviceGroup:
    """Renders frames on ``members`` together. Not for two threads at once."""

    def __init__(self, members: Sequence[Member]) -> None:
        self.members = list(members)
        self._costs: dict[tuple[int, int], np.ndarray] = {}  # by (stage, tiles), as measured in the last frame
        self._executor: ThreadPoolExecutor | None = None
        self.schedule: Schedule | None = None  # of the last frame

    def close(self) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=True)
            self._executor = None

    @property
    def alive(self) -> list[Member]:
        """Those that work, the fastest first."""
        return sorted((m for m in self.members if m.lost is None), key=lambda m: -m.speed)

    def lose(self, member: Member, error: BaseException) -> None:
        """Leaves ``member`` out from now on; raises ``error`` again if it was the last one."""
        member.lost = " ".join(str(error).split())
        if not self.alive:
            raise error

    def remember_in(self, costs: dict[tuple[int, int], np.ndarray]) -> None:
        """From now on, costs of tiles by (stage, tiles), as measured in a frame, are taken from ``costs`` and kept in
        it."""
        self._costs = costs

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        """Compiles everything that a frame of this size needs, on all devices."""
        shares = len(self.members) > 1
        for member in self.alive:
            prepared = member.prepared
            try:
                assert prepared is not None
                if shares and isinstance(prepared, RendersParts):
                    prepared.warm_up_parts(width, height, depth)
                else:
                    prepared.warm_up(width, height, depth)
            except (RenderError, DeviceError) as error:
                if not shares:
                    raise
                self.lose(member, error)

    def render(
        self, camera: Camera, width: int, height: int, progress: Progress | None = None, depth: bool = True,
        lattice: PixelLattice = EVERY_PIXEL,
    ) -> FrameData:  # fmt: skip
        """As ``Prepared.render``, with ``notes["schedule"]``. A lattice of pixels is rendered by one device."""
        self.schedule = schedule = Schedule([m.context.name for m in self.members])
        start = perf_counter()
        data = None
        if lattice == EVERY_PIXEL:
            data = self._shared(camera, width, height, progress, depth, schedule, start)
        if data is None:
            data = self._alone(camera, width, height, progress, depth, lattice, schedule, start)
        schedule.seconds = perf_counter() - start
        for k, member in enumerate(self.members):
            if member.lost is not None:
                schedule.states[k] = f"lost: {member.lost}"
        data.notes["schedule"] = schedule.describe()
        return data

    # ---- all devices

    def _shared(
        self, camera: Camera, width: int, height: int, progress: Progress | None, depth: bool,
        schedule: Schedule, start: float,
    ) -> FrameData | None:  # fmt: skip
        """None if the picture cannot be divided."""
        parts: dict[int, TiledPictureParts] = {}
        for k, member in enumerate(self.members):
            if member.lost is None and isinstance(member.prepared, RendersParts):
                part = member.prepared.parts(camera, width, height, depth)
                if part is not None:
                    parts[k] = part
        if len(parts) < sum(m.lost is None for m in self.members) or not parts:
            return None
        schedule.states = ["working" if m.lost is None else "lost" for m in self.members]
        schedule.costs = [0.0] * len(self.members)
        schedule.tile = next(iter(parts.values())).tile
        sizes = next(iter(parts.values())).sizes
        arrays = [
            PictureArrays(shared_array((h, w, 4), np.float32), shared_array((h, w), np.float32) if depth else None)
            for w, h in sizes
        ]
        counts = next(iter(parts.values())).stages
        total = _Total()
        for stage, tiles in enumerate(counts):
            report = None
            if progress is not None:
                before = sum(counts[:stage])
                report = lambda done, before=before: progress(before + done, sum(counts))  # noqa: E731
            _Stage(self, parts, stage, tiles, arrays, schedule, start, total).run(report)
        notes = dict(next(iter(parts.values())).notes)
        return FrameData(arrays[-1].rgba, arrays[-1].depth, total.samples, total.rays, total.counters, notes=notes)

    def costs(self, stage: int, part: TiledPictureParts) -> tuple[np.ndarray, bool]:
        """The expected costs of a stage's tiles, and whether they were measured."""
        known = self._costs.get((stage, part.stages[stage]))
        return (known, True) if known is not None else (part.expected_costs(stage), False)

    def remember(self, stage: int, costs: np.ndarray) -> None:
        self._costs[stage, len(costs)] = costs

    def submit(self, work: Any, *arguments: Any) -> Any:
        if self._executor is None:
            self._executor = ThreadPoolExecutor(len(self.members), "clvol-device")
        return self._executor.submit(work, *arguments)

    # ---- one device

    def _alone(
        self, camera: Camera, width: int, height: int, progress: Progress | None, depth: bool, lattice: PixelLattice,
        schedule: Schedule, start: float,
    ) -> FrameData:  # fmt: skip
        """The whole picture on the fastest device that works."""
        while True:
            member = self.alive[0]
            number = self.members.index(member)
            begin = perf_counter()
            try:
                assert member.prepared is not None
                data = member.prepared.render(camera, width, height, progress, depth, lattice)
            except RenderError as error:
                self.lose(member, error)
                continue
            schedule.tile = width, height
            schedule.states = ["not needed: the picture is made by one device"] * len(self.members)
            schedule.states[number] = "working"
            schedule.costs = [float(k == number) for k in range(len(self.members))]
            schedule.spans.append(Span(number, 0, begin - start, perf_counter() - start, np.zeros(1, np.int64), True))
            return data


@dataclass
class _Total:
    samples: int = 0
    rays: int = 0
    counters: dict[str, int] = field(default_factory=dict)

    def add(self, part: PartOfPicture) -> None:
        self.samples += part.samples
        self.rays += part.rays
        for name, count in part.counters.items():
            self.counters[name] = self.counters.get(name, 0) + count


class _Stage:
    """A stage of a picture: the threads, the dispatcher that they share, and what they have done."""

    def __init__(
        self, group: DeviceGroup, parts: dict[int, TiledPictureParts], stage: int, tiles: int,
        arrays: list[PictureArrays], schedule: Schedule, start: float, total: _Total,
    ) -> None:  # fmt: skip
        self._group, self._parts, self._stage, self._arrays = group, parts, stage, arrays
        self._schedule, self._start, self._total = schedule, start, total
        costs, measured = group.costs(stage, next(iter(parts.values())))
        members = group.members
        self._dispatcher = Dispatcher(
            costs, [m.speed for m in members], [_LAUNCH] * len(members), measured=measured, least_tiles=_LEAST_TILES
        )
        for k, member in enumerate(members):
            if member.lost is not None or k not in parts:
                self._dispatcher.lost(k, member.lost or "not prepared")
        self._found = np.array(costs, np.float64)
        self._changed = threading.Condition()
        self._done = 0
        self._tiles = tiles
        self._own: dict[int, list[np.ndarray]] = {k: [] for k in parts}
        self._error: BaseException | None = None
        self._ended = False

    def run(self, report: Any) -> None:
        """Returns once all tiles are in the arrays. RenderError if no device is left."""
        futures = [self._group.submit(self._work, k) for k in self._parts if self._group.members[k].lost is None]
        try:
            self._watch(report)
        except BaseException:
            self._end()
            raise
        finally:
            for future in futures:
                future.result()
        if self._error is not None:
            raise self._error
        self._group.remember(self._stage, self._found)
        for k, share in enumerate(self._dispatcher.shares):
            self._schedule.costs[k] += share.cost
            if share.busy > 0 and share.cost > 0 and share.lost is None:
                self._group.members[k].speed = share.speed

    def _watch(self, report: Any) -> None:
        reported = -1
        with self._changed:
            while not (self._ended or self._dispatcher.complete):
                self._changed.wait(_TICK)
                if report is not None and self._done != reported:
                    reported = self._done
                    report(reported)
        if report is not None and self._error is None:
            report(self._tiles)

    def _end(self, error: BaseException | None = None) -> None:
        with self._changed:
            self._error = self._error or error
            self._ended = True
            self._changed.notify_all()

    def _work(self, device: int) -> None:
        """The thread of one device."""
        part, member = self._parts[device], self._group.members[device]
        try:
            part.begin(self._stage, self._arrays)
            while (package := self._next(device)) is not None:
                begin = perf_counter()
                found = part.render(self._stage, package.tiles)
                self._finished(package, begin, found)
            if self._own[device]:
                part.end(self._stage, np.concatenate(self._own[device]))
        except (ClvolError, MemoryError) as error:
            self._lost(device, member, error)
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
                self._changed.wait(min(max(self._dispatcher.next_stall(now), 1e-3), 1.0))
            return None

    def _finished(self, package: Package, begin: float, found: PartOfPicture) -> None:
        with self._changed:
            end = perf_counter()
            counts = self._dispatcher.finished(package, end, found.costs)
            span = Span(
                package.device, self._stage, begin - self._start, end - self._start, package.tiles, counts
            )
            self._schedule.spans.append(span)
            if counts:
                self._found[package.tiles] = found.costs
                self._own[package.device].append(package.tiles)
                self._total.add(found)
                self._done += len(package.tiles)
            self._changed.notify_all()

    def _lost(self, device: int, member: Member, error: BaseException) -> None:
        """Tiles that a device without shared memory has rendered are lost with it, too."""
        with self._changed:
            kept = member.context.is_cpu
            again = [] if kept else self._own[device]
            self._dispatcher.lost(device, str(error))
            for tiles in again:
                self._done -= self._dispatcher.undone(tiles)
            try:
                self._group.lose(member, error)
            except BaseException as last:
                self._error, self._ended = last, True
            self._changed.notify_all()
