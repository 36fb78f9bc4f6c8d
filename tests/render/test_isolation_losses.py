"""Processes of devices that die, hang or send garbage: the picture is complete and the same, and nothing is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from contextlib import suppress

import numpy as np
import pytest
from helpers.isolation import assert_same, is_gone, scene, states, told_by, workers
from helpers.small_scenes import SMOOTH

from clvol import Renderer
from clvol.errors import DeviceError, RenderError, UsageError
from clvol.opencl.devices import device_name, report_of
from clvol.render import picture_stage
from clvol.render.isolation.channel import Channel
from clvol.render.isolation.member import IsolatedPicture
from clvol.render.isolation.process import DeviceProcess
from clvol.schedule import dispatch


class Fault:
    """Something that happens to a process at its ``number``-th request of a name, before it is sent."""

    def __init__(self, monkeypatch, worker: DeviceProcess, name: str, number: int, happens) -> None:
        self.happened, self._seen, self._leads = False, 0, threading.Event()
        real = DeviceProcess.request

        def request(this, what, *arguments, **named):
            if this is worker and what == name:
                self._seen += 1
                if self._seen == number + 1:
                    self.happened = True
                    happens(this.pid)
            if this is worker and what == "package":
                self._leads.set()
            elif this is not worker and what == "package" and not worker._reason:
                self._leads.wait(1.0)
            return real(this, what, *arguments, **named)

        monkeypatch.setattr(DeviceProcess, "request", request)


def killed(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)


def killed_in_the_middle(pid: int) -> None:
    """While the request is pending."""

    def end() -> None:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)

    os.kill(pid, signal.SIGSTOP)
    threading.Timer(0.3, end).start()


def aborted(pid: int) -> None:
    """Compilers in drivers (LLVM) have a handler, which lets the process go on after the first signal from outside."""
    while not is_gone(pid):
        os.kill(pid, signal.SIGABRT)
        time.sleep(0.02)


POINTS = [("prepare", 0), ("warm_up_parts", 0), ("parts", 0), ("begin", 0), ("package", 0), ("package", 1), ("end", 0)]


@pytest.mark.parametrize("kind", ["plain", "fewer rays"])
@pytest.mark.parametrize("where, number", [*POINTS, ("begin", 1), ("end", 1)])
@pytest.mark.parametrize("happens", [killed, killed_in_the_middle, aborted])
def test_a_process_that_dies_costs_its_package(device, isolated, halves, monkeypatch, kind, where, number, happens):
    if where in ("begin", "end") and number == 1 and kind == "plain":
        pytest.skip("the picture has one stage")
    made = scene(kind)
    with Renderer(made, devices=[device]) as here:
        expected = here.render()
    renderer = isolated(made, halves)
    renderer.render()
    with monkeypatch.context() as patch:
        fault = Fault(patch, workers(renderer)[1], where, number, happens)
        if where == "prepare":
            renderer.set_transfer_function(SMOOTH)
        frame, told = told_by(renderer.render)
    assert_same(frame, expected)
    assert fault.happened or number == 1  # it may get one package only, and none in the first stage
    if fault.happened and not told:
        time.sleep(1.0)  # until the death is noticed
    again, later = told_by(renderer.render)  # it stays out
    assert_same(again, expected)
    if not fault.happened:
        return
    assert told or number == 1  # in the second stage, the others may be done before the death is noticed
    how = "crashed (SIGABRT)" if happens is aborted else "was killed (SIGKILL)"
    assert len(told + later) == 1 and how in (told + later)[0]
    for each in (frame, again) if told else (again,):
        assert states(each)[1].startswith("lost") and how in states(each)[1]
        assert each.stats["devices"] == halves[:1]


def test_the_only_process_dies(device, isolated, monkeypatch):
    renderer = isolated(scene(), [device])
    renderer.render()
    Fault(monkeypatch, workers(renderer)[0], "render", 0, aborted)
    with pytest.raises(RenderError, match=r"its process crashed \(SIGABRT\)") as caught:
        renderer.render()
    assert caught.value.exit_status == 4 and "\n" not in str(caught.value)
    with pytest.raises(RenderError, match="its process"):
        renderer.render()


def test_all_processes_die(isolated, halves, monkeypatch):
    renderer = isolated(scene(), halves)
    renderer.render()
    for worker in workers(renderer):
        os.kill(worker.pid, signal.SIGKILL)
    with pytest.raises(RenderError, match="SIGKILL") as caught:
        renderer.render()
    assert caught.value.exit_status == 4


@pytest.mark.parametrize("where", ["package", "end"])
def test_a_process_that_hangs_costs_its_package(device, isolated, halves, monkeypatch, where):
    """It is not waited for, takes part again if it goes on, and does not keep a Renderer from closing."""
    made = scene()
    with Renderer(made, devices=[device]) as here:
        expected = here.render()
    renderer = isolated(made, halves)
    for _ in range(3):
        renderer.render()
    for member in renderer._on_device.members:  # so that a package soon counts as stalled, on a busy machine, too
        member.speed = 1e9
    worker = workers(renderer)[1]
    with monkeypatch.context() as patch:
        patch.setattr(dispatch, "_PATIENCE", 0.2)
        patch.setattr(picture_stage, "_FETCH_PATIENCE", 0.2)
        Fault(patch, worker, where, 0, lambda pid: os.kill(pid, signal.SIGSTOP))
        start = time.perf_counter()
        frame, told = told_by(renderer.render)
    assert_same(frame, expected)
    assert not told and states(frame)[1].startswith("stalled") and time.perf_counter() - start < 20
    kept = frame.rgba.copy()
    frame = renderer.render()
    assert_same(frame, expected)
    assert states(frame)[1] == "busy"
    os.kill(worker.pid, signal.SIGCONT)
    renderer._on_device.members[1].busy.result(10.0)
    np.testing.assert_array_equal(frame.rgba, kept)
    frame = renderer.render()
    assert_same(frame, expected)
    assert states(frame) == ["working"] * 2
    os.kill(worker.pid, signal.SIGSTOP)  # and now it stays there
    renderer._on_device.members[1].leave_busy(Future())
    renderer.close()
    assert is_gone(worker.pid)


def test_a_process_that_hangs_for_ever_is_ended_where_nobody_can_help(isolated, halves, monkeypatch):
    monkeypatch.setattr(picture_stage, "_HUNG", 0.3)
    monkeypatch.setattr(picture_stage, "_HUNG_TIMES", 5.0)
    renderer = isolated(scene(), halves)
    for _ in range(2):
        renderer.render()
    real = IsolatedPicture.render

    def hang(self, stage, tiles):
        os.kill(self._member.process.pid, signal.SIGSTOP)
        return real(self, stage, tiles)

    monkeypatch.setattr(IsolatedPicture, "render", hang)
    with pytest.raises(RenderError, match="was ended: no answer for") as caught:
        renderer.render()
    assert caught.value.exit_status == 4


def test_what_a_process_sends_is_not_trusted(device, isolated, halves, monkeypatch):
    """Garbage in place of a message, and answers that lack what they should have, are losses."""
    made = scene()
    with Renderer(made, devices=[device]) as here:
        expected = here.render()
    for garbage in (b"\x00\x00\x00\x02{]", b"\xff" * 64, b"\x00\x00\x00\x02[]"):
        renderer = isolated(made, halves)
        renderer.render()
        worker, real = workers(renderer)[1], Channel._read

        def read(self, end, worker=worker, real=real, garbage=garbage):
            if self is worker._channel:
                self._rest += garbage
            else:
                real(self, end)

        with monkeypatch.context() as patch:
            patch.setattr(Channel, "_read", read)
            frame, told = told_by(renderer.render)
        assert_same(frame, expected)
        assert len(told) == 1 and "cannot be read" in told[0] and is_gone(worker.pid)
    for answer in ({}, {"divides": 1}, {"divides": True, "tile": 3}, {"compile_seconds": None, "divides": True}):
        renderer = isolated(made, halves)
        renderer.render()
        worker, real = workers(renderer)[1], DeviceProcess.request

        def request(this, what, *arguments, worker=worker, real=real, answer=answer, **named):
            known = real(this, what, *arguments, **named)
            return {"compile_seconds": 0.0, **answer} if this is worker and what == "parts" else known

        with monkeypatch.context() as patch:
            patch.setattr(DeviceProcess, "request", request)
            frame, told = told_by(renderer.render)
        assert_same(frame, expected)
        assert len(told) == 1 and "cannot be read" in told[0] and is_gone(worker.pid)


# ---- errors, progress, ends


def test_progress_may_interrupt_and_the_next_frame_is_whole(device, isolated, halves):
    made = scene()
    with Renderer(made, devices=[device]) as here:
        expected = here.render()
    for names in ([device], halves):
        renderer = isolated(made, names)
        seen = []
        renderer.render(progress=lambda done, total: seen.append((done, total)))
        assert seen == sorted(seen) and seen[-1][0] == seen[-1][1]

        class Enough(Exception):
            pass

        def stop(done, total):
            raise Enough  # noqa: B023

        with pytest.raises(Enough):
            renderer.render(progress=stop)
        assert_same(renderer.render(), expected)


def test_errors_and_warnings_come_through(device, isolated, monkeypatch):
    with pytest.raises(DeviceError, match="none-such"):
        Renderer(scene(), devices=["none-such"], isolate=True)
    name = report_of(device).name
    with pytest.raises(DeviceError, match="not a part of a device") as caught:
        Renderer(scene(), devices=[f"{name}:3/2"], isolate=True)
    assert caught.value.exit_status == 3
    with pytest.raises(UsageError, match="twice"):
        Renderer(scene(), devices=[name, name], isolate=True)
    renderer = isolated(scene(), [device])
    (worker,) = workers(renderer)
    with pytest.raises(RuntimeError, match="KeyError"):  # a fault of the program, with its traceback
        worker.request("prepare", {})
    assert renderer.render().rgba.any()


def test_processes_end_with_the_one_that_started_them(device):
    """Killed in the middle of a frame; and even a process that is stopped, so that none of its threads runs."""
    code = f"""
