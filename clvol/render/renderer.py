"""Renderer: a scene made resident on one or several devices, which is rendered any number of times."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import inf
from os import PathLike, fspath
from time import perf_counter
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

from clvol.device.fields import field_bytes
from clvol.device.light_volume import light_volume_bytes
from clvol.device.occlusion_volume import occlusion_bytes
from clvol.errors import DeviceError, RenderError, UsageError, VolumeError
from clvol.features.analysis import differs_in_view
from clvol.features.compression import is_compressed
from clvol.integrators.base import FrameData, Prepared, Progress, RefinesInTime
from clvol.integrators.registry import check_scene, integrator_of
from clvol.lazily import lazily
from clvol.opencl.context import DeviceContext
from clvol.opencl.devices import device_name, named_devices, open_devices
from clvol.opencl.forks import check_fork, is_forked
from clvol.render.changed_scene import with_environment
from clvol.render.device_group import DeviceGroup, SharedRays
from clvol.render.frame import Frame, make_frame
from clvol.render.frame_schedule import Schedule
from clvol.render.made_from import MadeFrom
from clvol.render.member import LocalMember, Member
from clvol.render.notices import Notices
from clvol.render.progress_bar import shown
from clvol.render.supersampling.picture import Source, rendered, supersampled
from clvol.scene.camera import Camera
from clvol.scene.channel_scenes import channel_scenes
from clvol.scene.classification import with_classification
from clvol.scene.environment import Environment
from clvol.scene.resolve import ResolvedScene
from clvol.volume.lazy import LazyVolume
from clvol.volume.series import StepVolume, is_other_step

if TYPE_CHECKING:
    import numpy as np

    from clvol.render.isolation import member as isolated
    from clvol.render.isolation import segments
    from clvol.scene import Scene
    from clvol.transfer import TransferFunction
else:
    isolated = lazily("clvol.render.isolation.member")
    segments = lazily("clvol.render.isolation.segments")


@dataclass
class _OnDevices:
    """What an open Renderer has on its devices; each member's ``prepared`` is the scene that is rendered now."""

    members: list[Member]
    group: DeviceGroup
    scene: ResolvedScene | None = None
    wait: bool | None = None  # as in the last request

    @property
    def prepared(self) -> Prepared:
        """The scene on the fastest device."""
        prepared = self.group.alive[0].prepared
        assert prepared is not None
        return prepared

    def prepare(self, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None) -> None:
        """Makes ``resolved`` the scene that is rendered, on all devices. Devices that fail are left out; the error of
        the last one is raised."""
        self.group.wait_for_one()
        for member in self.group.alive:
            try:
                if member.scene is not None and is_other_step(member.scene.volume, resolved.volume):
                    member.scene = None  # it may let go of the step that it has
                member.prepare(resolved, progress, wait)
                member.scene = resolved
            except (RenderError, DeviceError, VolumeError) as error:
                no_step = isinstance(error, VolumeError) and isinstance(resolved.volume, StepVolume)
                if len(self.members) == 1 or no_step:  # no device is to blame for a step that cannot be read
                    raise
                self.group.lose(member, error)
        self.scene, self.wait = resolved, wait

    def catch_up(self) -> None:
        """Prepares the scene on devices that were busy when it was set."""
        self.group.wait_for_one()
        if self.scene is not None and any(member.scene is not self.scene for member in self.group.alive):
            self.prepare(self.scene, wait=self.wait)

    def compression(self, resolved: ResolvedScene, blocks: Mapping[str, Any] | None) -> dict[str, Any]:
        """As ``PreparedCache.compression``, of the fastest device that answers."""
        for member in self.group.alive:
            try:
                return member.compression(resolved, blocks)
            except RenderError as error:
                self.group.lose(member, error)
        return {}

    def close(self) -> None:
        self.group.close()
        for member in self.members:
            member.close()


def _resolved(scene: Scene | ResolvedScene) -> ResolvedScene:
    """``scene``, resolved. UsageError, which says what to write, for what is no scene."""
    if isinstance(scene, ResolvedScene):
        return scene
    if hasattr(scene, "resolve") and hasattr(scene, "volume"):
        return scene.resolve()
    expected = "a scene: clvol.Scene(volume=…)"
    if isinstance(scene, (str, PathLike)):
        expected = f"a scene: clvol.load_scene({fspath(scene)!r})"
    elif isinstance(scene, Mapping):
        expected = "a scene: clvol.Scene(**tables)"
    raise UsageError("Renderer", f"got a {type(scene).__name__}", expected)


