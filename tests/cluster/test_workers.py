"""Frames and jobs on real workers: the same pictures, where they listen, who is left out, and who dies."""

from __future__ import annotations

import contextlib
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from helpers.clusters import FRAMES, names, workers_of, write_film

from clvol.batch.frames import Animation
from clvol.batch.job import load_job, pictures_of
from clvol.batch.results import results_in
from clvol.batch.run import JobRun, Options
from clvol.bricks.render import bricks_of
from clvol.cli import main
from clvol.cli.workers import render_on_workers
from clvol.cluster import local as local_module
from clvol.cluster.bricks import bricks_on_workers
from clvol.cluster.connection import check_installed, connected, shares
from clvol.cluster.facts import Digests
from clvol.cluster.frames import frames_on_workers
from clvol.cluster.pictures import ClusterRun
from clvol.cluster.tiles import tiles_on_workers
from clvol.errors import ClvolWarning, RenderError, SceneError, UsageError
from clvol.image import load_image
from clvol.render.frame import Frame
from clvol.render.some_tiles import rectangles
from clvol.scene import load_scene

psutil = pytest.importorskip("psutil", reason="the extra 'distributed' brings it")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("film")
    write_film(folder, size=40)
    before = os.getcwd()
    os.chdir(folder)
    yield folder
    os.chdir(before)


@pytest.fixture(scope="module")
def local(folder):
    with connected(2, None) as connection:
        yield connection


def read(name: str) -> tuple[bytes, dict]:
    """The bits of a picture, and what it is made from."""
    picture = load_image(name)
    return picture["rgba"].tobytes(), picture["made_from"]


@pytest.fixture(scope="module")
def alone(folder) -> list[tuple[bytes, dict]]:
    """The frames of one process."""
    assert main(["render", "film.toml", "-o", "f_%02d.npy", "--quiet"]) == 0
    found = [read(name) for name in names()]
    for name in names():
        os.remove(name)
    return found


def film(**how) -> Animation:
    return Animation("film.toml", [], ["f_%02d.npy"], **how)


def check_frames(alone) -> None:
    assert [read(name) for name in names()] == alone
    assert not [name for name in os.listdir() if name.endswith(".claim")]


def workers() -> list[int]:
    return workers_of(os.getpid())


def test_frames_are_those_of_one_process_and_two_workers_share_them(local, alone):
    made = list(frames_on_workers(local, film(), ["film.toml", "waves.npy"], range(FRAMES)))
    assert sorted(frame.index for frame in made) == list(range(FRAMES)) and not any(frame.error for frame in made)
    assert len({frame.worker for frame in made}) == 2
    check_frames(alone)
    loads = [frame for frame in made if frame.stats["seconds"]["load"]]
    assert len(loads) == 2  # once per process
    kept = list(frames_on_workers(local, film(resume=True), ["film.toml", "waves.npy"], range(FRAMES)))
    assert all(frame.is_kept for frame in kept) and len(kept) == FRAMES


def test_local_workers_listen_on_the_loopback_address_only(local):
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    listening = [c.laddr.ip for p in processes for c in p.net_connections() if c.status == psutil.CONN_LISTEN]
    assert len(listening) >= 3 and set(listening) == {"127.0.0.1"}


def test_frames_as_displayed_come_in_order(local):
    made = list(frames_on_workers(local, Animation("film.toml", [], [], shown=True), ["film.toml"], [3, 1, 7, 2]))
    assert [frame.index for frame in made] == [3, 1, 7, 2]
    assert all(frame.shown.dtype == np.uint8 and frame.shown.shape == (40, 40, 3) for frame in made)


