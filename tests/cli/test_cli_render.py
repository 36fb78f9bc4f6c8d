"""clvol render: all files or none, one line for every mistake, and the agreed status."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from clvol.errors import DeviceError, RenderError

PICTURES = ["a.exr", "b.png", "c.npy"]


def outputs(*names: str) -> list[str]:
    return [word for name in names for word in ("-o", name)]


def test_every_output_is_written_and_named(run, folder, renderer):
    outcome = run("render", "scene.toml", *outputs(*PICTURES), "--stats", "stats.json")
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out.split() == [*PICTURES, "stats.json"]
    assert sorted(path.name for path in folder.iterdir()) == sorted(
        ["scene.toml", "cube.npy", "stats.json", *PICTURES]
    )
    np.testing.assert_array_equal(np.load("c.npy"), np.full((6, 8, 4), 0.25, dtype=np.float32))


def test_stats_are_json_with_all_times(run, folder, renderer):
    run("render", "scene.toml", "-o", "c.npy", "--stats", "stats.json")
    stats = json.loads((folder / "stats.json").read_text(), parse_constant=pytest.fail)
    assert set(stats["seconds"]) == {"load", "prepare", "compile", "render", "write", "total"}
    assert stats["seconds"]["total"] >= stats["seconds"]["load"] + stats["seconds"]["write"] > 0
    assert stats["seconds"]["render"] == 0.5
    assert stats["samples"] == 7 and stats["devices"] == ["stub"] and stats["worst"] is None


def test_overrides_and_devices_reach_the_renderer(run, folder, renderer):
    run("render", "scene.toml", "-o", "c.npy", "--set", "image.width=3", "--set", "image.height=2",
        "--device", "pocl", "--device", "intel")
    resolved, devices = renderer.calls[0]
    assert (resolved.image.width, resolved.image.height) == (3, 2)
    assert devices == ["pocl", "intel"]
    run("render", "scene.toml", "-o", "c.npy")
    assert renderer.calls[1][1] is None


def test_a_volume_file_is_a_scene(run, folder, renderer):
    assert run("render", "cube.npy", "-o", "x.png").status == 0
    assert renderer.calls[0][0].volume.shape == (4, 4, 4)


def test_existing_pictures_are_replaced(run, folder, renderer):
    (folder / "c.npy").write_bytes(b"old")
    assert run("render", "scene.toml", "-o", "c.npy").status == 0
    assert np.load("c.npy").shape == (6, 8, 4)


SCENE_MISTAKES = [
    (["--set", "image.width=0"], "scene.toml: image.width: got 0, expected a whole number"),
    (["--set", "image.widht=3"], "scene.toml: image.widht: unknown key (got 3), expected"),
    (["--set", "camera.fov_degrees=nan"], "scene.toml: camera.fov_degrees: got nan, expected"),
    (["--set", "camera={position=[1,1,1],target=[1,1,1]}"], "scene.toml: camera.position: got"),
    (["--set", "camera={position=[9,9,9],target=[1,1,1],up=[1,1,1]}"], "scene.toml: camera.up: "),
    (["--set", "transfer_function.points=[]"], "scene.toml: transfer_function.points: got []"),
    (["--set", 'volume.file="none.nrrd"'], "scene.toml: volume.file: got 'none.nrrd'"),
    (["--set", "image.width"], "--set 'image.width': not an assignment, expected TABLE.KEY=VALUE"),
    (["--set", "image.width=a b"], "--set 'image.width=a b': "),
    (["--memory-cap", "10 B"], "cube.npy: the volume needs 64 bytes, expected at most 10 bytes"),
    (["--memory-cap", "much"], "--memory-cap: got 'much', expected a size such as '2 GiB'"),
    (["--bogus"], "clvol render: unknown option --bogus, expected"),
    (["more"], "x.exr: one name for 2 inputs, expected a name with {stem}"),
]


@pytest.mark.parametrize(("arguments", "line"), SCENE_MISTAKES)
def test_a_wrong_scene_or_argument_leaves_nothing(
    refused, nothing_left, renderer, arguments, line
):
    assert refused(2, "render", "scene.toml", "-o", "x.exr", *arguments).startswith(line)
    assert renderer.calls == []


def test_a_missing_scene_or_output_is_named(refused, nothing_left):
    assert refused(2, "render", "-o", "x.exr").startswith("clvol render: no SCENE, expected")
    assert refused(2, "render", "scene.toml").startswith("clvol render: no -o FILE, expected")
    assert refused(2, "render", "none.toml", "-o", "x.exr").startswith("none.toml: no such file")
    assert refused(2, "render", "none.nrrd", "-o", "x.exr").startswith("none.nrrd: no such file")
    assert refused(2, "render", "", "-o", "x.exr")
    assert refused(2, "render", "a\0b.toml", "-o", "x.exr")


def test_broken_toml_is_named_with_its_line(refused, folder, renderer):
    (folder / "bad.toml").write_text("version = 1\n[volume\n")
    line = refused(2, "render", "bad.toml", "-o", "x.exr")
    assert line.startswith("bad.toml: line 2, column 8: ")
    assert not (folder / "x.exr").exists()


@pytest.mark.parametrize(
    ("words", "where"),
    [
        (outputs("x.bmp"), "x.bmp"),
        (outputs("x"), "x"),
        (outputs("x.exr", "y.gif"), "y.gif"),
        (outputs("none/x.exr"), "none/x.exr"),
        (outputs("x.exr", "none/x.exr"), "none/x.exr"),
        (outputs("scene.toml/x.exr"), "scene.toml/x.exr"),
        (outputs("x.png", "./x.png"), "./x.png"),
        (outputs("cube.npy"), "cube.npy"),
        ([*outputs("x.png"), "--stats", "none/s.json"], "none/s.json"),
        ([*outputs("x.png"), "--stats", "x.png"], "x.png"),
        ([*outputs("x.png"), "--stats", "scene.toml"], "scene.toml"),
        ([*outputs("x.png"), "--stats", "."], "."),
        (outputs("a\0b.png"), ""),
    ],
)
def test_impossible_outputs_are_refused_before_the_work(
    refused, nothing_left, renderer, words, where
):
    assert refused(2, "render", "scene.toml", *words).startswith(where)
    assert renderer.calls == []


@pytest.mark.parametrize(
    ("failure", "status", "line"),
    [
        (RenderError("kernel", "it failed", "better"), 4, "kernel: it failed, expected better"),
        (DeviceError("OpenCL", "none works", "one"), 3, "OpenCL: none works, expected one"),
        (MemoryError(), 4, "memory: "),
        (ZeroDivisionError("two\nlines"), 4,
         "internal: ZeroDivisionError: two lines (set CLVOL_DEBUG=1 for the traceback)"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else None,
)
def test_a_failing_render_leaves_nothing(
    refused, nothing_left, renderer, monkeypatch, failure, status, line
):
    monkeypatch.setattr(renderer, "failure", failure)
    assert refused(status, "render", "scene.toml", *outputs(*PICTURES)).startswith(line)


@pytest.mark.parametrize("stop", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_picture_that_cannot_be_written_takes_the_others_with_it(
    refused, folder, renderer, monkeypatch, stop
):
    from clvol.image import png

    (folder / "a.exr").write_bytes(b"old")
    before = {path: path.read_bytes() for path in folder.iterdir()}

    def full(*_):
        raise stop

    monkeypatch.setattr(png, "write", full)
    status = 130 if isinstance(stop, KeyboardInterrupt) else 4
    line = refused(status, "render", "scene.toml", *outputs(*PICTURES), "--stats", "s.json")
    assert line.startswith("interrupted" if status == 130 else "b.png: the file cannot be written")
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_a_picture_that_cannot_be_moved_takes_the_others_with_it(
    refused, nothing_left, renderer, monkeypatch
):
    moves, move = [], os.replace

    def fail_the_last(source, target):
        if not str(target).startswith(str(os.getcwd()) + "/."):  # into place, not a first draft
            moves.append(target)
            if len(moves) == 3:
                raise OSError(5, "Input/output error")
        return move(source, target)

    monkeypatch.setattr(os, "replace", fail_the_last)
    line = refused(4, "render", "scene.toml", *outputs(*PICTURES))
    assert "Input/output error" in line and len(moves) == 3


def test_debugging_shows_the_traceback(run, folder, renderer, monkeypatch):
    monkeypatch.setattr(renderer, "failure", ZeroDivisionError("x"))
    monkeypatch.setenv("CLVOL_DEBUG", "1")
    outcome = run("render", "scene.toml", "-o", "x.exr")
    assert outcome.status == 4 and "Traceback" in outcome.err
    assert outcome.err.splitlines()[-1] == "clvol: error: internal: ZeroDivisionError: x"


def test_a_real_render_writes_every_format(folder, device):
    """The whole command as its own process: pictures, stats, and nothing on stderr."""
    from clvol.opencl.devices import report_of

    command = [sys.executable, "-m", "clvol", "render", "scene.toml", *outputs(*PICTURES),
               "--device", report_of(device).name, "--stats", "s.json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    rgba = np.load("c.npy")
    assert rgba.shape == (6, 8, 4) and rgba.dtype == np.float32
    assert rgba[..., 3].max() > 0.05  # the default view and look are not blank
    stats = json.loads((folder / "s.json").read_text())
    assert set(stats["seconds"]) == {"load", "prepare", "compile", "render", "write", "total"}
    assert stats["rays"] == 48 and stats["samples"] > 0 and stats["method"] == "raycast"