class Renderer:
    """Keeps a scene's volume, tables and programs on a device.

    ``scene``: a ``clvol.Scene`` (or one already resolved). ``devices``: names as in ``clvol doctor`` ("all", and
    "NAME:k/n" for the k-th of n equal parts of a device, too), or pyopencl devices; None takes the default one.
    Several devices share each picture; one that fails is left out, with a warning. ``memory_cap``: bytes that the
    scene may take on a device; a scene that needs more is refused before anything is uploaded.
    ``isolate``: each device is used by a process of its own, so that a driver that crashes or hangs costs what it was
    rendering, and nothing else; the crash of the last one is a RenderError.
    ``progress(done, total)`` is called while voxels are encoded ([compression]), and while the blocks of the method
    "multiresolution" are read; True shows a bar. Use the Renderer as a context manager, or call ``close``.

    Several threads may call a Renderer: they take turns, and each gets the picture that it requested. A transfer
    function that one of them sets holds for all. A call from inside the Renderer's own ``progress`` raises
    RenderError.

    Pictures that can hardly be intended (a blank one, for example) are reported by the module ``warnings``, as a
    ``ClvolWarning``, once per cause; ``Frame.stats["warnings"]`` lists those of a frame, if there are any.

    Raises SceneError and VolumeError (the scene or the volume is wrong, or refers to something that does not exist),
    DeviceError (no device works), RenderError (a program does not build or fails).
    """

    def __init__(
        self,
        scene: Scene | ResolvedScene,
        devices: Sequence[Any] | None = None,
        memory_cap: int | None = None,
        progress: Progress | bool | None = None,
        isolate: bool = False,
    ) -> None:
        start = perf_counter()
        self._lock, self._is_busy = threading.RLock(), False
        self._memory_cap = memory_cap
        self.resolved = _checked(scene, memory_cap)
        self._first_time = self.resolved.animation.time
        self._last_step: int | None = None  # of a series
        loaded = perf_counter()
        self._provenances: WeakSet[MadeFrom] = WeakSet()
        if isolate:
            members: list[Member] = isolated.isolated_members(requested_names(devices))
            group = DeviceGroup(members, segments.PictureMemory())
        else:
            members = [LocalMember(context) for context in open_contexts(devices)]
            group = DeviceGroup(members)
        on_devices = _OnDevices(members, group)
        try:
            with shown(progress, "preparing") as report:
                on_devices.prepare(self.resolved, report)
        except BaseException:
            on_devices.close()
            raise
        self._on_device: _OnDevices | None = on_devices
        self._notices = Notices(self.resolved)
        self._load_seconds = loaded - start
        self._compile_seconds = sum(member.take_compile_seconds() for member in members)
        self._prepare_seconds = perf_counter() - loaded - self._compile_seconds

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Frees the device's memory, once the frames that other threads are rendering are done. Nothing can be
        rendered afterwards."""
        if is_forked():  # the device belongs to the parent, whose threads may have held the lock
            return
        with self._alone():
            for provenance in list(self._provenances):  # frames that are still in use need not hold the volume
                if provenance.holds_voxels:
                    provenance()
            if self._on_device is not None:
                self._on_device.close()
            self._on_device = None

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Lets in one thread at a time: kernels and buffers are for one frame at a time."""
        check_fork()
        with self._lock:
            if self._is_busy:  # the lock admits the thread that holds it already
                raise RenderError("Renderer", "is called by its own progress", "a call after the frame")
            self._is_busy = True
            try:
                yield
            finally:
                self._is_busy = False

    @contextmanager
    def _turn(self) -> Iterator[_OnDevices]:
        """As ``_alone``, for a Renderer that is open."""
        with self._alone():
            if self._on_device is None:
                raise RenderError("Renderer", "is closed", "a Renderer that is open")
            yield self._on_device

    def render(
        self,
        camera: Camera | Mapping[str, Any] | None = None,
        progress: Progress | bool | None = None,
        depth: bool = True,
        time: float | None = None,
        seconds: float | None = None,
        next_time: float | None = None,
    ) -> Frame:
        """The picture from the scene's camera, or from ``camera`` (a ``clvol.Camera``, or a dict of its keys), at
        ``animation.time``, or at ``time`` (seconds). A new camera or time compiles nothing and uploads no volume.

        Of a volume that changes over time, the picture shows the step of ``time``. ``next_time``: the time of the
        picture that will be rendered next; its step is read while this one is rendered. Without it the next step is
        expected to be as far from this one as this one is from the one before.

        ``progress(done, total)`` is called now and then with shares of the work; True shows a bar with the remaining
        time, in notebooks and on terminals (extra "notebook"). Without ``depth``
        no depth is computed and ``Frame.depth`` is None.

        ``seconds``: with the method "multiresolution", the picture is refined for this time, in tiles (of 16 pixels
        where the scene sets none), where rays are needed most. ``stats["tiles"]`` then has ``share_of_pixels``, the
        share that have rays of their own, and ``estimated_rmse``, the distance from the picture with all rays as
        estimated from the rays. At least one ray per tile is cast, and blocks that the view lacks are read,
        however long that takes. UsageError for another method.
        """
        with self._turn() as on_devices, shown(progress, "rendering") as report:
            return self._render(on_devices, camera, report, depth, time, seconds, next_time)

    def _render(
        self,
        on_devices: _OnDevices,
        camera: Camera | Mapping[str, Any] | None,
        progress: Progress | None,
        depth: bool,
        time: float | None,
        seconds: float | None,
        next_time: float | None,
    ) -> Frame:
        resolved = self.resolved
        for volume in resolved.volumes:
            volume.check_unchanged()
        if seconds is not None:
            seconds = _checked_seconds(resolved, seconds)
        width, height = resolved.image.width, resolved.image.height
        if camera is None:
            camera = resolved.camera
        else:
            if isinstance(camera, Mapping):
                camera = Camera(**camera)
            camera = camera.complete(resolved.volume.grid, resolved.image, frame=resolved.volume.frame)
        self._move_to(on_devices, self._first_time if time is None else float(time), camera)
        group = on_devices.group
        on_devices.catch_up()
        self._read_ahead(next_time)
        before = self._compile_seconds + group.take_compile_seconds()
        compile_start = perf_counter()
        if seconds is None:
            group.warm_up(width, height, depth)
        else:
            _refining(on_devices.prepared)
            group.warm_up_for_time(depth)
            if resolved.image.samples > 1:
                group.warm_up(width, height, depth)
        compile_seconds = before + perf_counter() - compile_start
        group.take_compile_seconds()
        self._compile_seconds = 0.0
        start = perf_counter()
        source: Source = on_devices.prepared if len(on_devices.members) == 1 else SharedRays(group)
        if seconds is None:
            data = rendered(source, self.resolved, camera, width, height, progress, depth)
        elif self.resolved.image.samples > 1:
            data = supersampled(
                source, self.resolved, camera, width, height, progress, depth,
                lambda s: group.render_for_time(camera, width, height, None, depth, seconds=s), seconds,
            )  # fmt: skip
        else:
            data = group.render_for_time(camera, width, height, progress, depth, seconds=seconds)
        times = {"compile": compile_seconds, "render": perf_counter() - start}
        names = [member.name for member in on_devices.members if member.lost is None]
        self._notices.of_devices({m.name: m.lost for m in on_devices.members if m.lost is not None}, names)
        counted = on_devices.compression(self.resolved, data.notes.get("blocks"))
        for name, value in _counted(data).items():
            counted[name] = counted.get(name, {}) | value if name == "compression" else value
        return self._frame(names, camera, data.rgba, data.depth, times, counted)

    def set_scene(self, scene: Scene | ResolvedScene, progress: Progress | None = None) -> None:
        """Makes another scene the one that is rendered. Programs, volumes and tables that it has in common with those
        before are not made again: use it for many pictures of one volume. ``progress``: as for the Renderer. Raises
        what making a Renderer raises; the scene before then stays."""
        with self._turn() as on_devices:
            start = perf_counter()
            resolved = _checked(scene, self._memory_cap)
            loaded = perf_counter()
            if differs_in_view(resolved, self.resolved):  # what is prepared is rendered from any camera
                self._notices = self._notices.anew()
            else:
                on_devices.prepare(resolved, progress)
                self._notices = Notices(resolved)
            self.resolved, self._first_time = resolved, resolved.animation.time
            compile_seconds = on_devices.group.take_compile_seconds()
            self._load_seconds, self._compile_seconds = loaded - start, compile_seconds
            self._prepare_seconds = perf_counter() - loaded - compile_seconds

    @property
    def schedule(self) -> Schedule | None:
        """Who rendered what of the last frame; None before the first, and for a Renderer with one device."""
        return None if self._on_device is None else self._on_device.group.schedule

    def set_transfer_function(self, function: TransferFunction, wait: bool = True) -> None:
        """Sets another transfer function for the frames to come; compiles nothing, and keeps the volume. (Where the
        scene's classification is "auto" and the other one suits the function better, its program is compiled once.)

        The method "multiresolution" selects blocks anew and reads those that change. With
        ``wait`` False a thread reads them, and frames show those that are there: their
        ``stats["blocks"]["pending"]`` is the number of blocks still to come.
        """
        with self._turn() as on_devices:
            if self.resolved.channels:
                raise UsageError("set_transfer_function", "called for a scene of channels", "set_scene")
            resolved = with_classification(self.resolved.with_function(function))
            check_scene(resolved)  # a blank scene may hide effects that this one has
            on_devices.prepare(resolved, wait=wait)
            self.resolved = resolved
            self._notices.of_scene(resolved)

    def set_environment(self, environment: Environment | Mapping[str, Any] | None) -> None:
        """Sets another [environment] for the frames to come: a ``clvol.Environment``, a dict of its keys, or None for
        none. The file's name is relative to the scene's folder. It keeps the volume, and compiles nothing where the
        environment before did the same: lit the scene, or was ``visible``, or both.

        Raises SceneError for a file that is not there or that is no environment, and for what the method cannot do;
        the environment before then stays.
        """
        with self._turn() as on_devices:
            resolved = with_environment(self.resolved, environment)
            check_scene(resolved)
            on_devices.prepare(resolved)
            self.resolved = resolved
            self._notices.of_scene(resolved)

    def _move_to(self, on_devices: _OnDevices, time: float, camera: Camera) -> None:
        """Prepares the scene for ``time`` and ``camera``: which effects have a consequence may depend on both."""
        resolved = self.resolved
        is_new_time = time != resolved.animation.time
        if is_new_time:
            resolved = resolved.at(time)
        if isinstance(resolved.volume, StepVolume):
            resolved.volume.read()  # before anything is let go for it
        if is_new_time or resolved.depth_cue:
            on_devices.prepare(replace(resolved, camera=camera))
        self.resolved = resolved  # only once it is prepared

    def _read_ahead(self, time: float | None) -> None:
        """Begins to read the step of ``time``, or the one that is expected next."""
        volume, times = self.resolved.volume, self.resolved.steps
        if times is None or not isinstance(volume, StepVolume):
            return
        before, self._last_step = self._last_step, volume.number
        if time is not None:
            volume.series.read_ahead(times.at(float(time)))
        elif before is not None and before != volume.number:
            following = 2 * volume.number - before
            volume.series.read_ahead(following % times.count if times.loop else following)

    def _frame(
        self,
        devices: list[str],
        camera: Camera,
        rgba: np.ndarray,
        depth: np.ndarray | None,
        seconds: dict[str, float],
        counted: dict[str, Any],
    ) -> Frame:
        first = {"load": self._load_seconds, "prepare": self._prepare_seconds}
        self._load_seconds = self._prepare_seconds = 0.0
        seconds = {**first, **seconds}
        counted |= self._notices.of_picture(self.resolved, camera, rgba, depth, counted.get("compression"))
        made_from = MadeFrom(self.resolved, camera)
        self._provenances.add(made_from)
        return make_frame(self.resolved, rgba, depth, seconds, counted, devices, made_from, camera)