def test_a_video_that_is_resumed_is_the_one_that_is_made_at_once(local):
    pattern = "v.apng.frames/%06d.png"
    os.mkdir("v.apng.frames")
    begun = list(frames_on_workers(local, Animation("film.toml", [], [pattern], resume=True), ["film.toml"], [0, 3]))
    assert not any(frame.error for frame in begun) and len(os.listdir("v.apng.frames")) == 2
    how: dict = {"frames": slice(5), "quiet": True, "devices": None, "memory_cap": None, "isolate": False}
    scene = load_scene("film.toml")
    for name, resume in (("w.apng", False), ("v.apng", True)):
        render_on_workers(local, "film.toml", [], scene, [name], f"{name}.json", resume=resume, **how)
    assert Path("v.apng").read_bytes() == Path("w.apng").read_bytes()
    kept = json.loads(Path("v.apng.json").read_text())["frames_kept"]
    assert kept == 2 and not os.path.exists("v.apng.frames")


def test_a_scene_that_is_wrong_is_an_error_of_each_frame(local):
    made = list(frames_on_workers(local, Animation("film.toml", ["image.width=-1"], ["g_%d.npy"]), [], [0, 1]))
    assert all(frame.status == 2 and "image.width" in frame.error for frame in made)


def test_workers_whose_files_differ_are_left_out(local, monkeypatch):
    monkeypatch.setattr(Digests, "of", lambda self, paths: {"waves.npy": "0123"})
    with pytest.warns(ClvolWarning, match="is left out: its waves.npy has the digest .*, and the client's 0123"):
        with pytest.raises(RenderError, match="no worker fits"):
            list(frames_on_workers(local, film(), ["waves.npy"], range(3)))


def test_pictures_of_a_job_are_those_of_one_process(local, folder):
    # The programs of the frames: nothing else is compiled.
    Path("job.toml").write_text('scenes = ["film.toml"]\noutput = "p_{fov}.npy"\nset = { "animation.frames" = 1 }\n'
                                '[[vary]]\nkey = "camera.fov_degrees"\nname = "fov"\n'
                                'values = [20.0, 30.0, -1.0, 40.0]\n')  # fmt: skip
    pictures = pictures_of(load_job("job.toml"), "job.toml")
    told: list[dict] = []
    outcome = ClusterRun(local, pictures, Options(results="c.jsonl"), told.append).run()
    assert outcome.counts == {"rendered": 3, "kept": 0, "failed": 1} and outcome.status == 2
    assert sorted(each["picture"] for each in told) == [0, 1, 2, 3]
    assert json.dumps(sorted(results_in("c.jsonl"), key=lambda r: r["picture"])) == json.dumps(
        sorted(told, key=lambda r: r["picture"]))
    made = {p.files[0]: read(p.files[0]) for p in pictures if p.number != 2}
    outcome = ClusterRun(local, pictures, Options(results="c.jsonl"), told.append).run()
    assert outcome.counts == {"rendered": 0, "kept": 3, "failed": 1}
    for name in made:
        os.remove(name)
    JobRun(pictures, Options(results="d.jsonl"), lambda result: None).run()
    assert {name: read(name) for name in made} == made


STILL = ["animation.frames=1", "image.width=33", "integration.early_termination=0.0"]


def test_bricks_of_workers_are_those_of_one_process_and_nearly_the_whole(local):
    bricks = bricks_of(load_scene("film.toml", STILL).resolve(), 5)
    scene = {"path": "film.toml", "overrides": STILL, "count": 5, "devices": None, "memory_cap": None}
    rgba, depth, told = bricks_on_workers(local, bricks, scene, ["film.toml", "waves.npy"], depth=True)
    assert told["bricks"] == 5 and told["samples"] > 0 and told["largest_brick_bytes"] < 24**3
    again, nothing, of_pixels = bricks_on_workers(local, bricks, scene, ["film.toml", "waves.npy"])
    assert nothing is None and of_pixels["client_bytes"] == rgba.nbytes  # not those of five pictures
    np.testing.assert_array_equal(again, rgba)
    words = ["--quiet", *(word for each in STILL for word in ("--set", each))]
    places = ["-o", "b.npy", "-o", "b.exr", "--stats", "b.json"]
    assert main(["render", "film.toml", *places, "--bricks", "5", *words]) == 0
    np.testing.assert_array_equal(np.load("b.npy"), rgba)
    np.testing.assert_array_equal(load_image("b.exr")["depth"], depth)
    assert json.loads(Path("b.json").read_text())["bricks"] == 5
    assert main(["render", "film.toml", "-o", "w.exr", *words]) == 0
    whole = load_image("w.exr")
    assert np.abs(whole["rgba"] - rgba).max() < 1e-6
    np.testing.assert_allclose(whole["depth"], depth, rtol=1e-6)
    assert np.isfinite(depth).any()


