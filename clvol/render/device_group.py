"""One picture on several devices: a thread per device takes packages of tiles from a ``Dispatcher`` and renders them.

All devices write the same arrays. A device that fails is left out from then on; its packages go to the others, and the
picture is the same. Integrators whose pictures cannot be divided render on the fastest device alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from clvol.errors import DeviceError, RenderError
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
from clvol.schedule.crew import Crew, Job
from clvol.schedule.dispatch import Dispatcher, Package

_LAUNCH = 5e-4  # seconds that a package takes besides its tiles, as a first guess
_SPEED = 2e8  # cost per second and compute unit, as a first guess
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


class DeviceGroup:
    """Renders frames on ``members`` together. Not for two threads at once."""

    def __init__(self, members: Sequence[Member]) -> None:
        self.members = list(members)
        self._costs: dict[tuple[int, int], np.ndarray] = {}  # (stage, tiles): as measured in the last frame
        self.crew = Crew(len(self.members))
        self.schedule: Schedule | None = None  # of the last frame

    def close(self) -> None:
        self.crew.close()

    @property
    def alive(self) -> list[Member]:
        """Those that work, the fastest first."""
        return sorted((m for m in self.members if m.lost is None), key=lambda m: -m.speed)

    def lose(self, member: Member, error: BaseException) -> None:
        """Leaves ``member`` out from now on; raises ``error`` again if it was the last one."""
        member.lost = " ".join(str(error).split())
        if not self.alive:
            raise error

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
        self, camera: Camera, width: int, height: int, progress: Progress | None = None, depth: bool = True
    ) -> FrameData:
        """As ``Prepared.render``, with ``notes["schedule"]``."""
        self.schedule = schedule = Schedule([m.context.name for m in self.members])
        start = perf_counter()
        data = self._shared(camera, width, height, progress, depth, schedule, start)
        if data is None:
            data = self._alone(camera, width, height, progress, depth, schedule, start)
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
        for stage in range(len(counts)):
            report = None
            if progress is not None:
                before = sum(counts[:stage])
                report = lambda done, before=before: progress(before + done, sum(counts))  # noqa: E731
            _Stage(self, parts, stage, arrays, schedule, start, total).run(report)
        notes = dict(next(iter(parts.values())).notes)
        return FrameData(arrays[-1].rgba, arrays[-1].depth, total.samples, total.rays, total.counters, notes=notes)

    def costs(self, stage: int, part: TiledPictureParts) -> tuple[np.ndarray, bool]:
        """The expected costs of a stage's tiles, and whether they were measured."""
        known = self._costs.get((stage, part.stages[stage]))
        return (known, True) if known is not None else (part.expected_costs(stage), False)

    def remember(self, stage: int, costs: np.ndarray) -> None:
        self._costs[stage, len(costs)] = costs

    # ---- one device

    def _alone(
        self, camera: Camera, width: int, height: int, progress: Progress | None, depth: bool,
        schedule: Schedule, start: float,
    ) -> FrameData:  # fmt: skip
        """The whole picture on the fastest device that works."""
        while True:
            member = self.alive[0]
            number = self.members.index(member)
            begin = perf_counter()
            try:
                assert member.prepared is not None
                data = member.prepared.render(camera, width, height, progress, depth)
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


class _TileHand:
    """A device at the tiles of a stage."""

    def __init__(self, member: Member, part: TiledPictureParts, stage: int, arrays: list[PictureArrays]) -> None:
        self._part, self._stage, self._arrays = part, stage, arrays
        self.keeps = member.context.is_cpu  # it writes into the arrays that are shared

    def begin(self) -> None:
        self._part.begin(self._stage, self._arrays)

    def work(self, items: np.ndarray) -> tuple[np.ndarray, PartOfPicture]:
        found = self._part.render(self._stage, items)
        return found.costs, found

    def end(self, items: np.ndarray) -> None:
        self._part.end(self._stage, items)


class _Stage:
    """A stage of a picture, shared by the devices that have ``parts`` of it."""

    def __init__(
        self, group: DeviceGroup, parts: dict[int, TiledPictureParts], stage: int, arrays: list[PictureArrays],
        schedule: Schedule, start: float, total: _Total,
    ) -> None:  # fmt: skip
        self._group, self._stage, self._schedule, self._start, self._total = group, stage, schedule, start, total
        costs, measured = group.costs(stage, next(iter(parts.values())))
        members = group.members
        self._dispatcher = Dispatcher(
            costs, [m.speed for m in members], [_LAUNCH] * len(members), measured=measured, least_tiles=_LEAST_TILES
        )
        for k, member in enumerate(members):
            if member.lost is not None or k not in parts:
                self._dispatcher.lost(k, member.lost or "not prepared")
        self._found = np.array(costs, np.float64)
        hands = {k: _TileHand(members[k], part, stage, arrays) for k, part in parts.items()}
        self._job = Job(group.crew, self._dispatcher, hands, self._done, self._lost)

    def run(self, report: Callable[[int], None] | None) -> None:
        """Returns once all tiles are in the arrays. RenderError if no device is left."""
        self._job.run(report)
        self._group.remember(self._stage, self._found)
        for k, share in enumerate(self._dispatcher.shares):
            self._schedule.costs[k] += share.cost
            if share.busy > 0 and share.cost > 0 and share.lost is None:
                self._group.members[k].speed = share.speed

    def _done(
        self, package: Package, begin: float, end: float, costs: np.ndarray, found: PartOfPicture, counts: bool
    ) -> None:
        begin, end = begin - self._start, end - self._start
        self._schedule.spans.append(Span(package.device, self._stage, begin, end, package.tiles, counts))
        if counts:
            self._found[package.tiles] = costs
            self._total.add(found)

    def _lost(self, device: int, error: BaseException) -> None:
        self._group.lose(self._group.members[device], error)
