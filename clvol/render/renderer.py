"""Renderer: a scene made resident on a device, rendered as often as wanted."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from math import inf
from time import perf_counter
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

from clvol.device.fields import field_bytes
from clvol.device.light_volume import light_volume_bytes
from clvol.errors import RenderError, UsageError, VolumeError
from clvol.integrators.base import FrameData, Prepared
from clvol.integrators.registry import check_scene, integrator_of
from clvol.opencl.context import DeviceContext
from clvol.opencl.devices import open_device
from clvol.opencl.forks import check_fork, is_forked
from clvol.render.frame import Frame, make_frame
from clvol.render.made_from import MadeFrom
from clvol.render.notices import Notices
from clvol.render.prepared_cache import PreparedCache
from clvol.scene.camera import Camera

if TYPE_CHECKING:
    from clvol.scene import Scene
    from clvol.scene.resolve import ResolvedScene
    from clvol.transfer import TransferFunction


class Renderer:
    """Keeps a scene's volume, tables and programs on a device.

    ``scene``: a ``clvol.Scene`` (or one already resolved). ``devices``: names as in ``clvol doctor``, or
    pyopencl devices; None takes the default one. ``memory_cap``: bytes that the scene may take on the
    device; what needs more is refused before anything is uploaded. ``progress(done, total)`` is called
    while the blocks of the method "multiresolution" are read. Use it as a context manager, or call ``close``.

    Several threads may call a Renderer: they take turns, and each gets the picture that it asked for. A transfer
    function that one of them sets holds for all. RenderError for a call from inside a ``progress`` of its own.

    What can hardly be meant (a blank picture, say) is told with the module ``warnings``, as a ``ClvolWarning``, once
    for each cause; ``Frame.stats["warnings"]`` lists those of a frame, if there are any.

    Raises SceneError and VolumeError (scene or volume wrong, or asking for what is not there),
    DeviceError (no device works), RenderError (a program does not build or fails).
    """

    def __init__(
        self,
        scene: Scene | ResolvedScene,
        devices: Sequence[Any] | None = None,
        memory_cap: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        start = perf_counter()
        self._lock, self._is_busy = threading.RLock(), False
        self.resolved = scene.resolve() if hasattr(scene, "resolve") else scene
        check_scene(self.resolved)
        check_memory(self.resolved, memory_cap)
        self._first_time = self.resolved.animation.time
        loaded = perf_counter()
        self._context = open_context(devices)
        self._told: WeakSet[MadeFrom] = WeakSet()
        self._prepared: Prepared | None = None
        self._cache: PreparedCache | None = PreparedCache(self._context)
        try:
            self._prepared = self._cache.prepare(self.resolved, progress)
        except BaseException:
            self.close()
            raise
        self._notices = Notices(self.resolved)
        self._load_seconds = loaded - start
        self._prepare_seconds = perf_counter() - loaded - self._context.compile_seconds

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Gives the device's memory back, when frames that other threads are rendering are done. Nothing can be
        rendered afterwards."""
        if is_forked():  # the parent's, whose threads may have held the lock
            return
        with self._turn(may_be_closed=True):
            for told in list(self._told):  # of frames that are kept: they need not keep the volume
                told()
            if self._cache is not None:
                self._cache.close()
            if self._context is not None:
                self._context.release()
            self._context = self._prepared = self._cache = None

    @contextmanager
    def _turn(self, may_be_closed: bool = False) -> Iterator[None]:
        """One thread at a time: kernels and buffers are for one frame at a time."""
        check_fork()
        with self._lock:
            if self._is_busy:  # the lock lets a thread in that holds it
                raise RenderError("Renderer", "is called by its own progress", "a call after the frame")
            if self._context is None and not may_be_closed:
                raise RenderError("Renderer", "is closed", "a Renderer that is open")
            self._is_busy = True
            try:
                yield
            finally:
                self._is_busy = False

    def render(
        self,
        camera: Camera | None = None,
        progress: Callable[[int, int], None] | None = None,
        depth: bool = True,
        time: float | None = None,
        seconds: float | None = None,
    ) -> Frame:
        """The picture from the scene's camera, or from ``camera``, at ``animation.time``, or at
        ``time`` (seconds). Neither compiles anything or uploads the volume anew.

        ``progress(done, total)`` is called now and then with shares of the work. Without ``depth``
        none is computed and ``Frame.depth`` is None.

        ``seconds``: of the method "multiresolution" alone, a picture in tiles that is refined for so
        long, where rays are needed most (in tiles of 16 pixels where the scene has none).
        ``stats["tiles"]`` then has ``share_of_pixels`` with rays of their own, and
        ``estimated_rmse``: how far, as the rays tell, it is from the picture with all rays.
        UsageError for another method. At least one ray a tile is cast, and what blocks the view
        lacks are read, however long that takes.
        """
        with self._turn():
            return self._render(camera, progress, depth, time, seconds)

    def _render(self, camera, progress, depth, time, seconds) -> Frame:
        resolved = self.resolved
        for volume in (resolved.volume, *(field.volume for field in resolved.fields)):
            volume.check_unchanged()
        by_time = {} if seconds is None else {"seconds": _checked_seconds(resolved, seconds)}
        width, height = resolved.image.width, resolved.image.height
        if camera is None:
            camera = resolved.camera
        else:
            camera = camera.complete(resolved.volume.grid, resolved.image)
        self._move_to(self._first_time if time is None else float(time), camera)
        compile_start = perf_counter()
        before = self._context.compile_seconds
        self._prepared.warm_up(width, height, depth, **{name: True for name in by_time})
        compile_seconds = before + perf_counter() - compile_start
        self._context.compile_seconds = 0.0
        start = perf_counter()
        data = self._prepared.render(camera, width, height, progress, depth, **by_time)
        times = {"compile": compile_seconds, "render": perf_counter() - start}
        return self._frame(camera, data.rgba, data.depth, times, _counted(data))

    def set_transfer_function(self, function: TransferFunction, wait: bool = True) -> None:
        """Another transfer function for the frames to come; compiles nothing, and keeps the volume.

        By the method "multiresolution" blocks are selected anew, and those that change are read. With
        ``wait`` False a thread reads them, and frames show what is there: their
        ``stats["blocks"]["pending"]`` tells how many blocks are still to come.
        """
        with self._turn():
            function = self.resolved.in_stored_values(function)
            resolved = replace(self.resolved, transfer_function=function)
            check_scene(resolved)  # what a blank scene asks for has no consequence
            self._prepared = self._cache.prepare(resolved, wait=wait)
            self.resolved = resolved
            self._notices.of_scene(resolved)

    def _move_to(self, time: float, camera: Camera) -> None:
        """What is rendered at ``time`` from ``camera``: what has a consequence may depend on both."""
        resolved = self.resolved
        is_new_time = time != resolved.animation.time
        if is_new_time:
            animation = resolved.animation.model_copy(update={"time": time})
            resolved = replace(resolved, animation=animation)
        if is_new_time or resolved.depth_cue:
            self._prepared = self._cache.prepare(replace(resolved, camera=camera))
        self.resolved = resolved  # once it is prepared

    def _frame(self, camera: Camera, rgba, depth, seconds: dict, counted: dict) -> Frame:
        first = {"load": self._load_seconds, "prepare": self._prepare_seconds}
        self._load_seconds = self._prepare_seconds = 0.0
        seconds = {**first, **seconds}
        counted |= self._notices.of_picture(self.resolved, camera, rgba, depth)
        told = MadeFrom(self.resolved, camera)
        self._told.add(told)
        return make_frame(self.resolved, rgba, depth, seconds, counted, self._context.name, told)


