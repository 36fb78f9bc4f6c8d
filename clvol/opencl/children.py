"""Child processes in which OpenCL is tried, so that a broken library cannot take this process down."""

from __future__ import annotations

import json
import os
import select
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from clvol.lazily import lazily
from clvol.opencl import probe
from clvol.opencl.folders import scratch_folder
from clvol.opencl.reports import Icd

if TYPE_CHECKING:
    import subprocess
else:
    subprocess = lazily("subprocess")

VENDORS = "OCL_ICD_VENDORS"
ORIGINAL_VENDORS = os.environ.get(VENDORS)  # as this process was started
_END_LIMIT = 5.0  # seconds that libraries may take to be unloaded


@dataclass
class Child:
    """The answers of one probe child before it finished or died."""

    events: list[dict] = field(default_factory=list)
    death: str = ""  # one line, "" when it finished
    end: str = ""  # one line, if it finished but then did not exit properly

    def has(self, event: str) -> bool:
        return any(e["event"] == event for e in self.events)


def write_selection(icds: list[Icd], folder: Path) -> None:
    for number, icd in enumerate(icds):
        name = f"{number:02d}-{Path(icd.path).stem}.icd"
        (folder / name).write_bytes(os.fsencode(icd.library + "\n"))


def run_child(request: dict, selection: list[Icd] | None, time_limit: float) -> Child:
    """Run one probe child to its end or to its time limit."""
    environment = child_environment()
    environment["PYOPENCL_NO_CACHE"] = "1"
    environment["OPENBLAS_NUM_THREADS"] = "1"  # numpy fails where it may not start all its threads
    environment["PYTHONWARNINGS"] = "ignore"
    environment.pop("PYTHONFAULTHANDLER", None)
    child = Child()
    with tempfile.TemporaryDirectory(prefix="probe-", dir=scratch_folder()) as folder, \
            open(os.path.join(folder, "stderr"), "w+b") as stderr:
        request = {**request, "only_vendors_folder": selection is not None}
        environment["POCL_CACHE_DIR"] = os.path.join(folder, "pocl")  # so that no damaged or full cache is used
        os.mkdir(environment["POCL_CACHE_DIR"])
        if selection is not None:
            icds = Path(folder) / "icd"
            icds.mkdir()
            write_selection(selection, icds)
            environment[VENDORS] = str(icds)
        command = child_command(probe.__file__, json.dumps(request))
        try:
            process = subprocess.Popen(
                command, env=environment, cwd=folder, stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE, stderr=stderr, start_new_session=True)
        except OSError as error:
            child.death = f"{command[0]} cannot be started: {error.strerror}"
            return child
        status = None  # stays None if the process hangs
        answers = process.stdout
        assert answers is not None  # a pipe, as requested above
        try:
            limit = time_limit
            for line in _lines_in_time(answers.fileno(), lambda: limit):
                child.events.append(json.loads(line))
                if child.has("done"):
                    limit = min(time_limit, _END_LIMIT)
            status = process.wait(timeout=limit)
        except (TimeoutError, subprocess.TimeoutExpired):
            pass
        except ValueError:  # half a line
            try:
                status = process.wait(timeout=time_limit)
            except subprocess.TimeoutExpired:
                pass
        finally:
            end_child(process)
            answers.close()
        if child.has("done"):
            if status is None:
                child.end = "does not stop"
            elif status != 0:
                child.end = _death(status, "")
        elif status is None:
            child.death = f"no answer within {time_limit:g} s"
        else:
            stderr.seek(0)
            text = stderr.read()[-20000:].decode("utf-8", errors="replace")
            child.death = _death(status, text)
    return child


def _lines_in_time(source: int, limit: Callable[[], float]) -> Iterator[bytes]:
    """Lines as they arrive; TimeoutError where the next one takes longer than ``limit()`` seconds. No thread is
    used, since a machine may allow few of them."""
    rest = b""
    poll = select.poll()
    poll.register(source, select.POLLIN)
    while True:
        end = time.monotonic() + limit()
        while b"\n" not in rest:
            if not poll.poll(max(1e3 * (end - time.monotonic()), 0.0)):
                raise TimeoutError
            piece = os.read(source, 65536)
            if not piece:
                if rest:
                    yield rest
                return
            rest += piece
        line, rest = rest.split(b"\n", 1)
        yield line


# PYTHONPATH is not used, since a folder's name in it cannot hold a colon. The working folder is removed from the path,
# so that modules in it are not imported.
_START = "import sys; del sys.path[0]; import json, runpy; "
_START += "sys.path[:] = json.loads(sys.argv.pop(1)); del sys.argv[0]; "
_START += "runpy.run_path(sys.argv[0], run_name='__main__')"


def child_command(file: str, *arguments: str) -> list[str]:
    """The command that runs a Python file with exactly the modules that this process finds."""
    python = sys.executable or shutil.which("python3") or "python3"
    path = json.dumps([os.path.abspath(p) for p in sys.path])
    return [python, "-c", _START, path, file, *arguments]


def child_environment() -> dict[str, str]:
    """The environment that this process was started with."""
    environment = dict(os.environ)
    environment.pop(VENDORS, None)
    if ORIGINAL_VENDORS is not None:
        environment[VENDORS] = ORIGINAL_VENDORS
    return environment


def end_child(process: subprocess.Popen) -> None:
    """Ends the child, if it is still running, and all processes that its drivers have started."""
    if process.poll() is None:
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except (OSError, AttributeError):
            process.kill()
        process.wait()


def _death(status: int, stderr: str) -> str:
    """One line that says how a child ended before it had finished."""
    if status < 0:
        try:
            how = f"crashed ({signal.Signals(-status).name})"
        except ValueError:
            how = f"crashed (signal {-status})"
        line = probe.first_meaningful_line(stderr)
    else:
        how = f"ended with status {status}"
        # An uncaught exception: its message is the last line of the traceback.
        lines = [line for line in stderr.splitlines() if line.strip()]
        line = probe.first_meaningful_line(lines[-1]) if lines else ""
    return f"{how}: {line}" if line else how