import numpy as np, os, signal, time, clvol
volume = clvol.Volume(np.arange(64, dtype=np.uint8).reshape(4, 4, 4))
scene = clvol.Scene(volume=volume, image={{"width": 8, "height": 8}})
renderer = clvol.Renderer(scene, devices=[{device_name(device)!r}], isolate=True)
pid = renderer._on_device.members[0].process.pid
os.kill(pid, signal.SIGSTOP)
print(pid, flush=True)
time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        assert not is_gone(pid)
        parent.kill()
    end = time.monotonic() + 5.0
    while not is_gone(pid) and time.monotonic() < end:
        time.sleep(0.05)
    assert is_gone(pid)


def test_a_forked_child_leaves_the_process_to_its_parent(device, isolated):
    renderer = isolated(scene(), [device])
    (worker,) = workers(renderer)
    child = os.fork()
    if child == 0:
        try:
            worker.request("warm_up", {})
        except DeviceError:
            worker.close()
            os._exit(7)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    assert renderer.render().rgba.any()


def test_nothing_is_left_open(device, isolated):
    def descriptors() -> int:
        return len(os.listdir("/proc/self/fd"))

    for _ in range(2):
        renderer = isolated(scene(), [device])
        renderer.render()
        renderer.close()
        before = descriptors()
    renderer = isolated(scene(), [device])
    renderer.render()
    renderer.close()
    assert descriptors() <= before