@pytest.mark.slow  # two more programs in each worker
def test_bricks_of_a_projection_show_the_best_one(local):
    overrides = [*STILL, 'integration.compositing="maximum"']
    bricks = bricks_of(load_scene("film.toml", overrides).resolve(), 5)
    scene = {"path": "film.toml", "overrides": overrides, "count": 5, "devices": None, "memory_cap": None}
    rgba, depth, _ = bricks_on_workers(local, bricks, scene, ["film.toml", "waves.npy"], depth=True)
    words = ["--quiet", *(word for each in overrides for word in ("--set", each))]
    assert main(["render", "film.toml", "-o", "p.exr", *words]) == 0
    whole = load_image("p.exr")
    np.testing.assert_array_equal(whole["rgba"], rgba)
    np.testing.assert_allclose(whole["depth"], depth, rtol=1e-6)


@pytest.mark.slow  # a worker that starts again, some seconds
def test_a_worker_that_dies_with_its_bricks_costs_no_picture(local):
    bricks = bricks_of(load_scene("film.toml", STILL).resolve(), 4)
    scene = {"path": "film.toml", "overrides": STILL, "count": 4, "devices": None, "memory_cap": None}

    def kill_one(done: int, count: int) -> None:
        if done == count:  # all are rendered, and none is put together
            os.kill(workers()[0], signal.SIGKILL)

    rgba, _, _ = bricks_on_workers(local, bricks, scene, ["film.toml", "waves.npy"], kill_one)
    np.testing.assert_array_equal(rgba, bricks_on_workers(local, bricks, scene, ["film.toml", "waves.npy"])[0])


def test_a_brick_that_fails_ends_the_picture(local):
    bricks = bricks_of(load_scene("film.toml", STILL).resolve(), 2)
    scene = {"path": "film.toml", "overrides": ["image.width=0"], "count": 2, "devices": None, "memory_cap": None}
    with pytest.raises(SceneError, match="brick [01]: .*image.width"):
        bricks_on_workers(local, bricks, scene, ["film.toml"])


def test_tiles_of_workers_are_the_picture_of_one_process(local):
    overrides = ["animation.frames=1", "image.width=75", "image.height=50"]
    words = ["--quiet", *(word for each in overrides for word in ("--set", each))]
    assert main(["render", "film.toml", "-o", "t.npy", "-o", "t.exr", "--stats", "t.json", *words]) == 0
    whole, known = Frame.load("t.exr"), json.loads(Path("t.json").read_text())
    scene = {"path": "film.toml", "overrides": overrides, "devices": None, "memory_cap": None, "depth": True}
    rgba, depth, told = tiles_on_workers(local, scene, (75, 50), ["film.toml", "waves.npy"])
    np.testing.assert_array_equal(rgba, whole.rgba)
    np.testing.assert_array_equal(depth, whole.depth)
    assert (told["samples"], told["rays"]) == (known["samples"], known["rays"]) and told["packages"] >= 4
    with pytest.raises(SceneError, match="pixels depend on rays elsewhere"):
        spaced = {**scene, "overrides": [*overrides, "image.ray_spacing=2"]}
        tiles_on_workers(local, spaced, (75, 50), ["film.toml"])
    with pytest.raises(SceneError, match="image.samples: got 4, expected 1"):
        tiles_on_workers(local, {**scene, "overrides": [*overrides, "image.samples=4"]}, (75, 50), ["film.toml"])
    other = {**scene, "overrides": [*overrides, 'integration.method="reference"']}
    with pytest.raises(SceneError, match="got 'reference', expected 'raycast'"):
        tiles_on_workers(local, other, (75, 50), ["film.toml"])


