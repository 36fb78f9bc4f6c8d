"""The frames of an animation on the workers of a cluster."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.batch.frames import Animation
from clvol.cluster import worker
from clvol.cluster.connection import Connection
from clvol.cluster.facts import Digests
from clvol.cluster.queue import Answer, TaskQueue
from clvol.errors import ClvolWarning, RenderError, error_of_status

_AHEAD = 64  # frames of a video that may wait for an earlier one


@dataclass
class MadeFrame:
    """What became of frame ``index``: its ``stats`` and the seconds that ``write`` took; ``is_kept``: its pictures were
    there already. ``error``: why it could not be made, with the exit ``status``. ``shown``: as displayed, for videos:
    uint8 [height, width, 3]."""

    index: int
    stats: dict[str, Any]
    write: float = 0.0
    is_kept: bool = False
    shown: np.ndarray | None = None
    worker: str = ""
    error: str | None = None
    status: int = 0


def frames_on_workers(
    connection: Connection, animation: Animation, inputs: Sequence[str | os.PathLike[str]], numbers: Sequence[int]
) -> Iterator[MadeFrame]:
    """Makes the frames ``numbers`` of an animation, and yields each once it is made or has failed: in the order of
    ``numbers`` if frames as displayed are wanted, and otherwise as they are made. ``inputs``: the files that the scene
    names; those of each worker must be the same. Warnings of workers become warnings here.

    RenderError if the scheduler is lost, or if no worker fits.
    """
    common = {"animation": animation.as_request(), "inputs": Digests().of(inputs)}
    requests = [{**common, "frame": number} for number in numbers]
    queue = TaskQueue(connection, worker.frame, os.getcwd())
    answers = queue.run(requests, _AHEAD if animation.shown else None)
    for answer in in_order(answers) if animation.shown else answers:
        warn_as_told(answer)
        yield _made(numbers[answer.number], answer)


def in_order(answers: Iterator[Answer]) -> Iterator[Answer]:
    """The same by their numbers, from 0."""
    early: dict[int, Answer] = {}
    following = 0
    for answer in answers:
        early[answer.number] = answer
        while following in early:
            yield early.pop(following)
            following += 1


def warn_as_told(answer: Answer) -> None:
    for where, what, advice in answer.said.get("warnings", []):
        warnings.warn(ClvolWarning(where, what, advice), stacklevel=3)


def part_of_picture(answer: Answer, part: str, where: str) -> dict[str, Any]:
    """What the worker of a ``part`` of one picture said. An error ends the picture, which would lack the part; what its
    worker reports is raised as an error of ``where``. Warnings become warnings here."""
    warn_as_told(answer)
    if answer.error is not None:
        raise RenderError(part, answer.error)
    if "error" in answer.said:
        raise error_of_status(int(answer.said["status"]))(where, str(answer.said["error"]))
    return answer.said


def _made(index: int, answer: Answer) -> MadeFrame:
    said = answer.said
    if answer.error is not None:
        return MadeFrame(index, {}, error=f"frame {index}: {answer.error}", status=answer.status)
    if "error" in said:
        return MadeFrame(index, {}, error=said["error"], status=int(said["status"]))
    if said.get("kept"):
        return MadeFrame(index, {}, is_kept=True)
    return MadeFrame(index, said["stats"], float(said["write"]), shown=said.get("pixels"), worker=said["worker"])
