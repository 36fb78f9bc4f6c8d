"""The examples for SLURM, as far as they run without it: srun is played, and dask-jobqueue writes its job script."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.clusters import half_files, names, write_film

JOBS = Path(__file__).resolve().parents[2] / "data" / "examples" / "jobs"
SRUN = """#!/bin/bash
for task in 1 2; do "$@" & done
trap 'kill $(jobs -p)' TERM
wait
"""


@pytest.mark.slow  # a scheduler, two workers and the command: some ten seconds
def test_the_script_for_sbatch_renders(tmp_path):
    write_film(tmp_path, frames=3, size=24)
    tools = tmp_path / "tools"
    tools.mkdir()
    python = sys.executable
    for name, text in (("srun", SRUN), ("dask", f'#!/bin/sh\nexec {python} -m dask "$@"\n'),
                       ("clvol", f'#!/bin/sh\nexec {python} -m clvol "$@"\n')):  # fmt: skip
        (tools / name).write_text(text)
        (tools / name).chmod(0o755)
    environment = {**os.environ, "PATH": f"{tools}:{os.environ['PATH']}", "PYTHONPATH": str(JOBS.parents[2])}
    done = subprocess.run(
        ["bash", JOBS / "slurm.sh", "film.toml", "f_%02d.npy"], cwd=tmp_path, env=environment, capture_output=True,
        text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done
    assert sorted(path.name for path in tmp_path.glob("f_*.npy")) == names(3) and half_files(tmp_path) == []
    assert not list(tmp_path.glob(".dask-*"))


def test_the_job_script_of_dask_jobqueue_asks_for_workers_that_fit(monkeypatch):
    pytest.importorskip("dask_jobqueue", reason="dask-jobqueue is not installed")
    example = runpy.run_path(str(JOBS / "slurm_jobqueue.py"))
    with example["cluster"](scheduler_options={"host": "127.0.0.1", "dashboard_address": None}) as slurm:
        script = slurm.job_script()
    assert "#SBATCH --cpus-per-task=8" in script or "#SBATCH -c 8" in script or "#SBATCH --cpus-per-task 8" in script
    assert "#SBATCH -t 01:00:00" in script
    (worker,) = [line for line in script.splitlines() if "worker" in line and "--nthreads" in line]
    for words in ("--nthreads 1", "--resources opencl=1"):
        assert words in worker