def _checked(scene: Scene | ResolvedScene, memory_cap: int | None) -> ResolvedScene:
    """``scene`` resolved, if it can be rendered within ``memory_cap``."""
    resolved = _resolved(scene)
    check_scene(resolved)
    check_memory(resolved, memory_cap)
    return _with_voxels(resolved)


def _refining(prepared: Prepared) -> RefinesInTime:
    """``prepared``, of an integrator that ``refines_in_time``."""
    if not isinstance(prepared, RefinesInTime):
        raise TypeError(f"{type(prepared).__name__} does not refine pictures in time")
    return prepared


def _checked_seconds(resolved: ResolvedScene, seconds: float) -> float:
    integrator = integrator_of(resolved)
    if resolved.channels:
        raise UsageError("seconds", "given for a scene of channels", "one channel, or the blend 'mix'")
    if not integrator.refines_in_time(resolved):
        if integrator.reads_blocks:
            stepping = resolved.multiresolution.stepping
            raise UsageError("seconds", f"given with the stepping {stepping!r}", "another stepping")
        raise UsageError("seconds", f"given with the method {integrator.name!r}", "'multiresolution'")
    if not 0.0 < seconds < inf:
        raise UsageError("seconds", f"got {seconds!r}", "seconds, more than 0")
    return float(seconds)


