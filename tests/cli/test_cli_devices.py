"""clvol render on several devices."""

from __future__ import annotations

import json
import os
import signal

import numpy as np
import pytest

from clvol.image import load_image
from clvol.opencl.devices import report_of
from clvol.render.isolation.process import DeviceProcess


@pytest.fixture
def halves(device) -> list[str]:
    report = report_of(device)
    if report.compute_units < 2:
        pytest.skip("the device has one compute unit, which cannot be divided")
    return [word for k in (1, 2) for word in ("--device", f"{report.name}:{k}/2")]


def test_two_halves_of_a_device_make_its_picture(run, folder, device, halves):
    name = report_of(device).name
    assert run("render", "scene.toml", "-o", "one.exr", "--device", name).status == 0
    more = ["--stats", "s.json", "--show-schedule", "s.png"]
    outcome = run("render", "scene.toml", "-o", "two.exr", *halves, *more)
    assert outcome.status == 0, outcome.err
    for key in ("rgba", "depth"):
        np.testing.assert_array_equal(load_image("one.exr")[key], load_image("two.exr")[key])
    stats = json.loads((folder / "s.json").read_text())
    assert stats["devices"] == [f"{name}:1/2", f"{name}:2/2"]
    assert [each["name"] for each in stats["schedule"]["devices"]] == stats["devices"]
    assert (folder / "s.png").read_bytes().startswith(b"\x89PNG") and "s.png" in outcome.out


def test_all_devices_are_one_per_processor(run, folder, device, monkeypatch):
    from clvol.cli import trial
    from clvol.opencl import devices

    monkeypatch.setattr(trial, "try_render", lambda name: trial.Trial(speed=1e8))
    monkeypatch.setattr(devices, "keep_speeds", lambda speeds: None)
    assert run("render", "scene.toml", "-o", "a.npy", "--device", "all", "--stats", "s.json").status == 0
    expected = [each.name for each in devices.one_per_processor(devices.list_devices())]
    assert json.loads((folder / "s.json").read_text())["devices"] == expected


def test_frames_of_an_animation_are_shared(run, folder, halves):
    more = ["--set", "animation.frames=2", "--stats", "s.json"]
    assert run("render", "scene.toml", "-o", "f%d.npy", *halves, *more).status == 0
    assert len(json.loads((folder / "s.json").read_text())["devices"]) == 2


def test_isolated_devices_make_the_same_pictures(run, folder, halves):
    assert run("render", "scene.toml", "-o", "one.exr").status == 0
    outcome = run("render", "scene.toml", "-o", "own.exr", "--isolate")
    assert outcome.status == 0, outcome.err
    more = ["--stats", "s.json", "--show-schedule", "s.png"]
    assert run("render", "scene.toml", "-o", "two.exr", "--isolate", *halves, *more).status == 0
    frames = ["--set", "animation.frames=2", "--isolate"]
    assert run("render", "scene.toml", "-o", "f%d.exr", *halves, *frames).status == 0
    for key in ("rgba", "depth"):
        for other in ("own.exr", "two.exr", "f0.exr", "f1.exr"):
            np.testing.assert_array_equal(load_image("one.exr")[key], load_image(other)[key])
    assert len(json.loads((folder / "s.json").read_text())["schedule"]["devices"]) == 2
    assert (folder / "s.png").exists()


@pytest.mark.parametrize("frames", [1, 2])
def test_the_only_isolated_device_crashes(run, folder, device, monkeypatch, frames):
    """One line and status 4, and the frames before it stay."""
    real, seen = DeviceProcess.request, []

    def request(this, what, *arguments, **named):
        seen.append(what)
        if seen.count("render") == frames and what == "render":
            os.kill(this.pid, signal.SIGKILL)
        return real(this, what, *arguments, **named)

    monkeypatch.setattr(DeviceProcess, "request", request)
    more = ["--set", f"animation.frames={frames}", "--device", report_of(device).name, "--isolate"]
    outcome = run("render", "scene.toml", "-o", "f%d.npy", *more)
    assert outcome.status == 4 and outcome.err.count("\n") == 1
    assert outcome.err.startswith("clvol: error: ") and "its process was killed (SIGKILL)" in outcome.err
    assert sorted(path.name for path in folder.glob("f*.npy")) == [f"f{k}.npy" for k in range(frames - 1)]


@pytest.mark.parametrize("words, expected", [
    (["--isolate", "--max-error", "0.01"], "--isolate: given together with --max-error"),
    (["--isolate", "--time-budget", "1"], "--isolate: given together with --time-budget"),
    (["--isolate", "--device", "none-such"], "there is none of this name"),
    (["--device", "{name}", "--device", "{name}"], "the device '{name}' twice"),
    (["--device", "{name}:3/2"], "not a part of a device"),
    (["--device", "{name}:1/x"], "NAME:k/n"),
    (["--device", "none-such:1/2"], "there is none of this name"),
    (["--show-schedule", "s.png"], "given for one device"),
    (["--show-schedule", "s.jpg"], "ends in .png"),
    (["--show-schedule", "s.png", "--max-error", "0.01"], "given together with --max-error"),
    (["--show-schedule", "s.png", "--set", "animation.frames=3"], "given for an animation"),
])  # fmt: skip
def test_what_cannot_be_requested(run, folder, device, words, expected):
    name = report_of(device).name
    outcome = run("render", "scene.toml", "-o", "a%d.npy", *(word.format(name=name) for word in words))
    assert outcome.status in (2, 3) and outcome.err.count("\n") == 1
    assert expected.format(name=name) in outcome.err
    assert sorted(path.name for path in folder.iterdir()) == ["cube.npy", "scene.toml"]
