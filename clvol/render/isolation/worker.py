"""The process of a device: answers the requests of its Renderer, one after the other, and ends with it."""

from __future__ import annotations

import fcntl
import logging
import os
import select
import signal
import socket
import sys
import threading
import traceback
import warnings
from typing import Any

import numpy as np

from clvol.errors import ClvolError, ClvolWarning
from clvol.integrators.base import (
    FrameData,
    KeptDepths,
    PictureArrays,
    Progress,
    RefinesInTime,
    RendersParts,
    TiledPictureParts,
)
from clvol.opencl.context import DeviceContext
from clvol.opencl.devices import open_devices
from clvol.render.isolation.channel import Channel, ChannelClosed, Message
from clvol.render.isolation.scene_message import decoded, encoded
from clvol.render.isolation.segments import array_in, mapped
from clvol.render.isolation.shared_volumes import volume_of
from clvol.render.prepared_cache import PreparedCache
from clvol.scene.resolve import ResolvedScene
from clvol.volume.series import VolumeSeries
from clvol.volume.volume import Volume

_LOOK = 1.0  # seconds between looks for the parent


class _Stopped(Exception):
    """The Renderer does not want what was requested any more."""


class Worker:
    """A device, and the scene that is prepared on it. Each method ``on_...`` answers a request of that name."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._number = 0
        self._level = logging.WARNING
        self._descriptors: list[int] = []
        self._volumes: dict[int, Volume] = {}
        self._series: dict[int, VolumeSeries] = {}
        self._memory: dict[int, Any] = {}  # mapped segments by number
        self._scene: ResolvedScene | None = None
        self._prepared: Any = None
        self._parts: TiledPictureParts | None = None
        self._arrays: list[np.ndarray | None] = []  # that came with the request

    def serve(self) -> None:
        """Answers requests until the Renderer closes or is gone."""
        while True:
            try:
                message, self._descriptors = self._channel.receive()
            except ChannelClosed:
                return
            self._number, what = message["number"], message["request"]
            if logging.getLogger("clvol").level != message["log"]:
                logging.getLogger("clvol").setLevel(message["log"])
            if what == "close":
                self._close()
                return
            try:
                self._take_arrays(message)
                answer = getattr(self, f"on_{what}")(message)
            except _Stopped:
                answer = {}
            except ClvolError as error:
                answer = {"error": [type(error).__name__, [error.where, error.what, error.expected]]}
            except MemoryError:
                answer = {"error": ["MemoryError", ["memory", "no memory", None]]}
            except Exception:
                answer = {"fault": traceback.format_exc()}
            answer.setdefault("compile_seconds", 0.0)
            context = getattr(self, "_context", None)
            if context is not None:
                answer["compile_seconds"], context.compile_seconds = float(context.compile_seconds), 0.0
            self._channel.send({"number": self._number, **answer})

    def tell(self, kind: str, content: Any) -> None:
        self._channel.send({kind: content})

    def _close(self) -> None:
        if hasattr(self, "_context"):
            self._cache.close()
            self._context.release()

    def _progress(self, message: Message) -> Progress | None:
        """Asks the Renderer after each step whether to go on."""
        if not message["progress"]:
            return None

        def report(done: int, total: int) -> None:
            self._channel.send({"number": self._number, "progress": [int(done), int(total)]})
            if not self._channel.receive()[0]["go_on"]:
                raise _Stopped

        return report

    # ---- requests

    def on_open(self, message: Message) -> Message:
        self._context = DeviceContext(open_devices(message["device"])[0])
        self._cache = PreparedCache(self._context)
        units = int(self._context.device.max_compute_units)
        return {"name": self._context.name, "units": units, "is_cpu": self._context.is_cpu}

    def on_prepare(self, message: Message) -> Message:
        for number in message["gone"]:
            self._volumes.pop(number, None)
        for number, facts, has_file in message["volumes"]:
            descriptor = self._descriptors.pop(0) if has_file else None
            self._volumes[number] = volume_of(facts, descriptor, self._series)
        scene: ResolvedScene = decoded(message["scene"], self._volumes)
        self._parts = None
        self._prepared = self._cache.prepare(scene, self._progress(message), message["wait"])
        self._scene = scene
        return {
            "divides": isinstance(self._prepared, RendersParts),
            "renders_all_pixels": bool(self._prepared.renders_all_pixels),
            "visible_share": float(self._prepared.visible_share),
        }

    def on_compression(self, message: Message) -> Message:
        assert self._scene is not None
        return {"stats": self._cache.compression(self._scene, message["blocks"])}

    def on_warm_up(self, message: Message) -> Message:
        self._prepared.warm_up(*message["size"], message["depth"])
        return {}

    def on_warm_up_parts(self, message: Message) -> Message:
        self._prepared.warm_up_parts(*message["size"], message["depth"])
        return {}

    def on_warm_up_for_time(self, message: Message) -> Message:
        assert isinstance(self._prepared, RefinesInTime)
        self._prepared.warm_up_for_time(message["depth"])
        return {}

    def on_render(self, message: Message) -> Message:
        view = decoded(message["camera"]), *message["size"]
        report, lattice = self._progress(message), decoded(message["lattice"])
        return self._picture(message, self._prepared.render(*view, report, message["depth"], lattice))

    def on_visible_cells(self, message: Message) -> Message:
        found = self._prepared.visible_cells
        if found is None:
            return {"known": False}
        cells, shift = found
        return {
            "known": True, "shape": [int(n) for n in cells.shape], "shift": int(shift),
            "bits": encoded(np.packbits(cells)),
        }  # fmt: skip

    def on_render_for_time(self, message: Message) -> Message:
        view, seconds = (decoded(message["camera"]), *message["size"]), message["seconds"]
        made = self._prepared.render_for_time(*view, self._progress(message), message["depth"], seconds=seconds)
        return self._picture(message, made)

    def _picture(self, message: Message, made: FrameData) -> Message:
        rgba, depth = self._arrays
        assert rgba is not None
        rgba[...] = made.rgba
        if depth is not None:
            depth[...] = made.depth
        counters = {name: int(count) for name, count in made.counters.items()}
        return {"samples": int(made.samples), "rays": int(made.rays), "counters": counters, "notes": made.notes}

    def on_parts(self, message: Message) -> Message:
        view = decoded(message["camera"]), *message["size"], message["depth"], decoded(message["lattice"])
        self._parts = parts = self._prepared.parts(*view)
        if parts is None:
            return {"divides": False}
        sizes = [[int(n) for n in size] for size in parts.sizes]
        known = {"tile": [int(n) for n in parts.tile], "sizes": sizes, "stages": [int(n) for n in parts.stages]}
        return {"divides": True, **known, "notes": parts.notes, "coherent": parts.coherent}

    def on_expected_costs(self, message: Message) -> Message:
        assert self._parts is not None
        return {"costs": encoded(np.asarray(self._parts.expected_costs(message["stage"]), np.float64))}

    def on_begin(self, message: Message) -> Message:
        assert self._parts is not None
        kept, arrays = None, self._arrays
        if message["kept"] is not None:
            *arrays, now, before = arrays
            assert now is not None
            kept = KeptDepths(now, before, *message["kept"])
        both = zip(arrays[::2], arrays[1::2])
        pairs = [PictureArrays(rgba, depth, kept) for rgba, depth in both if rgba is not None]
        self._parts.begin(message["stage"], pairs)
        return {}

    def on_package(self, message: Message) -> Message:
        assert self._parts is not None
        found = self._parts.render(message["stage"], decoded(message["tiles"]))
        counters = {name: int(count) for name, count in found.counters.items()}
        costs = encoded(np.asarray(found.costs, np.float64))
        return {"costs": costs, "samples": int(found.samples), "rays": int(found.rays), "counters": counters}

    def on_end(self, message: Message) -> Message:
        assert self._parts is not None
        self._parts.end(message["stage"], decoded(message["tiles"]))
        return {}

    def _take_arrays(self, message: Message) -> None:
        """Maps the arrays that come with a request."""
        self._arrays = []
        for each in message.get("arrays", ()):
            if each is None:
                self._arrays.append(None)
                continue
            number, is_new, dtype, shape = each
            if is_new:
                nbytes = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
                self._memory[number] = mapped(self._descriptors.pop(0), max(nbytes, 1), writable=True)
            self._arrays.append(array_in(self._memory[number], np.dtype(dtype), shape))
        for number in message.get("drop", ()):
            self._memory.pop(number, None)


class _Log(logging.Handler):
    """Passes records on to the Renderer's process."""

    def __init__(self, worker: Worker) -> None:
        super().__init__()
        self._worker = worker

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._worker.tell("log", [record.name, record.levelno, record.getMessage()])
        except ChannelClosed:
            pass


def end_with_parent(lifeline: int, parent: int) -> None:
    """Ends this process when the other end of the pipe ``lifeline`` is closed: at once by a signal from the kernel,
    even while a driver holds the interpreter, and otherwise by a thread."""
    if hasattr(fcntl, "F_SETSIG"):
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    poll = select.poll()
    poll.register(lifeline, select.POLLIN)

    def watch() -> None:
        while not poll.poll(1e3 * _LOOK) and os.getppid() == parent:
            pass
        os._exit(1)

    if poll.poll(0) or os.getppid() != parent:
        os._exit(1)
    threading.Thread(target=watch, daemon=True).start()


def main(end: str, lifeline: str, parent: str) -> None:
    end_with_parent(int(lifeline), int(parent))
    worker = Worker(Channel(socket.socket(fileno=int(end))))
    logging.getLogger("clvol").addHandler(_Log(worker))

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        if isinstance(message, ClvolWarning):
            worker.tell("warning", [message.where, message.what, message.advice])

    warnings.simplefilter("always", ClvolWarning)
    warnings.showwarning = show
    worker.serve()
    sys.stdout.flush()
    os._exit(0)  # drivers may crash while they are unloaded


if __name__ == "__main__":
    main(*sys.argv[1:])
