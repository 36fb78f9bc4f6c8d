"""A device in a process of its own, as a member of a group, and the pictures that it renders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clvol.device.view import EVERY_PIXEL, Pixels
from clvol.errors import RenderError
from clvol.integrators.base import FrameData, PartOfPicture, PictureArrays, Progress
from clvol.integrators.raycast.step_map import is_smooth
from clvol.integrators.registry import integrator_of
from clvol.render.isolation.channel import Message
from clvol.render.isolation.process import DeviceProcess
from clvol.render.isolation.scene_message import decoded, encoded
from clvol.render.isolation.segments import SharedArray, shared_memory_array
from clvol.render.isolation.shared_volumes import SharedVolumes
from clvol.render.member import Member
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.volume.series import StepVolume

_MAPPED = 24  # segments that a process keeps


class IsolatedMember(Member):
    """A device that a process of its own uses. ``process`` is started, and may not have opened the device yet."""

    def __init__(self, process: DeviceProcess, volumes: SharedVolumes) -> None:
        self.process, self._volumes = process, volumes
        known = process.start()
        self.name, self.units = str(known["name"]), int(known["units"])
        self.writes_in_place = bool(known["is_cpu"])
        self._compile_seconds = 0.0
        self._sent: set[int] = set()  # volumes
        self._mapped: list[int] = []  # segments that the process has
        self._pictures: dict[int, SharedArray] = {}
        super().__init__()

    def ask(
        self,
        what: str,
        arguments: Message,
        descriptors: Sequence[int] = (),
        progress: Progress | None = None,
    ) -> Message:
        """As ``DeviceProcess.request``. An answer that lacks what it should have is a RenderError."""
        answer = self.process.request(what, arguments, descriptors, progress)
        self._compile_seconds += self.take(answer, "compile_seconds", float)
        return answer

    def take(self, answer: Message, key: str, kind: type) -> Any:
        """``answer[key]``, which has to be of this type."""
        value = answer.get(key)
        if type(value) is not kind:
            self.process.kill("it sent what cannot be read")
            raise RenderError(self.name, "its process sent what cannot be read", "a driver that works")
        return value

    def array(self, answer: Message, key: str, dtype: Any, count: int) -> np.ndarray:
        """``answer[key]``, finite numbers of this type."""
        try:
            found = decoded(answer[key])
            if found.dtype == dtype and found.shape == (count,) and np.isfinite(found).all():
                return found
        except (KeyError, TypeError, ValueError, AttributeError):
            pass
        return self.take({}, key, float)

    def segments(self, arrays: Sequence[np.ndarray | None]) -> tuple[Message, list[int]]:
        """What describes ``arrays`` in a request, and the descriptors of those that the process does not have yet."""
        described: list[Any] = []
        descriptors: list[int] = []
        for each in arrays:
            if each is None:
                described.append(None)
                continue
            assert isinstance(each, SharedArray)
            segment = each.segment
            is_new = segment.number not in self._mapped
            if is_new:
                descriptors.append(segment.descriptor)
            else:
                self._mapped.remove(segment.number)
            self._mapped.append(segment.number)
            described.append([segment.number, is_new, each.dtype.str, list(each.shape)])
        dropped, self._mapped = self._mapped[:-_MAPPED], self._mapped[-_MAPPED:]
        return {"arrays": described, "drop": dropped}, descriptors

    def picture_array(self, number: int, shape: tuple[int, ...]) -> SharedArray:
        """One of the arrays for whole pictures, which are used again."""
        kept = self._pictures.get(number)
        if kept is None or kept.shape != shape:
            kept = self._pictures[number] = shared_memory_array(shape, np.float32)
        return kept

    def prepare(self, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None) -> None:
        if isinstance(resolved.volume, StepVolume):
            is_smooth(resolved)  # looks at the widest step, which the process does not have
        scene = encoded(resolved, self._volumes.number)
        keeps = integrator_of(resolved).reads_blocks
        named = [self._volumes.number(v) for v in resolved.volumes]
        new = [number for number in dict.fromkeys(named) if number not in self._sent]
        messages = [(number, *self._volumes.message(number, keeps)) for number in new]
        descriptors = [descriptor for *_, descriptor in messages if descriptor is not None]
        volumes = [[number, facts, descriptor is not None] for number, facts, descriptor in messages]
        gone = sorted(self._sent.intersection(self._volumes.gone))
        request = {"scene": scene, "volumes": volumes, "gone": gone, "wait": wait}
        answer = self.ask("prepare", request, descriptors, progress)
        self._sent.update(new)
        self._sent.difference_update(gone)
        kind = IsolatedParts if self.take(answer, "divides", bool) else IsolatedPrepared
        self.prepared = kind(self, resolved, answer)

    def compression(self, resolved: ResolvedScene, blocks: Mapping[str, Any] | None) -> dict[str, Any]:
        return self.take(self.ask("compression", {"blocks": blocks}), "stats", dict)

    def take_compile_seconds(self) -> float:
        seconds, self._compile_seconds = self._compile_seconds, 0.0
        return seconds

    def interrupt(self, reason: str) -> None:
        self.process.kill(reason)

    def close(self) -> None:
        if self.busy_seconds:
            self.process.kill("its Renderer is closed")
        self.process.close()
        self.prepared = None  # which refers to this
        self._pictures.clear()


class IsolatedPrepared:
    """A scene that is resident on the device of ``member`` (``integrators.base.Prepared``)."""

    held: Sequence[object] = ()

    def __init__(self, member: IsolatedMember, resolved: ResolvedScene, known: Message) -> None:
        self._member, self.resolved = member, resolved
        self.renders_all_pixels = member.take(known, "renders_all_pixels", bool)
        self.visible_share = member.take(known, "visible_share", float)

    @property
    def visible_cells(self) -> tuple[np.ndarray, int] | None:
        answer = self._member.ask("visible_cells", {})
        if not self._member.take(answer, "known", bool):
            return None
        shape, shift = self._member.take(answer, "shape", list), self._member.take(answer, "shift", int)
        z, y, x = (int(n) for n in shape)
        bits = self._member.array(answer, "bits", np.uint8, -(-z * y * x // 8))
        return np.unpackbits(bits, count=z * y * x).reshape(z, y, x).astype(bool), shift

    def for_scene(self, resolved: ResolvedScene) -> IsolatedPrepared:
        raise NotImplementedError("the process keeps its prepared scenes itself")

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        self._member.ask("warm_up", {"size": [width, height], "depth": depth})

    def warm_up_for_time(self, depth: bool = True) -> None:
        self._member.ask("warm_up_for_time", {"depth": depth})

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:
        return self._picture("render", {}, camera, width, height, progress, depth, lattice)

    def render_for_time(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        *,
        seconds: float,
    ) -> FrameData:
        return self._picture("render_for_time", {"seconds": seconds}, camera, width, height, progress, depth)

    def _picture(
        self, what: str, more: Message, camera: Camera, width: int, height: int, progress: Progress | None,
        depth: bool, lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:  # fmt: skip
        member = self._member
        across, down = lattice.size(width, height)
        arrays: list[SharedArray | None] = [
            member.picture_array(0, (down, across, 4)), member.picture_array(1, (down, across)) if depth else None
        ]  # fmt: skip
        described, descriptors = member.segments(arrays)
        view = {"camera": encoded(camera), "size": [width, height], "depth": depth, "lattice": encoded(lattice)}
        view |= described
        answer = member.ask(what, {**view, **more}, descriptors, progress)
        rgba, depths = (None if each is None else np.array(each, subok=False) for each in arrays)
        assert rgba is not None
        samples, rays = member.take(answer, "samples", int), member.take(answer, "rays", int)
        counters, notes = member.take(answer, "counters", dict), member.take(answer, "notes", dict)
        return FrameData(rgba, depths, samples, rays, counters, notes=notes)


class IsolatedParts(IsolatedPrepared):
    """One that can be shared with other devices (``integrators.base.RendersParts``)."""

    def warm_up_parts(self, width: int, height: int, depth: bool = True) -> None:
        self._member.ask("warm_up_parts", {"size": [width, height], "depth": depth})

    def parts(
        self, camera: Camera, width: int, height: int, depth: bool = True, lattice: Pixels = EVERY_PIXEL
    ) -> IsolatedPicture | None:
        view = {"camera": encoded(camera), "size": [width, height], "depth": depth, "lattice": encoded(lattice)}
        answer = self._member.ask("parts", view)
        return IsolatedPicture(self._member, answer) if self._member.take(answer, "divides", bool) else None


class IsolatedPicture:
    """A picture that the process shares with others (``integrators.base.TiledPictureParts``)."""

    def __init__(self, member: IsolatedMember, known: Message) -> None:
        self._member = member
        across, down = member.take(known, "tile", list)
        self.tile: tuple[int, int] = (across, down)
        self.sizes: list[tuple[int, int]] = [(width, height) for width, height in member.take(known, "sizes", list)]
        self.stages: list[int] = member.take(known, "stages", list)
        self.notes: dict[str, Any] = member.take(known, "notes", dict)
        self.coherent = member.take(known, "coherent", bool)

    def expected_costs(self, stage: int) -> np.ndarray:
        member = self._member
        return member.array(member.ask("expected_costs", {"stage": stage}), "costs", np.float64, self.stages[stage])

    def begin(self, stage: int, arrays: list[PictureArrays]) -> None:
        flat = [array for each in arrays for array in (each.rgba, each.depth)]
        kept = arrays[stage].kept
        flat += [] if kept is None else [kept.now, kept.before]
        described, descriptors = self._member.segments(flat)
        numbers = None if kept is None else [kept.number, kept.number_before]
        self._member.ask("begin", {"stage": stage, "kept": numbers, **described}, descriptors)

    def render(self, stage: int, tiles: np.ndarray) -> PartOfPicture:
        member = self._member
        answer = member.ask("package", {"stage": stage, "tiles": encoded(tiles.astype(np.int64))})
        costs = member.array(answer, "costs", np.float64, len(tiles))
        samples, rays = member.take(answer, "samples", int), member.take(answer, "rays", int)
        return PartOfPicture(costs, samples, rays, member.take(answer, "counters", dict))

    def end(self, stage: int, tiles: np.ndarray) -> None:
        self._member.ask("end", {"stage": stage, "tiles": encoded(tiles.astype(np.int64))})


def isolated_members(names: Sequence[str]) -> list[Member]:
    """Devices in processes of their own, which share the volumes. DeviceError for one that does not work."""
    volumes, members = SharedVolumes(), list[Member]()
    processes: list[DeviceProcess] = []
    try:
        for name in names:  # they all start before the first one is waited for
            processes.append(DeviceProcess(name))
        for process in processes:
            members.append(IsolatedMember(process, volumes))
    except BaseException:
        for process in processes:
            process.close()
        raise
    return members