def check_memory(resolved: ResolvedScene, cap: int | None) -> None:
    """VolumeError if rendering takes more than ``cap`` bytes on the device."""
    if cap is None:
        return
    integrator, volume = integrator_of(resolved), resolved.volume
    scenes = channel_scenes(resolved)
    needed = sum(integrator.device_bytes(each.volume, each) + light_volume_bytes(each) for each in scenes)
    needed += sum(map(occlusion_bytes, scenes))
    needed += 0 if integrator.reads_blocks else field_bytes(resolved)  # they are in the memory for blocks
    if needed > cap:
        what = f"needs {needed} bytes on the device, pictures and tables included"
        expected = f"at most the memory cap of {cap} bytes" + integrator.memory_advice(resolved)[1]
        raise VolumeError(volume.name or "volume", what, expected)


def _with_voxels(resolved: ResolvedScene) -> ResolvedScene:
    """``resolved``, with the voxels read that its integrator takes as a whole: how it renders may depend on them."""
    volume = resolved.volume
    if resolved.channels and not integrator_of(resolved).reads_blocks:
        for channel in resolved.channels:
            _ = channel.volume.data
        return replace(resolved)  # the scenes of its channels depend on voxels, too
    if not isinstance(volume, LazyVolume) or integrator_of(resolved).reads_blocks or is_compressed(resolved):
        return resolved
    _ = volume.data
    return with_classification(resolved)


