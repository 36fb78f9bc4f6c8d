"""The pictures of a job on the workers of a cluster."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

from clvol.batch.job import Picture
from clvol.batch.results import append
from clvol.batch.run import STEPS, Options, Outcome
from clvol.cluster import worker
from clvol.cluster.connection import Connection
from clvol.cluster.facts import Digests
from clvol.cluster.queue import Answer, TaskQueue
from clvol.errors import ClvolError
from clvol.json_values import plain
from clvol.scene import load_scene


class ClusterRun:
    """The pictures of a job, each made by some worker; as ``clvol.batch.run.JobRun`` otherwise. Workers write pictures
    and results."""

    def __init__(
        self, connection: Connection, pictures: Sequence[Picture], options: Options,
        emit: Callable[[dict[str, Any]], None], progress: Callable[[int, int, str], None] | None = None,
    ) -> None:  # fmt: skip
        self._connection, self._pictures, self._emit = connection, list(pictures), emit
        self._options = replace(options, run=secrets.token_hex(8))
        self._progress = progress
        self.outcome = Outcome()

    def run(self) -> Outcome:
        """Returns once all pictures exist or have failed. RenderError if the scheduler is lost or no worker fits."""
        counts, digests = self.outcome.counts, Digests()
        options = asdict(self._options)
        requests = [
            {"options": options, "picture": _described(p), "inputs": digests.of(_inputs(p))} for p in self._pictures
        ]
        queue = TaskQueue(self._connection, worker.picture, os.getcwd())
        for done, answer in enumerate(queue.run(requests), 1):
            self._take(answer)
            if self._progress is not None:
                name = os.path.basename(self._pictures[answer.number].files[0])
                self._progress(done * STEPS, len(requests) * STEPS, name)
        counts["kept"] = len(self._pictures) - counts["rendered"] - counts["failed"]
        return self.outcome

    def _take(self, answer: Answer) -> None:
        if answer.error is not None or "error" in answer.said:
            picture = self._pictures[answer.number]
            message, status = answer.error, answer.status
            if message is None:
                message, status = str(answer.said["error"]), int(answer.said["status"])
            else:
                message = f"{picture.files[0]}: {message}"
            failed = {**picture.as_result(), "status": "failed", "message": message, "exit_status": status}
            append(self._options.results, {**failed, "run": self._options.run})
            self._count(failed)
            return
        for result in answer.said["results"]:
            self._count(result)

    def _count(self, result: dict[str, Any]) -> None:
        self.outcome.counts[result["status"]] += 1
        if result["status"] == "failed":
            self.outcome.status = max(self.outcome.status, int(result["exit_status"]))
        self._emit(result)


def _described(picture: Picture) -> dict[str, Any]:
    return plain(asdict(picture))


def _inputs(picture: Picture) -> list[str]:
    """The files that a picture is made from; without those of its scene if that is wrong, which its worker reports."""
    named = [picture.source, *([picture.volume] if picture.volume is not None else [])]
    try:
        return [*named, *map(str, load_scene(picture.source, settings=picture.settings).input_paths)]
    except ClvolError:
        return named
