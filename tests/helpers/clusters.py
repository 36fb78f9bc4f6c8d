"""A dask cluster of processes, any of which a test may kill; and an animation for it."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

FRAMES = 16


def write_film(folder: Path, frames: int = FRAMES, size: int = 160) -> None:
    """film.toml and its volume."""
    z, y, x = np.mgrid[0:24, 0:24, 0:24]
    np.save(folder / "waves.npy", (127 + 127 * np.sin(x / 3) * np.cos(y / 4) * np.sin(z / 5)).astype(np.uint8))
    (folder / "film.toml").write_text(
        f'version = 1\n[volume]\nfile = "waves.npy"\n[image]\nwidth = {size}\nheight = {size}\n'
        '[transfer_function]\npreset = "grayscale"\n[integration]\nclassification = "post"\nstep_error = 0.0\n'
        f"[animation]\nframes = {frames}\nfps = 4\norbit_degrees = 90\n"
    )


def names(frames: int = FRAMES) -> list[str]:
    return [f"f_{k:02d}.npy" for k in range(frames)]


def clvol(*words: str, folder: Path) -> subprocess.Popen:
    """The command, begun in ``folder``."""
    return subprocess.Popen(
        [sys.executable, "-m", "clvol", *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip


@dataclass
class Cluster:
    file: Path
    scheduler: subprocess.Popen
    nannies: list[subprocess.Popen]

    def workers(self) -> list[int]:
        """The processes that render."""
        return [pid for nanny in self.nannies for pid in _children(nanny.pid, "spawn_main")]


def workers_of(pid: int) -> list[int]:
    """The processes that local workers of the command ``pid`` run in."""
    return _children(pid, "process.py")


def _children(pid: int, word: str) -> list[int]:
    """The processes that ``pid`` has started whose command has ``word``."""
    import psutil

    with contextlib.suppress(psutil.NoSuchProcess):
        return [c.pid for c in psutil.Process(pid).children(recursive=True) if word in " ".join(_words(c))]
    return []


def _words(process) -> list[str]:
    import psutil

    with contextlib.suppress(psutil.Error):
        return process.cmdline()
    return []


@contextlib.contextmanager
def cluster(folder: Path, workers: int, *more: str) -> Iterator[Cluster]:
    """A scheduler and ``workers`` workers, which are replaced when they die: each has a command of its own, since one
    command gives up, with all its workers, when one of them dies before it has started."""
    folder.mkdir(exist_ok=True)
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    dask = [sys.executable, "-m"]
    scheduler = subprocess.Popen(
        [*dask, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
         "--scheduler-file", str(file)], **quiet)  # fmt: skip
    worker = [*dask, "distributed.cli.dask_worker", "--scheduler-file", str(file), "--nthreads", "1", "--resources",
              "opencl=1", "--no-dashboard", "--host", "127.0.0.1", "--memory-limit", "0", "--local-directory",
              str(folder), *more]  # fmt: skip
    nannies = [subprocess.Popen(worker, **quiet) for _ in range(workers)]
    made = Cluster(file, scheduler, nannies)
    try:
        _wait(lambda: file.exists() and file.stat().st_size > 0)
        yield made
    finally:
        children = made.workers()
        for process in (scheduler, *nannies):
            process.kill()
            process.wait()
        for pid in children:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, 9)


def _wait(is_so, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < end, "the cluster does not start"
        time.sleep(0.05)


wait_until = _wait


def half_files(folder: Path) -> list[str]:
    """Pictures in ``folder`` that are not whole."""
    from clvol.image import is_intact, load_image

    found = []
    for path in sorted(folder.glob("f_*.npy")):
        try:
            if not is_intact(path, load_image(path)):
                found.append(path.name)
        except Exception as error:
            found.append(f"{path.name}: {error}")
    return found
