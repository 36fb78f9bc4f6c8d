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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
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
    return BegunChild(request, selection).finished(time_limit)


class BegunChild:
    """A probe child that runs beside this process until ``finished`` waits for it, or ``end`` ends it.

    A child whose request has ``serves`` then builds programs that it is told by ``build``; the folders in which PoCL
    has them are moved to ``keep`` in the end, and named in the child's events "built".
    """

    def __init__(self, request: dict, selection: list[Icd] | None, keep: Path | None = None) -> None:
        environment = child_environment()
        environment["PYOPENCL_NO_CACHE"] = "1"
        environment["OPENBLAS_NUM_THREADS"] = "1"  # numpy fails where it may not start all its threads
        environment["PYTHONWARNINGS"] = "ignore"
        environment.pop("PYTHONFAULTHANDLER", None)
        self._keep, self._process, self._failed = keep, None, ""
        self._held = ExitStack()
        with ExitStack() as held:
            folder = held.enter_context(tempfile.TemporaryDirectory(prefix="probe-", dir=scratch_folder()))
            self._stderr = held.enter_context(open(os.path.join(folder, "stderr"), "w+b"))
            request = {**request, "only_vendors_folder": selection is not None}
            self._pocl = Path(folder, "pocl")
            environment["POCL_CACHE_DIR"] = str(self._pocl)  # so that no damaged or full cache is used
            self._pocl.mkdir()
            if selection is not None:
                icds = Path(folder) / "icd"
                icds.mkdir()
                write_selection(selection, icds)
                environment[VENDORS] = str(icds)
            command = child_command(probe.__file__, json.dumps(request))
            try:
                self._process = subprocess.Popen(
                    command, env=environment, cwd=folder, stdout=subprocess.PIPE, stderr=self._stderr,
                    stdin=subprocess.PIPE if request.get("serves") else subprocess.DEVNULL, start_new_session=True)
            except OSError as error:
                self._failed = f"{command[0]} cannot be started: {error.strerror}"
            self._held = held.pop_all()

    def build(self, programs: Sequence[Mapping[str, str]]) -> None:
        """Has ``programs`` (each with ``source``, ``options`` and ``token``, by which events name it) built on PoCL,
        once its device has been found to work. What does not build is met again by whoever needs it."""
        if self._process is None or self._process.stdin is None:
            return
        try:
            self._process.stdin.write("".join(json.dumps(program) + "\n" for program in programs).encode())
            self._process.stdin.flush()
        except OSError:  # it has ended already
            pass

    def end(self) -> None:
        """Ends it at once."""
        if self._process is not None:
            end_child(self._process)
            for stream in (self._process.stdin, self._process.stdout):
                if stream is not None:
                    with suppress(OSError):
                        stream.close()
            self._process = None
        self._held.close()

    def finished(self, time_limit: float) -> Child:
        """What it has answered by its end; it is ended where an answer takes longer than ``time_limit`` seconds."""
        child = Child()
        process = self._process
        if process is None:
            child.death = self._failed
            self._held.close()
            return child
        status = None  # stays None if the process hangs
        answers = process.stdout
        assert answers is not None  # a pipe, as requested above
        try:
            limit = time_limit
            if process.stdin is not None:
                with suppress(OSError):
                    process.stdin.close()  # nothing more will be built
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
            self._keep_built(child)
            text = self._said()
            self.end()
        if child.has("done"):
            if status is None:
                child.end = "does not stop"
            elif status != 0:
                child.end = _death(status, "")
        elif status is None:
            child.death = f"no answer within {time_limit:g} s"
        else:
            child.death = _death(status, text)
        return child

    def _said(self) -> str:
        self._stderr.seek(0)
        return self._stderr.read()[-20000:].decode("utf-8", errors="replace")

    def _keep_built(self, child: Child) -> None:
        for event in child.events:
            if event["event"] == "built" and self._keep is not None:
                with suppress(OSError):
                    target = self._keep / event["place"]
                    target.parent.mkdir(parents=True, exist_ok=True)
                    os.rename(self._pocl / event["place"], target)


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


def begin_tied_child(
    script: Path, request: Mapping[str, object], environment: Mapping[str, str]
) -> tuple[subprocess.Popen[bytes], int]:
    """Begins a process of ``script`` that ends when this one does, and the end of the pipe whose closing ends it. It is
    told ``request`` as JSON, with "lifeline" and "parent" for ``end_with_parent``; its standard output is a pipe.
    OSError if it cannot be started."""
    watched, lifeline = os.pipe()
    told = json.dumps({**request, "lifeline": watched, "parent": os.getpid()})
    try:
        process = subprocess.Popen(
            child_command(str(script), told), env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            pass_fds=(watched,), start_new_session=True,
        )  # fmt: skip
    except BaseException:
        os.close(lifeline)
        raise
    finally:
        os.close(watched)
    return process, lifeline


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
