"""SIGKILL at random moments: of a worker, of all but one, of the scheduler, of the client. Nothing is lost, nothing is
made twice, no file is half, and what is left goes on with --resume."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers.clusters import cluster, clvol, half_files, names, wait_until, workers_of, write_film

pytest.importorskip("psutil", reason="the extra 'distributed' brings it")

ROUNDS = 50
KINDS = ["worker", "all but one", "scheduler", "client"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> list[np.ndarray]:
    """The frames of one process that nobody killed."""
    folder = tmp_path_factory.mktemp("truth")
    write_film(folder)
    assert clvol("render", "film.toml", "-o", "f_%02d.npy", folder=folder).wait(timeout=300) == 0
    return [np.load(folder / name) for name in names()]


def made(folder) -> list[str]:
    return sorted(path.name for path in folder.glob("f_*.npy"))


def kill(pids) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def play(kind: str, folder, truth, seed: int) -> None:
    """Renders with three workers, one kill ``kind``, and the same command again if it cannot go on."""
    chance = random.Random(seed)
    write_film(folder)
    words = ["render", "film.toml", "-o", "f_%02d.npy", "--resume"]
    with cluster(folder / "dask", 3) as dask:
        command = clvol(*words, "--scheduler", str(dask.file), folder=folder)
        try:
            least = chance.randrange(4)
            wait_until(lambda: len(made(folder)) >= least and (least or len(dask.workers()) == 3)
                       or command.poll() is not None)  # fmt: skip
            time.sleep(0.5 * chance.random() ** 2)
            before = {name: (folder / name).stat().st_ino for name in made(folder)}
            if kind == "client":
                kill([command.pid])
            elif kind == "scheduler":
                kill([dask.scheduler.pid])
            else:
                workers = dask.workers()
                chance.shuffle(workers)
                kill(workers[: 1 if kind == "worker" else -1])
            told, said = command.communicate(timeout=300)
        finally:
            command.kill()
        assert half_files(folder) == []
        if kind in ("worker", "all but one"):
            assert command.returncode == 0, said
        elif kind == "scheduler" and command.returncode != 0:
            lost = "its scheduler is lost" in said or "does not answer" in said  # while it ran, or at the beginning
            assert command.returncode == 4 and lost and said.count("\n") == 1, said
            assert not told
        wait_until(lambda: kind == "scheduler" or dask.workers())
    if command.returncode != 0:
        again = clvol(*words, "--quiet", folder=folder)
        assert again.wait(timeout=300) == 0
    assert made(folder) == names() and half_files(folder) == []
    for name, rgba in zip(names(), truth):
        np.testing.assert_array_equal(np.load(folder / name), rgba)
    for name, inode in before.items():
        assert (folder / name).stat().st_ino == inode, f"{name} was made twice"
    for claim in folder.glob(".f_*.claim"):  # of one that died after its picture was there
        assert (folder / claim.name.split(".")[1]).with_suffix(".npy").exists()


@pytest.mark.slow  # a cluster of five processes, some eight seconds
def test_the_scheduler_dies(tmp_path, truth):
    play("scheduler", tmp_path, truth, 1)


def test_local_workers_end_with_their_client(tmp_path, truth):
    write_film(tmp_path)
    words = ["render", "film.toml", "-o", "f_%02d.npy", "--resume"]
    command = clvol(*words, "--workers", "2", folder=tmp_path)
    wait_until(lambda: made(tmp_path) or command.poll() is not None)
    workers = workers_of(command.pid)
    kill([command.pid])
    command.communicate(timeout=300)
    assert len(workers) == 2
    import psutil

    wait_until(lambda: not any(psutil.pid_exists(pid) and psutil.Process(pid).status() != "zombie" for pid in workers))
    assert half_files(tmp_path) == []
    assert clvol(*words, folder=tmp_path).wait(timeout=300) == 0
    for name, rgba in zip(names(), truth):
        np.testing.assert_array_equal(np.load(tmp_path / name), rgba)


@pytest.mark.slow  # fifty clusters, of some eight seconds each
@pytest.mark.parametrize("seed", range(ROUNDS))
def test_at_random(seed, tmp_path, truth):
    play(KINDS[seed % len(KINDS)], tmp_path, truth, seed)


@pytest.mark.slow  # a task that kills six workers
def test_a_frame_that_kills_its_workers_is_named_and_the_others_are_made(tmp_path, truth):
    write_film(tmp_path)
    (tmp_path / "killer.py").write_text(
        "import os, clvol.batch.frames as frames\n"
        "make = frames.FramesRun.make\n"
        "frames.FramesRun.make = lambda run, index: os.kill(os.getpid(), 9) if index == 5 else make(run, index)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "DASK_DISTRIBUTED__WORKER__PRELOAD": "['killer']"}
    words = ["render", "film.toml", "-o", "f_%02d.npy", "--workers", "2", "--quiet"]
    done = subprocess.run(
        [sys.executable, "-m", "clvol", *words], cwd=tmp_path, env=environment, capture_output=True, text=True,
        timeout=300,
    )  # fmt: skip
    assert done.returncode == 4 and "frame 5: the workers that had this task died again and again" in done.stderr
    assert made(tmp_path) == [name for name in names() if name != "f_05.npy"]
    for name, rgba in zip(names(), truth):
        if name != "f_05.npy":
            np.testing.assert_array_equal(np.load(tmp_path / name), rgba)
