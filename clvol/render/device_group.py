"""One picture on several devices: a thread per device takes packages of tiles from a ``Dispatcher`` and renders them.

All devices write the same arrays. A device that fails is left out from then on; its packages go to the others, and the
picture is the same. Integrators whose pictures cannot be divided render on the fastest device alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED
from concurrent.futures import wait as wait_for
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from clvol.device.view import EVERY_PIXEL, PixelList, Pixels
from clvol.errors import DeviceError, RenderError
from clvol.integrators.base import (
    FrameData,
    KeptDepths,
    PictureArrays,
    Prepared,
    Progress,
    RefinesInTime,
    RendersOnSeveral,
    RendersParts,
    TiledPictureParts,
)
from clvol.opencl.context import shared_array
from clvol.render.frame_schedule import Schedule, Span
from clvol.render.member import LocalMember, Member, reason_of
from clvol.render.picture_stage import FAILURES, PictureStage, Total
from clvol.render.shared_history import SharedHistory
from clvol.scene.camera import Camera
from clvol.schedule.device_thread import DeviceThread
from clvol.schedule.dispatch import Dispatcher

_LAUNCH = 5e-4  # seconds that a package takes besides its tiles, as a first guess
_LEAST_TILES = 8
_HUNG = 60.0  # seconds after a frame until a process that still works for it is ended


class Arrays(Protocol):
    """Makes arrays that all devices of a group can write to."""

    def make(self, shape: Sequence[int], dtype: Any) -> np.ndarray: ...

    def taken(self, array: np.ndarray) -> np.ndarray:
        """``array`` for the caller, if no device writes to it any more."""
        ...

    def release(self, arrays: Sequence[np.ndarray | None], still_used: bool) -> None:
        """Called after a picture with its arrays; ``still_used``: a device may still write to them."""


class OwnArrays:
    """Arrays of this process."""

    def make(self, shape: Sequence[int], dtype: Any) -> np.ndarray:
        return shared_array(shape, dtype)

    def taken(self, array: np.ndarray) -> np.ndarray:
        return array

    def release(self, arrays: Sequence[np.ndarray | None], still_used: bool) -> None:
        pass


class DeviceGroup:
    """Renders frames on ``members`` together, into ``arrays``. Not for two threads at once."""

    def __init__(self, members: Sequence[Member], arrays: Arrays | None = None) -> None:
        self.members = list(members)
        self._arrays: Arrays = arrays or OwnArrays()
        self._costs: dict[tuple[int, int], np.ndarray] = {}  # by (stage, tiles), as measured in the last frame
        self._threads: dict[int, DeviceThread] = {}
        self._history = SharedHistory(self._arrays)
        self.schedule: Schedule | None = None  # of the last frame

    def close(self) -> None:
        for thread in self._threads.values():
            thread.close()
        self._threads.clear()

    @property
    def alive(self) -> list[Member]:
        """Those that work, the fastest first."""
        return sorted((m for m in self.members if m.works), key=lambda m: -m.speed)

    def wait_for_one(self) -> None:
        """Returns once a device works. Processes that have not returned from an earlier frame for long are ended."""
        while True:
            for member in self.members:
                if member.busy_seconds > _HUNG:
                    member.interrupt(f"no answer for {member.busy_seconds:.0f} s")
            busy = [m.busy for m in self.members if m.lost is None and m.busy is not None]
            if any(m.works for m in self.members) or not busy:
                return
            wait_for(busy, 1.0, FIRST_COMPLETED)

    def lose(self, member: Member, error: BaseException) -> None:
        """Leaves ``member`` out from now on; raises ``error`` again if it was the last one."""
        member.lost = reason_of(error)
        if all(each.lost is not None for each in self.members):
            raise error

    def _lose_in_frame(self, member: Member, error: BaseException) -> BaseException | None:
        """As ``lose``; returns what to raise."""
        member.lost = reason_of(error)
        if any(each.lost is None for each in self.members):
            return None
        if len(self.members) == 1:
            return error
        reasons = "; ".join(f"{each.name}: {each.lost}" for each in self.members)
        return RenderError("devices", f"all {len(self.members)} have failed ({reasons})", "one that works")

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        """Compiles everything that a frame of this size needs, on all devices."""
        shares = len(self.members) > 1
        for member in self.alive:
            prepared = member.prepared
            if prepared is None:
                continue
            try:
                if shares and isinstance(prepared, RendersParts):
                    prepared.warm_up_parts(width, height, depth)
                else:
                    prepared.warm_up(width, height, depth)
            except FAILURES as error:
                if not shares:
                    raise
                last = self._lose_in_frame(member, error)
                if last is not None:
                    raise last from None

    def take_compile_seconds(self) -> float:
        """Seconds that the compilers of all devices took since the last call."""
        return sum(member.take_compile_seconds() for member in self.members if member.works)

    def warm_up_for_time(self, depth: bool = True) -> None:
        """Compiles everything that ``render_for_time`` needs, on all devices."""
        for member in self.alive:
            if isinstance(member.prepared, RefinesInTime):
                try:
                    member.prepared.warm_up_for_time(depth)
                except FAILURES as error:
                    if len(self.members) == 1:
                        raise
                    last = self._lose_in_frame(member, error)
                    if last is not None:
                        raise last from None

    def render_for_time(
        self, camera: Camera, width: int, height: int, progress: Progress | None = None, depth: bool = True, *,
        seconds: float,
    ) -> FrameData:  # fmt: skip
        """As ``RefinesInTime.render_for_time``, for scenes that refine; with several devices with
        ``notes["schedule"]``."""

        def alone(prepared: Prepared) -> FrameData:
            assert isinstance(prepared, RefinesInTime)
            left = max(seconds - (perf_counter() - start), 0.0)
            return prepared.render_for_time(camera, width, height, progress, depth, seconds=left)

        start = perf_counter()
        if len(self.members) == 1:
            prepared = self.members[0].prepared
            assert prepared is not None
            return alone(prepared)
        self.schedule = schedule = Schedule([m.name for m in self.members])
        data = self._on_several(camera, width, height, progress, depth, seconds, schedule, start)
        if data is None:
            data = self._alone(alone, schedule, start)
            schedule.tile = width, height
        return self._with_schedule(data, schedule, start)

    def remember_in(self, costs: dict[tuple[int, int], np.ndarray]) -> None:
        """From now on, costs of tiles by (stage, tiles), as measured in a frame, are taken from ``costs`` and kept in
        it."""
        self._costs = costs

    def render(
        self, camera: Camera, width: int, height: int, progress: Progress | None = None, depth: bool = True,
        lattice: Pixels = EVERY_PIXEL, share: bool = False,
    ) -> FrameData:  # fmt: skip
        """As ``Prepared.render``, with ``notes["schedule"]``. A lattice or a list of pixels is rendered by one device,
        or shared like a whole picture if ``share``."""
        self.schedule = schedule = Schedule([m.name for m in self.members])
        start = perf_counter()
        data = None
        if lattice == EVERY_PIXEL or share:
            data = self._shared(camera, width, height, progress, depth, schedule, start, lattice)
            data = data or self._on_several(camera, width, height, progress, depth, None, schedule, start, lattice)
        if data is None:
            render = lambda prepared: prepared.render(camera, width, height, progress, depth, lattice)  # noqa: E731
            data = self._alone(render, schedule, start)
            schedule.tile = width, height
        return self._with_schedule(data, schedule, start)

    def _with_schedule(self, data: FrameData, schedule: Schedule, start: float) -> FrameData:
        schedule.seconds = perf_counter() - start
        for k, member in enumerate(self.members):
            if member.lost is not None:
                schedule.states[k] = f"lost: {member.lost}"
        data.notes["schedule"] = schedule.describe()
        return data

    # ---- all devices

    def _shared(
        self, camera: Camera, width: int, height: int, progress: Progress | None, depth: bool,
        schedule: Schedule, start: float, lattice: Pixels,
    ) -> FrameData | None:  # fmt: skip
        """None if the picture cannot be divided."""
        parts = self._parts(camera, width, height, depth, lattice)
        if not parts:
            return None
        schedule.states = ["working" if m.works else "busy" for m in self.members]
        schedule.costs = [0.0] * len(self.members)
        first = next(iter(parts.values()))
        schedule.tile, counts = first.tile, first.stages
        coherent = all(part.coherent for part in parts.values())
        kept = self._history.begin(width, height) if coherent else None
        arrays = self._picture_arrays(first.sizes, depth, kept)
        total = Total()
        for number, tiles in enumerate(counts):
            report = None
            if progress is not None:
                before = sum(counts[:number])
                report = lambda done, before=before: progress(before + done, sum(counts))  # noqa: E731
            self._stage(parts, number, tiles, arrays, schedule, start, isinstance(lattice, PixelList), report, total)
        notes = dict(first.notes)
        if coherent:

            def again(kept: KeptDepths) -> None:
                nonlocal arrays
                self._release(arrays)
                arrays, more = self._picture_arrays(first.sizes, depth, kept), Total()
                self._stage(parts, 0, counts[0], arrays, schedule, start, False, None, more)
                total.samples += more.samples

            known, is_used = notes["coherence"], self._is_used
            notes["coherence"] = self._history.end(total.counters, known, total.samples, is_used, again)
        rgba, distances = arrays[-1].rgba, arrays[-1].depth
        take = np.array if self._is_used else self._arrays.taken  # what comes late must not change what the caller gets
        rgba, distances = take(rgba), None if distances is None else take(distances)
        self._release(arrays)
        return FrameData(rgba, distances, total.samples, total.rays, total.counters, notes=notes)

    def _picture_arrays(
        self, sizes: list[tuple[int, int]], depth: bool, kept: KeptDepths | None
    ) -> list[PictureArrays]:
        """Of the stages' ``sizes``."""
        make = self._arrays.make
        return [
            PictureArrays(make((h, w, 4), np.float32), make((h, w), np.float32) if depth else None, kept)
            for w, h in sizes
        ]

    def _release(self, arrays: list[PictureArrays]) -> None:
        self._arrays.release([a for each in arrays for a in (each.rgba, each.depth)], self._is_used)

    @property
    def _is_used(self) -> bool:
        """Whether a device may still write to arrays of the last picture."""
        return any(m.busy_seconds for m in self.members)

    def _stage(
        self, parts: dict[int, TiledPictureParts], number: int, tiles: int, arrays: list[PictureArrays],
        schedule: Schedule, start: float, is_list: bool, report: Callable[[int], None] | None, total: Total,
    ) -> None:  # fmt: skip
        """Renders a stage. ``is_list``: of a list of pixels, which is another one each time."""
        able = {k: part for k, part in parts.items() if self.members[k].works}
        dispatcher = self._dispatcher(number, tiles, able, None if is_list else self._costs.get((number, tiles)))
        stage = PictureStage(self.members, able, number, arrays, dispatcher, schedule, start, self._lose_in_frame)
        stage.run({k: self._thread(k) for k in able}, report, total)
        self._learn(None if is_list else number, stage)

    def _parts(
        self, camera: Camera, width: int, height: int, depth: bool, lattice: Pixels
    ) -> dict[int, TiledPictureParts]:
        """The picture on each device that works; none if it cannot be divided."""
        parts: dict[int, TiledPictureParts] = {}
        for k, member in enumerate(self.members):
            if not member.works or member.prepared is None:  # which it may be for another scene
                continue
            part = None
            if isinstance(member.prepared, RendersParts):
                try:
                    part = member.prepared.parts(camera, width, height, depth, lattice)
                except FAILURES as error:
                    last = self._lose_in_frame(member, error)
                    if last is not None:
                        raise last from None
                    continue
            if part is None:
                return {}
            parts[k] = part
        return parts

    def _dispatcher(
        self, stage: int, tiles: int, parts: dict[int, TiledPictureParts], costs: np.ndarray | None
    ) -> Dispatcher:
        """``costs``: of the tiles, as measured in the last frame, if there was one."""
        measured = True
        while costs is None:
            measured = False
            k = next(iter(parts))
            try:
                costs = parts[k].expected_costs(stage)
            except FAILURES as error:
                last = self._lose_in_frame(self.members[k], error)
                if last is not None:
                    raise last from None
                del parts[k]
        some = next(iter(parts.values()))
        return Dispatcher(
            costs, [m.speed for m in self.members], [_LAUNCH] * len(self.members), measured=measured,
            least_tiles=_LEAST_TILES, columns=-(-some.sizes[stage][0] // some.tile[0]),
            unsteady=[m.unsteady for m in self.members],
        )  # fmt: skip

    def _learn(self, number: int | None, stage: PictureStage) -> None:
        if number is not None:
            self._costs[number, len(stage.costs)] = stage.costs
        for member, share in zip(self.members, stage.dispatcher.shares):
            if share.busy > 0 and share.cost > 0 and share.lost is None:
                member.speed, member.unsteady = share.speed, share.unsteady

    def _thread(self, device: int) -> DeviceThread:
        if device not in self._threads:
            self._threads[device] = DeviceThread(f"clvol-device-{device}")
        return self._threads[device]

    def _on_several(
        self, camera: Camera, width: int, height: int, progress: Progress | None, depth: bool,
        seconds: float | None, schedule: Schedule, start: float, lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData | None:  # fmt: skip
        """A picture whose rays devices share; None if it has none, or if devices are in other processes."""
        last: list[BaseException | None] = [None]
        while True:
            local = {k: m for k, m in enumerate(self.members) if m.works and isinstance(m, LocalMember) and m.prepared}
            numbers = sorted(local, key=lambda k: -local[k].speed)
            first = local[numbers[0]].prepared if len(local) > 1 else None
            if not isinstance(first, RendersOnSeveral):
                return None

            def lost(device: int, error: BaseException, local=local, numbers=numbers) -> None:
                last[0] = self._lose_in_frame(local[numbers[device]], error)

            left = None if seconds is None else max(seconds - (perf_counter() - start), 0.0)
            prepared = [local[k].prepared for k in numbers]
            try:
                data = first.render_on(prepared, camera, width, height, progress, depth, lost, left, lattice)
                break
            except FAILURES as error:
                if last[0] is None and local[numbers[0]].lost is None:  # of the first one, before rays were shared
                    lost(0, error)
                if last[0] is not None:
                    raise last[0] from None
        if data is None:
            return None
        end = perf_counter() - start
        schedule.tile = width, height
        schedule.states = ["working" if m.works else "busy" for m in self.members]
        schedule.costs = [float(k in local and m.lost is None) for k, m in enumerate(self.members)]
        one = np.zeros(1, np.int64)
        schedule.spans += [Span(k, 0, 0.0, end, one, True) for k, m in local.items() if m.lost is None]
        return data

    # ---- one device

    def _alone(self, render: Callable[[Prepared], FrameData], schedule: Schedule, start: float) -> FrameData:
        """The whole picture on the fastest device that works."""
        while True:
            member = next(m for m in self.alive if m.prepared is not None)
            number = self.members.index(member)
            begin = perf_counter()
            try:
                assert member.prepared is not None
                data = render(member.prepared)
            except (RenderError, DeviceError, MemoryError) as error:
                last = self._lose_in_frame(member, error)
                if last is not None:
                    raise last from None
                continue
            schedule.states = ["not needed: the picture is made by one device"] * len(self.members)
            schedule.states[number] = "working"
            schedule.costs = [float(k == number) for k in range(len(self.members))]
            schedule.spans.append(Span(number, 0, begin - start, perf_counter() - start, np.zeros(1, np.int64), True))
            return data


class SharedRays:
    """All devices of ``group`` as one: they share lattices and lists of pixels, too."""

    def __init__(self, group: DeviceGroup) -> None:
        self._group = group

    def render(
        self, camera: Camera, width: int, height: int, progress: Progress | None = None, depth: bool = True,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:  # fmt: skip
        """As ``Prepared.render``."""
        return self._group.render(camera, width, height, progress, depth, lattice, share=True)

    @property
    def visible_cells(self) -> tuple[np.ndarray, int] | None:
        """As in ``Prepared``, of the fastest device that answers."""
        for member in self._group.alive:
            try:
                return None if member.prepared is None else member.prepared.visible_cells
            except FAILURES as error:
                self._group.lose(member, error)
        return None
