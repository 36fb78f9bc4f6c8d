"""Whatever signal asks the command to end, at whatever moment: its status, at most one line, outputs
whole or not there, no temporary file, and a store that can be gone on with."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from clvol.image import load_image
from clvol.store.zarr_store import open_store
from clvol.volume.procedural import scene_field

ASKING = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
KILLS = 6  # of each command; each takes up to two seconds
LONGEST = 2.0  # seconds until a signal


def started(*words: str, **how) -> subprocess.Popen:
    """Once the command looks after signals: before that Python itself ends, with nothing done. An interrupt is not
    ignored, as it is in the background jobs of shells."""
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "import clvol.cli as c; real = c._run\n"
        "def run(*given): sys.stdout.write('begun\\n'); sys.stdout.flush(); return real(*given)\n"
        "c._run = run; sys.exit(c.main())"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, **how,
    )  # fmt: skip
    assert process.stdout.readline() == "begun\n"
    return process


def ended(process: subprocess.Popen, number: int) -> bool:
    """Checks status and line; whether the signal came in time to end the command."""
    _, told = process.communicate(timeout=300)
    assert process.returncode in (0, 128 + number), told
    if process.returncode == 0:
        return False
    name = "" if number == signal.SIGINT else f" by {signal.Signals(number).name}"
    assert told == f"clvol: error: interrupted{name}\n"
    return True


def hidden(folder) -> list[str]:
    return [name for name in os.listdir(folder) if name.startswith(".")]


@pytest.fixture
def device_name(device) -> str:
    from clvol.opencl.devices import report_of

    return report_of(device).name


@pytest.mark.parametrize("seed", range(KILLS))
def test_a_still_is_there_whole_or_not_at_all(folder, device_name, seed):
    chance = random.Random(seed)
    number = ASKING[seed % 3]
    names = ["a.exr", "b.png", "c.npy", "s.json"]
    words = ["-o", "a.exr", "-o", "b.png", "-o", "c.npy", "--stats", "s.json"]
    process = started("render", "scene.toml", *words, "--device", device_name)
    time.sleep(chance.uniform(0, LONGEST))
    process.send_signal(number)
    is_stopped = ended(process, number)
    there = [name for name in names if os.path.exists(name)]
    assert there == ([] if is_stopped else names) and hidden(folder) == []


@pytest.mark.parametrize("seed", range(KILLS))
def test_frames_are_there_whole_or_not_at_all(folder, device_name, seed):
    """So many that the signal always comes in time."""
    chance = random.Random(100 + seed)
    number = ASKING[seed % 3]
    more = ["--set", "animation.frames=20000", "--device", device_name]
    process = started("render", "scene.toml", "-o", "f%d.npy", "-o", "f%d.exr", "-o", "v.gif", *more)
    time.sleep(chance.uniform(0.2, LONGEST + 1))
    process.send_signal(number)
    assert ended(process, number)
    assert hidden(folder) == [] and not os.path.exists("v.gif")
    for name in os.listdir():
        if name.startswith("f"):
            assert load_image(name)["rgba"].shape == (6, 8, 4)
            stem = name.partition(".")[0]
            assert os.path.exists(f"{stem}.npy") and os.path.exists(f"{stem}.exr")


@pytest.mark.parametrize("seed", range(2))
def test_a_store_is_gone_on_with_after_any_number_of_ends(folder, seed):
    chance = random.Random(200 + seed)
    text = 'version = 1\n[volume]\nfield = "ellipsoid"\nsize = [150, 140, 130]\n'
    (folder / "field.toml").write_text(text)
    words = ["store", "field.toml", "-o", "v.zarr", "--shard", "32", "--edge", "8", "--quiet"]
    for k in range(4):
        number = ASKING[(seed + k) % 3]
        process = started(*words)
        time.sleep(chance.uniform(0, LONGEST))
        process.send_signal(number)
        if not ended(process, number):
            break
        assert hidden(folder) == [] and not os.path.exists("v.zarr")
    else:
        assert started(*words).wait(timeout=300) == 0
    stored = open_store(folder / "v.zarr").volume_level(0)
    np.testing.assert_array_equal(stored, scene_field("ellipsoid", (150, 140, 130)).data)
    assert sorted(os.listdir()) == ["cube.npy", "field.toml", "scene.toml", "v.zarr"]


def test_a_signal_that_is_sent_twice_is_one(folder, device_name):
    """To the process and to its group, as by a terminal or by timeout(1)."""
    process = started(
        "render", "scene.toml", "-o", "f%d.npy", "--set", "animation.frames=20000",
        "--device", device_name, start_new_session=True,
    )  # fmt: skip
    time.sleep(1)
    process.send_signal(signal.SIGTERM)
    os.killpg(process.pid, signal.SIGTERM)
    assert ended(process, signal.SIGTERM) and hidden(folder) == []


def test_signals_that_are_ignored_stay_ignored(folder, device_name):
    """As nohup(1) has it."""
    process = started(
        "render", "scene.toml", "-o", "a.npy", "--device", device_name,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )  # fmt: skip
    process.send_signal(signal.SIGHUP)
    process.communicate(timeout=300)
    assert process.returncode == 0 and os.path.exists("a.npy")


# --- the mechanism


def in_process(code: str) -> subprocess.CompletedProcess:
    head = "import os, signal, sys, time\nfrom clvol import interrupts\nfrom clvol.interrupts import *\n"
    head += "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    return subprocess.run(
        [sys.executable, "-c", head + code], capture_output=True, text=True, timeout=300
    )


def test_what_must_not_be_done_by_halves_is_done():
    done = in_process(
        "with stoppable():\n"
        "    try:\n"
        "        with held():\n"
        "            os.kill(os.getpid(), signal.SIGTERM); time.sleep(0.05); print('whole')\n"
        "        print('not here')\n"
        "    except Stopped as stop: print(stop.status, stop.line)\n"
    )
    assert done.stdout == "whole\n143 interrupted by SIGTERM\n", done.stderr


def test_an_end_that_does_not_come_is_made(tmp_path):
    """By a library that does not return, or swallows every exception."""
    file = tmp_path / ".part"
    done = in_process(
        f"interrupts._GRACE = 0.5\nexpect_temporary({str(file)!r}); open({str(file)!r}, 'w')\n"
        "with stoppable():\n"
        "    while True:\n"
        "        try: os.kill(os.getpid(), signal.SIGTERM); time.sleep(1)\n"
        "        except BaseException: pass\n"
    )
    assert (done.returncode, done.stderr) == (143, "clvol: error: interrupted by SIGTERM\n")
    assert not file.exists()


def test_a_signal_in_a_destructor_is_not_lost():
    done = in_process(
        "class Thing:\n"
        "    def __del__(self): os.kill(os.getpid(), signal.SIGTERM); time.sleep(0.05)\n"
        "try:\n"
        "    with stoppable():\n"
        "        thing = Thing(); del thing\n"
        "        time.sleep(10); print('not here')\n"
        "except Stopped as stop: print(stop.status)\n"
    )
    assert (done.stdout, done.stderr) == ("143\n", "")


def test_a_signal_that_became_another_error_is_told_as_one(run, folder, monkeypatch):
    """The import of a library in C makes an ImportError of it."""
    from clvol.interrupts import Stopped

    def broken(*_, **__):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        except Stopped:
            raise ImportError("initialization failed") from None

    monkeypatch.setattr("clvol.scene.load_scene", broken)
    outcome = run("info", "cube.npy")
    assert (outcome.status, outcome.err) == (143, "clvol: error: interrupted by SIGTERM\n")


def test_a_second_signal_ends_at_once(tmp_path):
    file = tmp_path / ".part"
    done = in_process(
        f"expect_temporary({str(file)!r}); open({str(file)!r}, 'w')\n"
        "with stoppable():\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGINT); time.sleep(1)\n"
        "    finally:\n"
        "        time.sleep(1.2); os.kill(os.getpid(), signal.SIGINT); time.sleep(20)\n"
    )
    assert (done.returncode, done.stderr) == (130, "clvol: error: interrupted\n")
    assert not file.exists()


def test_handlers_are_what_they_were_before():
    from clvol.cli import main

    def state() -> tuple:
        handlers = [signal.getsignal(number) for number in [*ASKING, signal.SIGURG]]
        return handlers, signal.pthread_sigmask(signal.SIG_BLOCK, []), threading.active_count()

    before = state()
    main(["--version"])
    assert state() == before


def test_handlers_that_a_compiler_installs_do_not_matter():
    """LLVM's reset themselves to the default action when they are called, which ends the process at the next
    signal."""
    done = in_process(
        "with stoppable():\n"
        "    for number in interrupts.SIGNALS: signal.signal(number, signal.SIG_DFL)\n"
        "    try:\n"
        "        for _ in range(3): os.kill(os.getpid(), signal.SIGTERM)\n"
        "        time.sleep(10); print('not here')\n"
        "    except Stopped as stop: time.sleep(0.2); print(stop.status)\n"
    )
    assert (done.stdout, done.stderr) == ("143\n", "")


def test_a_thread_that_was_there_before_may_get_the_signal():
    """It does not block signals, as threads of numpy do that a program started before it called clvol."""
    done = in_process(
        "import threading\n"
        "threading.Thread(target=time.sleep, args=(5,), daemon=True).start()\n"
        "interrupts._GRACE = 0.5\n"
        "with stoppable():\n"
        "    while True:\n"
        "        try: os.kill(os.getpid(), signal.SIGTERM); time.sleep(1)\n"
        "        except BaseException: pass\n"
    )
    assert (done.returncode, done.stderr) == (143, "clvol: error: interrupted by SIGTERM\n")


def test_another_thread_needs_no_signals(capfd):
    from clvol.cli import main

    told = []
    thread = threading.Thread(target=lambda: told.append(main(["--version"])))
    thread.start()
    thread.join()
    assert told == [0]


@pytest.mark.parametrize("number", ASKING)
def test_an_interrupt_at_every_moment_of_writing_leaves_nothing(tmp_path, number):
    """A signal before every line that runs while a file is written."""
    from clvol.image import atomic_paths
    from clvol.interrupts import Stopped, _stop, stoppable

    targets = [tmp_path / "a", tmp_path / "b"]
    lines = 0

    def write(stop_at: int) -> bool:
        """Whether it was stopped."""
        nonlocal lines
        lines = 0

        def trace(frame, event, _argument):
            nonlocal lines
            if "atomic" not in frame.f_code.co_filename and "contextlib" not in frame.f_code.co_filename:
                return trace if frame.f_code.co_name == "work" else None
            if event == "line":
                lines += 1
                if lines == stop_at:
                    _stop(number, None)  # as Python calls it
            return trace

        def work() -> None:
            with atomic_paths(targets) as drafts:
                for draft in drafts:
                    draft.write_bytes(b"new")

        try:
            with stoppable():
                sys.settrace(trace)
                try:
                    work()
                finally:
                    sys.settrace(None)
        except Stopped:
            return True
        return False

    assert not write(0) and lines > 20
    for stop_at in range(1, lines + 1, 3):
        for target in targets:
            target.write_bytes(b"old")
        is_stopped = write(stop_at)
        contents = {target.read_bytes() for target in targets if target.exists()}
        assert os.listdir(tmp_path) and set(os.listdir(tmp_path)) <= {"a", "b"}, stop_at
        assert len(contents) == 1, (stop_at, is_stopped, contents)