def _checked_seconds(resolved: ResolvedScene, seconds: float) -> float:
    integrator = integrator_of(resolved)
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
    needed = integrator.device_bytes(volume, resolved) + light_volume_bytes(resolved) + field_bytes(resolved)
    if needed > cap:
        what = f"needs {needed} bytes on the device, pictures and tables included"
        expected = f"at most the memory cap of {cap} bytes" + integrator.memory_advice(resolved)[1]
        raise VolumeError(volume.name or "volume", what, expected)


def open_context(devices: Sequence[Any] | None) -> DeviceContext:
    """The one device that is asked for, opened. UsageError for several, DeviceError for none."""
    if isinstance(devices, str) or (devices is not None and not isinstance(devices, Sequence)):
        devices = [devices]
    if devices is not None and len(devices) > 1:
        raise UsageError("devices", f"got {len(devices)}", "one device: a picture is made on one")
    chosen = devices[0] if devices else None
    device = open_device(chosen) if chosen is None or isinstance(chosen, str) else chosen
    return DeviceContext(device)


def _counted(data: FrameData) -> dict[str, Any]:
    """What a frame took, for its stats; ``counters`` only where effects counted something."""
    counted = {"samples": data.samples, "rays": data.rays, **data.notes}
    return {**counted, "counters": data.counters} if data.counters else counted
