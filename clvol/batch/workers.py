"""A job on several processes of this machine: they share it by claims; one that dies is replaced."""

from __future__ import annotations

import json
import os
import secrets
import selectors
import signal
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from clvol.batch.claims import Claims
from clvol.batch.job import Picture
from clvol.batch.results import append
from clvol.batch.run import STEPS, Options, Outcome
from clvol.errors import RenderError
from clvol.opencl.children import begin_tied_child, child_environment, end_child
from clvol.temporaries import remove_leftovers

MOST_DEATHS = 3  # of processes that were rendering one picture, until it is given up
_WORKER = Path(__file__).with_name("worker.py")


class _Worker:
    """A process. ``begun``: the numbers of pictures whose results it has not told, the one that it renders last."""

    def __init__(self, arguments: dict[str, Any], cores: Sequence[int], threads: int) -> None:
        environment = child_environment()
        environment.setdefault("POCL_MAX_PTHREAD_COUNT", str(threads))
        try:
            self.process, self._lifeline = begin_tied_child(_WORKER, {**arguments, "cores": list(cores)}, environment)
        except OSError as error:
            raise RenderError("workers", f"a process cannot be started: {error.strerror}") from None
        self.cores = cores
        self.begun: list[int] = []
        self._rest = b""

    @property
    def picture(self) -> int | None:
        """The number of the one that it renders."""
        return self.begun[-1] if self.begun else None

    def messages(self) -> list[dict[str, Any]] | None:
        """What it has told since the last call; None at its end."""
        assert self.process.stdout is not None
        piece = os.read(self.process.stdout.fileno(), 1 << 16)
        if not piece:
            return None
        *lines, self._rest = (self._rest + piece).split(b"\n")
        return [json.loads(line) for line in lines]

    def end(self) -> None:
        end_child(self.process)
        os.close(self._lifeline)
        assert self.process.stdout is not None
        self.process.stdout.close()


class WorkerPool:
    """``count`` processes that render the ``pictures`` of the job in the file ``job``; as ``JobRun`` otherwise.

    The cores of this process are divided among them. A process that crashes is replaced, and what it was rendering is
    rendered by others; a picture that ``MOST_DEATHS`` processes have died of is given up, and has failed.
    """

    def __init__(
        self, job: str, pictures: Sequence[Picture], options: Options, count: int,
        emit: Callable[[dict[str, Any]], None], progress: Callable[[int, int, str], None] | None = None,
    ) -> None:  # fmt: skip
        self._pictures, self._emit, self._progress = {p.number: p for p in pictures}, emit, progress
        self._options = replace(options, run=secrets.token_hex(8))
        self._arguments = {"job": os.path.abspath(job), "folder": os.getcwd(), "path": job}
        self._count = min(count, max(len(pictures), 1))
        self._deaths: Counter[int] = Counter()
        self._early_deaths = 0
        self._ended: dict[int, str] = {}  # pictures that are rendered, kept or have failed in this run
        self._selector = selectors.DefaultSelector()
        self._workers: list[_Worker] = []
        self.outcome = Outcome()

    def run(self) -> Outcome:
        """Returns once all pictures exist or have failed. RenderError if no process gets as far as a picture."""
        is_known = hasattr(os, "sched_getaffinity")
        cores = sorted(os.sched_getaffinity(0)) if is_known else list(range(os.cpu_count() or 1))
        shares = [cores[k :: self._count] or [cores[k % len(cores)]] for k in range(self._count)]
        try:
            for share in shares:
                self._begin(share)
            while self._workers:
                for key, _ in self._selector.select():
                    self._hear(key.data)
        finally:
            for worker in self._workers:
                worker.end()
            self._selector.close()
        counts = self.outcome.counts
        counts["kept"] = len(self._pictures) - counts["rendered"] - counts["failed"]
        return self.outcome

    def _begin(self, cores: Sequence[int]) -> None:
        skipped = [number for number, deaths in self._deaths.items() if deaths >= MOST_DEATHS]
        arguments = {**self._arguments, "options": asdict(self._options), "skipped": skipped}
        worker = _Worker(arguments, cores, max(len(cores), 1))
        self._workers.append(worker)
        assert worker.process.stdout is not None
        self._selector.register(worker.process.stdout, selectors.EVENT_READ, worker)

    def _hear(self, worker: _Worker) -> None:
        messages = worker.messages()
        if messages is None:
            self._bury(worker)
            return
        for message in messages:
            if "begin" in message:
                worker.begun = [*worker.begun[-1:], message["begin"]]
                self._report()
            elif "result" in message:
                worker.begun = [number for number in worker.begun if number != message["result"]["picture"]]
                self._take(message["result"])

    def _take(self, result: dict[str, Any]) -> None:
        number, status = result["picture"], result["status"]
        if number in self._ended:
            return
        self._ended[number] = status
        self.outcome.counts[status] += 1
        if status == "failed":
            self.outcome.status = max(self.outcome.status, int(result.pop("exit_status", 4)))
        self._emit(result)
        self._report()

    def _report(self) -> None:
        if self._progress is not None:
            begun = [worker.picture for worker in self._workers if worker.picture is not None]
            names = [os.path.basename(self._pictures[number].files[0]) for number in begun]
            self._progress(len(self._ended) * STEPS, len(self._pictures) * STEPS, ", ".join(names))

    def _bury(self, worker: _Worker) -> None:
        assert worker.process.stdout is not None
        self._selector.unregister(worker.process.stdout)
        self._workers.remove(worker)
        status = worker.process.wait()
        worker.end()
        if status == 0:
            return
        how = f"status {status}"
        if status < 0:
            how = signal.Signals(-status).name if -status in set(signal.Signals) else f"signal {-status}"
        if worker.picture is None:
            self._early_deaths += 1
            if self._early_deaths >= MOST_DEATHS:
                raise RenderError("workers", f"processes end before they render anything ({how})")
        else:
            for number in worker.begun:
                self._clear(self._pictures[number])
            self._deaths[worker.picture] += 1
            if self._deaths[worker.picture] == MOST_DEATHS:
                self._give_up(worker.picture, how)
        self._begin(worker.cores)

    def _clear(self, picture: Picture) -> None:
        """Removes what the process that was rendering ``picture`` has left, whether or not another one goes on."""
        with Claims() as claims, suppress(RenderError):
            claims.claim(picture.files[0])
        for folder in {os.path.dirname(path) for path in picture.files}:
            remove_leftovers(folder or ".")

    def _give_up(self, number: int, how: str) -> None:
        picture = self._pictures[number]
        message = f"{picture.files[0]}: {MOST_DEATHS} processes ended while they rendered it ({how})"
        result = {**picture.as_result(), "status": "failed", "message": message}
        append(self._options.results, {**result, "run": self._options.run})
        self._take({**result, "exit_status": RenderError.exit_status})