def open_contexts(devices: Sequence[Any] | None) -> list[DeviceContext]:
    """The devices that are requested, opened; the default one if there are none. DeviceError for one that does not
    work."""
    opened: list[Any] = []
    for each in _requested(devices):
        opened += open_devices(each) if each is None or isinstance(each, str) else [each]
    twice = [device for k, device in enumerate(opened) if device in opened[:k]]
    if twice:
        raise UsageError("devices", f"the device {device_name(twice[0])!r} twice", "each device once")
    return [DeviceContext(device) for device in opened]


def requested_names(devices: Sequence[Any] | None) -> list[str]:
    """The names of the devices that are requested; none is opened."""
    names: list[str] = []
    for each in _requested(devices):
        names += named_devices(each) if each is None or isinstance(each, str) else [device_name(each)]
    twice = [name for k, name in enumerate(names) if name in names[:k]]
    if twice:
        raise UsageError("devices", f"the device {twice[0]!r} twice", "each device once")
    return names


def _requested(devices: Sequence[Any] | None) -> Sequence[Any]:
    if isinstance(devices, str) or (devices is not None and not isinstance(devices, Sequence)):
        return [devices]
    return devices or [None]


def open_context(devices: Sequence[Any] | None) -> DeviceContext:
    """The first of the devices that are requested, opened."""
    return open_contexts(devices if devices is None or isinstance(devices, str) else list(devices)[:1])[0]


def _counted(data: FrameData) -> dict[str, Any]:
    """The numbers of a frame for its stats; ``counters`` only where effects counted something."""
    counted = {"samples": data.samples, "rays": data.rays, **data.notes}
    return {**counted, "counters": data.counters} if data.counters else counted
