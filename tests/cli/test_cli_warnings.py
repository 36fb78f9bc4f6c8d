"""Warnings: a line each on stderr, and nothing else is different."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest

from clvol import cli
from clvol.errors import ClvolWarning
from clvol.opencl.devices import report_of

BESIDE = 'transfer_function.points=[{value=1000.0,opacity=0.0,color=[1,1,1]},{value=2000.0,opacity=0.5,color=[1,1,1]}]'
SAID = (
    "transfer_function: its points lie between 1000 and 2000, but the voxels lie between 0 and 63: nothing is visible; "
    "set transfer_function.points to values between 0 and 63"
)


def test_a_warning_is_a_line_and_no_status(run, folder, device):
    name = report_of(device).name
    outcome = run("render", "scene.toml", "--set", BESIDE, "-o", "a.npy", "--stats", "s.json", "--device", name)
    assert (outcome.status, outcome.err) == (0, f"clvol: warning: {SAID}\n")
    assert outcome.out.split() == ["a.npy", "s.json"]
    assert json.loads((folder / "s.json").read_text())["warnings"] == [SAID]
    assert not np.load("a.npy").any()


def test_a_good_scene_is_quiet(run, folder, device):
    outcome = run("render", "scene.toml", "-o", "a.npy", "--stats", "s.json", "--device", report_of(device).name)
    assert (outcome.status, outcome.err) == (0, "")
    assert "warnings" not in json.loads((folder / "s.json").read_text())


def test_an_animation_says_it_once(run, folder, device):
    outcome = run("render", "scene.toml", "--set", BESIDE, "--set", "animation.frames=3", "-o", "a_%d.npy",
                  "--stats", "s.json", "--device", report_of(device).name)  # fmt: skip
    assert (outcome.status, outcome.err) == (0, f"clvol: warning: {SAID}\n")
    assert json.loads((folder / "s.json").read_text())["warnings"] == [SAID]


def test_explain_says_it_too(run, folder):
    outcome = run("explain", "scene.toml", "--set", BESIDE)
    assert outcome.status == 0 and outcome.out.splitlines()[-1] == f"warning: {SAID}"
    assert json.loads(run("explain", "scene.toml", "--set", BESIDE, "--json").out)["warnings"] == [SAID]
    assert json.loads(run("explain", "scene.toml", "--json").out)["warnings"] == []


@pytest.mark.parametrize("category", (ClvolWarning, UserWarning, DeprecationWarning))
def test_clvols_own_warnings_alone_are_shown_and_move_no_cursor(run, folder, monkeypatch, category):
    def speaking(*_):
        warnings.warn(category("x", "\x1b[2J\nboo\x07"))

    monkeypatch.setattr(cli.cli, "invoke", speaking)
    outcome = run("info", "cube.npy")
    expected = "clvol: warning: x: \\x1b[2J boo\\x07\n" if category is ClvolWarning else ""
    assert (outcome.status, outcome.err) == (0, expected)


def test_an_error_stays_one_line(refused, folder, monkeypatch):
    def failing(*_):
        from clvol.errors import SceneError

        warnings.warn(ClvolWarning("here", "odd"))
        raise SceneError("scene", "got a", "b")

    monkeypatch.setattr(cli.cli, "invoke", failing)
    assert refused(2, "info", "cube.npy") == "scene: got a, expected b"
