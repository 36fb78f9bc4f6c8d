"""The peers of the bench of compression: zfp (Lindstrom 2014; package zfpy) and SZ3 (Liang et al. 2023; package pysz).

``zfpy`` breaks the import of numcodecs, so both live in a virtual environment of their own in clvol's cache folder,
which the first run makes, and work in a child process (compression_child.py).
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

PACKAGES = {"zfp": "zfpy", "sz3": "pysz"}  # codec: what it is installed as
_CHILD = Path(__file__).resolve().parent / "compression_child.py"


class PeerError(Exception):
    """A codec of a peer failed, or its process did."""


def environment(say: Callable[[str], None], folder: Path | None = None) -> Path | None:
    """The Python of an environment in ``folder`` with as many of the PACKAGES as can be installed; made at first use.
    None where there are none of them."""
    from clvol.opencl.folders import cache_folder, why_no_cache

    if folder is None:
        cache = cache_folder()
        if cache is None:
            say(f"no place for an environment: {why_no_cache()}")
            return None
        folder = cache / "bench-peers"
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    stamp = folder / "installed.json"
    if python.is_file() and stamp.is_file():
        return python
    say(f"making an environment for {' and '.join(PACKAGES.values())}, once")
    if not _quietly([sys.executable, "-m", "venv", "--clear", str(folder)], say):
        return None
    pip = [str(python), "-m", "pip", "install", "--disable-pip-version-check", "--retries", "1", "--quiet"]
    there = [package for package in PACKAGES.values() if _quietly([*pip, package], say)]
    if len(there) == len(PACKAGES):
        stamp.write_text(json.dumps(there), encoding="utf-8")
    return python if there else None


def _quietly(command: list[str], say: Callable[[str], None]) -> bool:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no reason"])[-1]
        say(f"failed, so it is left out: {' '.join(command[1:])}: {last}")
    return done.returncode == 0


@dataclass(frozen=True)
class Encoded:
    """``bytes``: of the whole stream. ``key``: under which the process keeps it."""

    bytes: int
    seconds: float
    key: str


class Peers:
    """The process. ``versions``: of the packages that it has."""

    def __init__(self, python: Path, folder: Path) -> None:
        self._folder = folder
        self._process = subprocess.Popen(
            [str(python), str(_CHILD)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.versions: dict[str, str] = self._ask(do="versions")["versions"]

    @property
    def codecs(self) -> tuple[str, ...]:
        return tuple(codec for codec, package in PACKAGES.items() if package in self.versions)

    def load(self, voxels: np.ndarray) -> None:
        """``voxels`` [z, y, x] are what the further calls are about."""
        path = self._folder / "voxels.npy"
        np.save(path, voxels)
        self._ask(do="load", file=str(path))
        path.unlink()

    def encode(self, codec: str, mode: str, value: float) -> Encoded:
        key = f"{codec} {mode} {value:g}"
        found = self._ask(do="encode", codec=codec, mode=mode, value=value, key=key)
        return Encoded(found["bytes"], found["seconds"], key)

    def decode(self, encoded: Encoded) -> tuple[np.ndarray, float]:
        """The voxels, in their own type, and the seconds that decoding took."""
        path = self._folder / "decoded.npy"
        seconds = self._ask(do="decode", key=encoded.key, file=str(path))["seconds"]
        voxels = np.load(path, allow_pickle=False)
        path.unlink()
        return voxels, seconds

    def decode_seconds(self, encoded: Encoded) -> float:
        return self._ask(do="decode", key=encoded.key)["seconds"]

    def forget(self) -> None:
        self._ask(do="forget")

    def close(self) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(BrokenPipeError):  # it may have ended before it read everything
            self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def _ask(self, **request: Any) -> dict[str, Any]:
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise PeerError(f"the process of zfp and SZ3 ended (status {self._process.wait()})")
        answer = json.loads(line)
        if "error" in answer:
            raise PeerError(f"{request.get('key', request['do'])}: {answer['error']}")
        return answer


@contextmanager
def peers(say: Callable[[str], None]) -> Iterator[Peers | None]:
    """zfp and SZ3, or None where they cannot be had."""
    python = environment(say)
    if python is None:
        say("zfp and SZ3 are left out: neither zfpy nor pysz can be installed here")
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="clvol-bench-") as folder:
        found = Peers(python, Path(folder))
        for codec in PACKAGES:
            if codec not in found.codecs:
                say(f"{codec} is left out: {PACKAGES[codec]} cannot be imported")
        try:
            yield found if found.codecs else None
        finally:
            found.close()