@pytest.mark.parametrize(("width", "height"), [(1, 1), (512, 300), (17, 400), (1920, 1080)])
def test_rectangles_make_up_a_picture_in_whole_tiles(width, height):
    for count in (1, 2, 24, 100, 5000):
        covered = np.zeros((height, width), int)
        for left, top, right, bottom in rectangles(width, height, count, 16):
            assert left % 16 == 0 and top % 16 == 0 and (right % 16 == 0 or right == width)
            assert bottom % 16 == 0 or bottom == height
            covered[top:bottom, left:right] += 1
        assert (covered == 1).all()


def test_bricks_are_for_one_picture(capfd):
    assert main(["render", "film.toml", "-o", "f.npy", "--bricks", "2"]) == 2
    assert "--bricks: given for an animation" in capfd.readouterr().err


def test_a_worker_that_is_killed_costs_no_frame(local, alone):
    for name in names():
        with contextlib.suppress(FileNotFoundError):
            os.remove(name)
    made = []
    for frame in frames_on_workers(local, film(), ["film.toml", "waves.npy"], range(FRAMES)):
        made.append(frame.index)
        if len(made) == 4:
            os.kill(workers()[0], signal.SIGKILL)
    assert sorted(made) == list(range(FRAMES))
    check_frames(alone)


def test_a_worker_that_dies_before_it_has_started_is_replaced(tmp_path, monkeypatch):
    first = tmp_path / "first"
    first.touch()
    script = tmp_path / "process.py"
    script.write_text(
        "import os, runpy\n"
        f"if os.path.exists({str(first)!r}):\n    os.remove({str(first)!r})\n    os.kill(os.getpid(), 9)\n"
        f"runpy.run_path({str(local_module._PROCESS)!r}, run_name='__main__')\n"
    )
    monkeypatch.setattr(local_module, "_PROCESS", script)
    before = set(workers())
    with connected(1, None) as connection:
        assert not first.exists() and connection.client.submit(os.getpid).result() in set(workers()) - before
    assert set(workers()) == before


def test_workers_that_all_die_before_they_have_started_are_an_error(tmp_path, monkeypatch):
    (tmp_path / "process.py").write_text("raise SystemExit(3)")
    monkeypatch.setattr(local_module, "_PROCESS", tmp_path / "process.py")
    with pytest.raises(RenderError, match="--workers: processes end"), connected(2, None):
        pass


def test_shares_are_all_cores_and_none_twice():
    cores = len(os.sched_getaffinity(0))
    assert sorted(core for share in shares(cores) for core in share) == sorted(os.sched_getaffinity(0))
    assert all(len(share) == 1 for share in shares(3 * cores))


def test_a_missing_package_is_named(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"--workers: needs the package .*pip install 'clvol\[distributed\]'"):
        check_installed("--workers")


@pytest.mark.parametrize(
    ("scheduler", "error", "told"),
    [("nothing.json", UsageError, "there is no file"), ("tcp://127.0.0.1:9", RenderError, "does not answer")],
)
def test_a_scheduler_that_is_not_there(scheduler, error, told, monkeypatch):
    monkeypatch.setattr("clvol.cluster.connection.CONNECT_SECONDS", 0.3)
    with pytest.raises(error, match=told), connected(None, scheduler):
        pass


def test_a_file_that_is_no_scheduler_s(tmp_path):
    (tmp_path / "s.json").write_text("{}")
    with pytest.raises(UsageError, match="is not the file of a scheduler"), connected(None, str(tmp_path / "s.json")):
        pass
