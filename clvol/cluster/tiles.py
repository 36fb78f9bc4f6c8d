"""The tiles of one picture on the workers of a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from clvol.cluster import worker
from clvol.cluster.connection import Connection
from clvol.cluster.facts import Digests
from clvol.cluster.frames import part_of_picture
from clvol.cluster.queue import TaskQueue
from clvol.render.some_tiles import rectangles
from clvol.schedule.tiles import TILE

_PACKAGES = 6  # per worker: the last one ends within a part of this that the edges of a picture cost


def tiles_on_workers(
    connection: Connection, scene: dict[str, Any], size: tuple[int, int],
    inputs: Sequence[str | os.PathLike[str]], progress: Callable[[int, int], None] | None = None,
) -> tuple[np.ndarray, np.ndarray | None, dict[str, Any]]:  # fmt: skip
    """The picture of ``size`` (width, height): float32 [height, width, 4], its depth if ``scene`` requests it, and
    stats. Each of its tiles is rendered by some worker, and counts once. ``scene``: the arguments of
    ``clvol.render.some_tiles.TilesRun``. ``inputs``: the files that the scene names.

    The error of a part ends the picture.
    """
    width, height = size
    workers = len(connection.cores) or connection.worker_count()
    parts = rectangles(width, height, _PACKAGES * max(workers, 1), TILE)
    common = {"scene": scene, "inputs": Digests().of(inputs)}
    queue = TaskQueue(connection, worker.tiles, os.getcwd())
    rgba = np.zeros((height, width, 4), np.float32)
    depth = np.full((height, width), np.inf, np.float32) if scene["depth"] else None
    counted: dict[str, Any] = {"samples": 0, "rays": 0}
    counters: dict[str, int] = {}
    used = set()
    for done, answer in enumerate(queue.run([{**common, "rectangle": part} for part in parts]), 1):
        left, top, right, bottom = parts[answer.number]
        said = part_of_picture(answer, f"rows {top} to {bottom}", "--workers")
        rgba[top:bottom, left:right] = said["pixels"][..., :4]
        if depth is not None:
            depth[top:bottom, left:right] = said["pixels"][..., 4]
        for name in ("samples", "rays"):
            counted[name] += int(said[name])
        for name, count in said["counters"].items():
            counters[name] = counters.get(name, 0) + int(count)
        used.add(said["worker"])
        if progress is not None:
            progress(done, len(parts))
    more = {"counters": counters} if counters else {}
    return rgba, depth, {**counted, **more, "workers": len(used), "packages": len(parts)}
