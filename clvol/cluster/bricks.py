"""A picture from bricks on the workers of a cluster, none of which holds the volume."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from clvol.bricks.render import Bricks
from clvol.cluster import worker
from clvol.cluster.connection import Connection
from clvol.cluster.facts import Digests
from clvol.cluster.frames import part_of_picture
from clvol.cluster.queue import TaskQueue


def bricks_on_workers(
    connection: Connection, bricks: Bricks, scene: dict[str, Any], inputs: Sequence[str | os.PathLike[str]],
    progress: Callable[[int, int], None] | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:  # fmt: skip
    """The picture of ``bricks``, float32 [height, width, 4], each rendered by some worker, and stats. ``scene``: the
    arguments of ``clvol.bricks.render.BricksRun``. ``inputs``: the files that the scene names.

    The error of a brick ends the picture: it lacks a part.
    """
    count = len(bricks.boxes)
    common = {"scene": scene, "inputs": Digests().of(inputs)}
    queue = TaskQueue(connection, worker.brick, os.getcwd())
    partial: dict[int, np.ndarray] = {}
    samples, workers, largest = 0, set(), 0
    for answer in queue.run([{**common, "brick": number} for number in range(count)]):
        name = f"brick {answer.number}"
        said = part_of_picture(answer, name, name)
        partial[answer.number] = said["pixels"]
        samples, largest = samples + int(said["samples"]), max(largest, int(said["bytes"]))
        workers.add(said["worker"])
        if progress is not None:
            progress(len(partial), count)
    rgba = bricks.composited([partial[number] for number in range(count)])
    return rgba, {"samples": samples, "bricks": count, "workers": len(workers), "largest_brick_bytes": largest}
