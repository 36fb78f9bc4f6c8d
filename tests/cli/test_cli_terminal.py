"""Names, keys and contents of files, and what drivers say, reach the terminal as escapes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from test_text import is_harmless

EVIL = "\x1b]0;x\x07\x1b[2J\u202e\x9b1m"


def harmless(outcome) -> bool:
    return is_harmless(outcome.out.replace("\n", "")) and is_harmless(outcome.err.replace("\n", ""))


@pytest.mark.parametrize(
    "words",
    [
        [EVIL],
        ["--" + EVIL],
        ["render", EVIL, "-o", "x.png"],
        ["render", EVIL + ".toml", "-o", "x.png"],
        ["render", EVIL + ".nrrd", "-o", "x.png"],
        ["render", "scene.toml", "-o", EVIL + "/x.png"],
        ["render", "scene.toml", "-o", "x." + EVIL],
        ["render", "scene.toml", "-o", "x.png", "--stats", EVIL + "/s"],
        ["render", "scene.toml", "-o", "x.png", "--set", EVIL],
        ["render", "scene.toml", "-o", "x.png", "--set", f"{EVIL}=1"],
        ["render", "scene.toml", "-o", "x.png", "--set", f'image.width="{EVIL}"'],
        ["render", "scene.toml", "-o", "x.png", "--memory-cap", EVIL],
        ["render", "scene.toml", "-o", "x.png", "--max-error", EVIL],
        ["render", "scene.toml", "-o", "x.png", "--device", EVIL],
        ["compare", EVIL + ".png", "b.png"],
        ["store", "cube.npy", "-o", EVIL + "/x"],
        ["store", "cube.npy", "-o", "x", "--codec", EVIL],
        ["tradeoff", "scene.toml", "-o", EVIL + "/x/y"],
    ],
)
def test_arguments_in_error_lines(run, folder, renderer, words):
    outcome = run(*words)
    if "--device" not in words:  # the stub takes any
        assert outcome.status == 2 and outcome.err.count("\n") == 1
    assert harmless(outcome)


SCENES = [
    '"{}" = 1\n', 'version = 1\n["{}"]\nx = 1\n', 'version = 1\n[volume]\nfile = "{}.nrrd"\n',
    'version = 1\n[volume]\nfile = "cube.npy"\nnan = "{}"\n',
    'version = 1\n[volume]\nfile = "cube.npy"\n[transfer_function]\npreset = "{}"\n',
    'version = 1\n[volume]\nfile = "cube.npy"\n[environment]\nfile = "{}"\n',
]  # fmt: skip


@pytest.mark.parametrize("text", SCENES)
def test_scenes_in_error_lines(run, folder, text):
    escaped = "".join(f"\\u{ord(c):04x}" for c in EVIL)
    (folder / "evil.toml").write_text(text.format(escaped))
    outcome = run("explain", "evil.toml")
    assert outcome.status == 2 and harmless(outcome) and outcome.err.count("\n") == 1


def test_raw_bytes_in_a_scene(run, folder):
    (folder / "evil.toml").write_bytes(b"\x1b[31m\xff\x9b = 1\n")
    assert harmless(run("info", "evil.toml"))
    (folder / "evil.toml").write_text("\x1b[31m\u202e = 1\n", encoding="utf-8")
    assert harmless(run("info", "evil.toml"))


@pytest.mark.parametrize("as_json", [[], ["--json"]])
def test_a_header_in_info(run, folder, as_json):
    head = f"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\nspace: {EVIL}\nspacings: 1 1 1\n\n"
    (folder / "evil.nrrd").write_bytes(head.encode() + bytes(8))
    outcome = run("info", "evil.nrrd", *as_json)
    assert harmless(outcome)
    np.save(folder / f"{EVIL}.npy", np.zeros((2, 2, 2), np.uint8))
    outcome = run("info", f"{EVIL}.npy", *as_json)
    assert outcome.status == 0 and harmless(outcome)
    if as_json:
        assert json.loads(outcome.out)["path"] == f"{EVIL}.npy"


def test_names_of_files_that_were_written(run, folder, renderer):
    outcome = run("render", "scene.toml", "-o", f"{EVIL}\n.npy")
    assert outcome.status == 0 and harmless(outcome) and outcome.out.count("\n") == 1


@pytest.mark.parametrize("as_json", [[], ["--json"]])
def test_what_drivers_say(run, monkeypatch, as_json):
    from clvol.cli import trial
    from clvol.opencl import devices
    from clvol.opencl.reports import DeviceReport

    found = [
        DeviceReport(EVIL, EVIL, EVIL, driver=EVIL, version=EVIL + "\n", reason=EVIL + "\nmore"),
        DeviceReport("works", "p", EVIL, driver=EVIL, working=True),
    ]
    monkeypatch.setattr(devices, "list_devices", lambda **_: found)
    monkeypatch.setattr(trial, "try_render", lambda name: trial.Trial(notices={EVIL: EVIL + "\nmore"}))
    outcome = run("doctor", *as_json)
    assert outcome.status == 0 and harmless(outcome)
    monkeypatch.setattr(trial, "try_render", lambda name: trial.Trial(EVIL + "\nmore"))
    outcome = run("doctor", *as_json)
    assert outcome.status == 3 and harmless(outcome) and outcome.err.count("\n") == 1
    monkeypatch.setattr(devices, "list_devices", lambda **_: found[:1])
    outcome = run("doctor", *as_json)
    assert outcome.status == 3 and harmless(outcome) and outcome.err.count("\n") == 1


def test_tracebacks(run, folder, monkeypatch):
    monkeypatch.setenv("CLVOL_DEBUG", "1")
    outcome = run("info", EVIL + ".nrrd")
    assert "Traceback" in outcome.err and harmless(outcome)


def test_the_message_of_progress(run, folder, renderer, monkeypatch):
    """As a terminal gets it: rich's own sequences, none of the scene's."""
    import io
    import sys

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    told = Terminal()
    monkeypatch.setattr(sys, "stderr", told)
    from clvol.cli.console import working

    with working(f"loading {EVIL}", False) as progress:
        progress(1, 2, f"reading {EVIL}")
    assert EVIL[:5] not in told.getvalue() and "\u202e" not in told.getvalue()


def test_warnings_are_one_line_each_after_the_result(run, folder, monkeypatch):
    import warnings

    from clvol.errors import ClvolWarning
    from clvol.scene import load_scene

    def warning(*given):
        warnings.warn(ClvolWarning(f"scene: {EVIL}", "odd\n\x1b", "another"), stacklevel=1)
        warnings.warn(UserWarning("of a library"), stacklevel=1)
        return load_scene(*given)

    monkeypatch.setattr("clvol.scene.load_scene", warning)
    outcome = run("info", "cube.npy")
    assert outcome.status == 0 and harmless(outcome)
    assert outcome.err.startswith("clvol: warning: scene: ") and outcome.err.count("\n") == 1
    assert outcome.err.endswith("odd \\x1b; another\n")
