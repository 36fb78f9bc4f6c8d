"""Jobs on several processes, some of which are killed."""

from __future__ import annotations

import os
import random
import signal
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from clvol.batch import workers as workers_module
from clvol.batch.job import load_job, pictures_of
from clvol.batch.results import results_in
from clvol.batch.run import JobRun, Options
from clvol.batch.workers import MOST_DEATHS, WorkerPool
from clvol.errors import RenderError

STEPS = [0.4, 0.6, 0.8, 1.0]


@pytest.fixture
def job(tmp_path, monkeypatch):
    """The name of a job of four pictures in the working folder."""
    monkeypatch.chdir(tmp_path)
    np.save("cube.npy", np.arange(512, dtype=np.uint16).reshape(8, 8, 8))
    text = 'volumes = ["cube.npy"]\noutput = "{step}.npy"\nset = { "image.width" = 40, "image.height" = 30 }\n'
    Path("job.toml").write_text(text + f'[[vary]]\nkey = "integration.step"\nname = "step"\nvalues = {STEPS}\n')
    return "job.toml"


def pool(job: str, count: int, kills=lambda pool, name: None) -> WorkerPool:
    """``kills(pool, name)``: called while pictures of these names are rendered."""
    pictures = pictures_of(load_job(job), job)
    made: WorkerPool

    def progress(done: int, total: int, names: str) -> None:
        assert 0 <= done <= total
        kills(made, names)

    made = WorkerPool(job, pictures, Options(results="r.jsonl"), count, lambda result: None, progress)
    return made


def kill(pool: WorkerPool, name: str) -> None:
    """Those that render ``name``."""
    for worker in pool._workers:
        if worker.picture is not None and pool._pictures[worker.picture].files[0] == name:
            os.kill(worker.process.pid, signal.SIGKILL)


def hidden() -> list[str]:
    return [name for name in os.listdir() if name.startswith(".")]


def test_processes_that_end_at_once_are_an_error(job, tmp_path, monkeypatch):
    (tmp_path / "worker.py").write_text("raise SystemExit(5)")
    monkeypatch.setattr(workers_module, "_WORKER", tmp_path / "worker.py")
    with pytest.raises(RenderError, match="before they render anything .status 5."):
        pool(job, 2).run()


@pytest.mark.slow  # processes that start, for some ten seconds
def test_one_that_nobody_survives_is_given_up_and_the_others_are_right(job):
    victim = "0.6.npy"
    outcome = pool(job, 2, lambda pool, names: kill(pool, victim) if victim in names else None).run()
    assert outcome.status == 4 and outcome.counts == {"rendered": 3, "kept": 0, "failed": 1}
    (failed,) = [each for each in results_in("r.jsonl") if each["status"] == "failed"]
    assert failed["files"] == [victim] and "3 processes ended while they rendered it (SIGKILL)" in failed["message"]
    assert not os.path.exists(victim)
    assert not hidden()
    made = {name: np.load(name) for name in os.listdir() if name.endswith(".npy") and name != "cube.npy"}
    for name in made:
        os.remove(name)
    JobRun(pictures_of(load_job(job), job), Options(results="s.jsonl"), lambda result: None).run()
    for name, rgba in made.items():
        np.testing.assert_array_equal(rgba, np.load(name))
    assert sorted(made) == ["0.4.npy", "0.8.npy", "1.npy"]


@pytest.mark.slow  # processes that start, for some ten seconds
def test_killed_at_random_nothing_is_lost_and_nothing_doubled(job):
    chance, deaths = random.Random(4), Counter[str]()

    def kills(pool: WorkerPool, names: str) -> None:
        name = names.split(", ")[0]
        if name and deaths[name] < MOST_DEATHS - 1 and chance.random() < 0.5:
            deaths[name] += 1
            kill(pool, name)

    outcome = pool(job, 2, kills).run()
    assert deaths.total() >= 2 and outcome.status == 0 and outcome.counts["failed"] == 0
    assert all(os.path.exists(f"{step:g}.npy") for step in STEPS)
    rendered = [each["picture"] for each in results_in("r.jsonl")]
    assert len(rendered) == len(set(rendered))
    assert not hidden()
