"""clvol doctor: it says that a device works when a picture came out of it, and what the caches are like."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from helpers.paths import ROOT

from clvol.cli import trial
from clvol.cli.trial import Trial, try_render
from clvol.opencl.devices import report_of
from clvol.opencl.reports import DeviceReport

TWO = [DeviceReport("pocl", "Portable Computing Language", "cpu", working=True, type="CPU"),
       DeviceReport("intel", "Intel(R) OpenCL", "cpu", working=True, type="CPU")]


@pytest.fixture
def doctor(run, monkeypatch, tmp_path):
    """``doctor({"pocl": Trial(...)}, ...)``: what it tells where the trials end so; status, JSON and text."""
    from clvol.opencl import devices

    monkeypatch.setattr(devices, "list_devices", lambda **_: list(TWO))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def call(trials: dict[str, Trial]):
        monkeypatch.setattr(trial, "try_render", lambda name: trials.get(name, Trial()))
        as_json, text = run("doctor", "--json"), run("doctor")
        assert as_json.status == text.status
        return text.status, json.loads(as_json.out), text.out

    return call


def test_a_device_on_which_a_render_fails_does_not_work(doctor):
    status, told, text = doctor({"pocl": Trial("rendering crashed (SIGABRT): no room")})
    assert status == 0
    assert [d["working"] for d in told["devices"]] == [False, True]
    assert told["devices"][0]["reason"] == "rendering crashed (SIGABRT): no room"
    assert "pocl: does not work" in text and "no room" in text and "intel: works" in text


def test_status_3_where_no_render_succeeds(doctor):
    status, told, _ = doctor({name: Trial("rendering failed") for name in ("pocl", "intel")})
    assert status == 3 and not any(d["working"] for d in told["devices"])


def test_it_tells_which_cache_is_in_use_and_what_is_wrong_with_it(doctor, tmp_path):
    _, told, text = doctor({})
    assert told["cache"]["folder"] == str(tmp_path / "cache" / "clvol")
    assert told["cache"]["problems"] == [] and "problem" not in text
    assert f"cache: {tmp_path / 'cache' / 'clvol'}" in text
    _, told, text = doctor({"pocl": Trial("", {"cache /x": "damaged"})})
    assert told["cache"]["problems"] == ["cache /x: damaged"] and "cache /x: damaged" in text


def test_it_says_how_fast_devices_are(doctor, monkeypatch):
    from clvol.opencl import devices

    kept = {}
    monkeypatch.setattr(devices, "keep_speeds", kept.update)
    _, told, text = doctor({"pocl": Trial(speed=1e8), "intel": Trial(speed=1.25e8)})
    assert [d["speed"] for d in told["devices"]] == [1e8, 1.25e8]
    assert "100 million samples per second" in text and kept == {"pocl": 1e8, "intel": 1.25e8}


def test_a_small_picture_comes_out_of_every_device(device):
    trial = try_render(report_of(device).name)
    assert (trial.reason, trial.notices) == ("", {}) and trial.speed > 0


def test_modules_in_the_working_folder_are_none_of_ours(tmp_path, monkeypatch, device):
    for name in ("json", "runpy", "numpy", "clvol"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('not this one')")
    monkeypatch.chdir(tmp_path)
    assert try_render(report_of(device).name).reason == ""


@pytest.mark.parametrize("code, expected", [
    ("raise SystemExit(9)", "rendering ended with status 9"),
    ("import os; os.abort()", "rendering crashed (SIGABRT)"),
    ("import sys; sys.stderr.write('ld: error: no space left')\nraise SystemExit(1)",
     "rendering ended with status 1: ld: error: no space left"),
    ("import time; time.sleep(60)", "rendering: no picture within 5 s"),
])
def test_whatever_happens_to_the_trial_is_an_answer(tmp_path, monkeypatch, code, expected):
    (tmp_path / "trial.py").write_text(code)
    monkeypatch.setattr(trial, "__file__", str(tmp_path / "trial.py"))
    assert try_render("pocl", 5.0).reason == expected


def test_a_wrong_picture_is_found_out(device, monkeypatch):
    assert trial._render(report_of(device).name) == ""
    real = trial._expected
    monkeypatch.setattr(trial, "_expected", lambda: real() * 1.01)
    assert "the picture is wrong by" in trial._render(report_of(device).name)


@pytest.mark.slow
def test_without_its_kernels_it_does_not_say_that_devices_work(tmp_path, device):
    """The installation itself is tried: one that lacks a file that only renders need."""
    import shutil

    for package in ("clvol", "cl"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "cl" / "composite.h").unlink()
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    done = subprocess.run([sys.executable, "-m", "clvol", "doctor", "--json"], cwd=tmp_path, env=environment,
                          capture_output=True, text=True, timeout=300)
    assert done.returncode == 3
    reports = json.loads(done.stdout)["devices"]
    assert reports and not any(report["working"] for report in reports)
    assert any("composite.h is not found" in report["reason"] for report in reports), reports
