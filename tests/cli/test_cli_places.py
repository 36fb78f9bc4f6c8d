"""Where files go, in each way of rendering: "-" is standard output, and what cannot be written is found out before the
work. Nothing is rendered here: the work of a process, and of workers, is replaced."""

from __future__ import annotations

import json
import os
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from clvol.cli import main
from clvol.cluster.frames import MadeFrame

HEIGHT, WIDTH = 6, 8
# Way of rendering: its words, and whether it makes a single picture.
WAYS = {
    "one process": ([], True),
    "bricks": (["--bricks", "1"], True),
    "tiles of workers": (["--workers", "2"], True),
    "tiles of a cluster": (["--scheduler", "tcp://host:1"], True),
    "bricks of workers": (["--bricks", "1", "--workers", "2"], True),
    "an animation": (["--set", "animation.frames=2"], False),
    "an animation that is resumed": (["--set", "animation.frames=2", "--resume"], False),
    "frames of workers": (["--set", "animation.frames=2", "--workers", "2"], False),
}


@pytest.fixture
def worked(monkeypatch, folder, renderer) -> list[str]:
    """What has been worked on, in the working folder."""
    done: list[str] = []
    rgba = np.full((HEIGHT, WIDTH, 4), 0.5, np.float32)

    def picture(*_: object, **__: object):
        print("something that a library prints")
        done.append("picture")
        return rgba, {"samples": 7}

    def tiles(*_: object, **__: object):
        return rgba, picture() and None, {"samples": 7}

    def frames(connection, animation, inputs, numbers):
        for number in numbers:
            picture()
            for pattern in animation.stills:
                np.save(pattern % number, rgba)
            yield MadeFrame(number, {"samples": 7, "rays": 48, "seconds": {}}, worker="w")

    @contextmanager
    def connected(workers, scheduler):
        yield SimpleNamespace(name="cluster")

    render = renderer.render
    monkeypatch.setattr(renderer, "render", lambda self, **how: picture() and render(self, **how))
    monkeypatch.setattr("clvol.bricks.render.render_in_bricks", lambda *_: (rgba, None, picture()[1]["samples"]))
    device = SimpleNamespace(name="stub", release=lambda: None)
    monkeypatch.setattr("clvol.render.renderer.open_context", lambda devices: device)
    monkeypatch.setattr("clvol.cluster.connection.connected", connected)
    monkeypatch.setattr("clvol.cluster.connection.check_installed", lambda option: None)
    monkeypatch.setattr("clvol.cluster.bricks.bricks_on_workers", tiles)
    monkeypatch.setattr("clvol.cluster.tiles.tiles_on_workers", tiles)
    monkeypatch.setattr("clvol.cluster.frames.frames_on_workers", frames)
    return done


def name_of(way: str) -> str:
    return "a.npy" if WAYS[way][1] else "a_%d.npy"


def call(capfdbinary, *words: str) -> tuple[int, bytes, str]:
    capfdbinary.readouterr()
    status = main(["render", "scene.toml", *words])
    told = capfdbinary.readouterr()
    return status, told.out, told.err.decode()


@pytest.mark.parametrize("way", WAYS)
def test_stats_on_standard_output(capfdbinary, worked, way):
    status, out, err = call(capfdbinary, "-o", name_of(way), "--stats", "-", *WAYS[way][0])
    assert status == 0, err
    assert json.loads(out)["samples"] == 7 * len(worked) and worked
    assert "a_0.npy" in err or "a.npy" in err  # the names of pictures are not on standard output then
    assert not os.path.exists("-")


@pytest.mark.parametrize("way", [way for way, (_, is_single) in WAYS.items() if is_single])
def test_a_picture_on_standard_output(capfdbinary, worked, way):
    status, out, err = call(capfdbinary, "-o", "-", "-o", "also.npy", *WAYS[way][0])
    assert status == 0 and worked == ["picture"], err
    assert out.startswith(b"\x89PNG") and b"library" not in out
    assert os.path.exists("also.npy") and not os.path.exists("-")


@pytest.mark.parametrize("way", WAYS)
def test_places_that_cannot_be_written_are_found_before_the_work(capfdbinary, worked, way):
    words, is_single = WAYS[way]
    name = name_of(way)
    os.mkdir("there.npy")
    os.mkdir("there_0.npy")
    before = sorted(os.listdir())
    taken = "there.npy" if is_single else "there_%d.npy"
    wrong = {
        ("-o", f"missing/{name}"): 'the folder "', ("-o", f"scene.toml/{name}"): "is not a folder",
        ("-o", taken): "this is a folder", ("-o", name, "--stats", "missing/s.json"): 'the folder "',
        ("-o", name, "--stats", "there.npy"): "this is a folder", ("-o", name, "--stats", "scene.toml"): "scene.toml",
        ("-o", "-", "--stats", "-"): "-: ",
    }  # fmt: skip
    for places, told in wrong.items():
        status, out, err = call(capfdbinary, *places, *words)
        assert (status, out) == (2, b""), (places, err)
        assert told in err and err.count("\n") == 1, places
    assert not worked and sorted(os.listdir()) == before


@pytest.mark.parametrize("option", ["--frames=0:1", "--pixel-area", "--isolate", "--show-schedule=s.png"])
def test_bricks_take_no_option_without_effect(capfdbinary, worked, option):
    status, _, err = call(capfdbinary, "-o", "a.npy", "--bricks", "1", option)
    assert status == 2 and option.partition("=")[0] in err and not worked


@pytest.mark.parametrize(
    ("words", "told"),
    [(["--results", "-"], "--results: got '-'"), (["--results", "missing/r.jsonl"], "missing/r.jsonl: the folder"),
     (["--results", "there"], "there: this is a folder"), (["--report", "-"], "--report: got '-'"),
     (["--report", "missing/r.html"], "missing/r.html: the folder"), (["--report", "there"], "--report: got 'there'")],
)  # fmt: skip
def test_places_of_a_job(refused, folder, words, told):
    os.mkdir("there")
    (folder / "job.toml").write_text('scenes = ["scene.toml"]\noutput = "{scene}.npy"\n')
    before = sorted(os.listdir())
    assert refused(2, "batch", "job.toml", *words).startswith(told)
    assert sorted(os.listdir()) == before
