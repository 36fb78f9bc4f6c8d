"""An animation on jobs that dask-jobqueue submits to SLURM, one worker each, as many as there is work for.

    python slurm_jobqueue.py SCENE 'frames/%04d.png'        (pip install 'clvol[distributed]' dask-jobqueue)
"""

from __future__ import annotations

import subprocess
import sys
from typing import Any

WORKER = {
    "cores": 1, "processes": 1,                              # one thread: clvol uses all cores of the job by itself
    "job_cpu": 8, "memory": "32GB", "walltime": "01:00:00",
    "worker_extra_args": ["--resources", "opencl=1", "--no-dashboard"],
}  # fmt: skip


def cluster(**options: Any):
    from dask_jobqueue import SLURMCluster

    return SLURMCluster(**{**WORKER, **options})


def main(scene: str, output: str, workers: int = 16) -> int:
    with cluster() as slurm:
        slurm.scale(workers)
        command = ["clvol", "render", scene, "-o", output, "--scheduler", slurm.scheduler_address, "--resume"]
        return subprocess.run(command).returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
