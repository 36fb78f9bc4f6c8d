"""A picture from bricks on the workers of a cluster, none of which holds the volume.

Partial pictures stay with the workers that rendered them. Each row of the picture is put together by one worker, to
which all others send their pixels of it (direct send: Hsu, "Segmented ray casting for data parallel volume rendering",
1993; Eilemann and Pajarola 2007), in the order and by the arithmetic of one process, so that it has the same bits. The
client receives one picture, however many bricks there are.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from clvol.bricks.render import Bricks, nearest
from clvol.cluster import worker
from clvol.cluster.connection import Connection
from clvol.cluster.facts import Digests
from clvol.cluster.frames import part_of_picture
from clvol.cluster.queue import Answer, TaskQueue


def bricks_on_workers(
    connection: Connection, bricks: Bricks, scene: dict[str, Any], inputs: Sequence[str | os.PathLike[str]],
    progress: Callable[[int, int], None] | None = None, depth: bool = False,
) -> tuple[np.ndarray, np.ndarray | None, dict[str, Any]]:  # fmt: skip
    """The picture of ``bricks``, float32 [height, width, 4], each rendered by some worker, its ``depth`` if that is
    wanted, float32 [height, width], and stats; "client_bytes" of them are those of pixels that came to this process.
    ``scene``: the arguments of ``clvol.bricks.render.BricksRun``. ``inputs``: the files that the scene names.

    The error of a brick ends the picture: it lacks a part.
    """
    common = {"scene": scene, "inputs": Digests().of(inputs)}
    queue = TaskQueue(connection, worker.brick, os.getcwd(), keeps=True)
    kept, told = _rendered(queue, common, len(bricks.boxes), progress)
    client = connection.client
    order, image = bricks.order(), bricks.resolved.image
    workers = {said["worker"] for said in told.values()}
    rows = np.linspace(0, image.height, min(len(workers), image.height) + 1).astype(int).tolist()
    strips = []
    for top, bottom in zip(rows, rows[1:]):
        parts = [client.submit(worker.rows_of, kept[number].future, top, bottom, pure=False) for number in order]
        strips.append(client.submit(worker.composited_rows, parts, pure=False))
    rgba = np.concatenate(queue.results(strips))
    distances, received = None, rgba.nbytes
    if depth:
        asked = [client.submit(worker.last_channel_of, kept[number].future, pure=False) for number in range(len(kept))]
        last = queue.results(asked)
        depths = _depths(connection, bricks, last, common)
        distances = nearest(depths, image.height, image.width)
        received += sum(each.nbytes for each in [*last, *depths])
    return rgba, distances, {
        "samples": sum(int(said["samples"]) for said in told.values()), "bricks": len(kept), "workers": len(workers),
        "largest_brick_bytes": max(int(said["bytes"]) for said in told.values()), "client_bytes": received,
    }  # fmt: skip


def _rendered(
    queue: TaskQueue, common: dict[str, Any], count: int, progress: Callable[[int, int], None] | None
) -> tuple[dict[int, Answer], dict[int, dict[str, Any]]]:
    """The answers for all bricks, which their workers keep, and what they say beside pixels, by number."""
    kept: dict[int, Answer] = {}
    told: dict[int, dict[str, Any]] = {}
    while len(told) < count:  # again only where a worker did not fit
        numbers = [number for number in range(count) if number not in told]
        for done, answer in enumerate(queue.run([{**common, "brick": number} for number in numbers]), 1):
            if answer.error is not None:
                name = f"brick {numbers[answer.number]}"
                part_of_picture(answer, name, name)
            kept[numbers[answer.number]] = answer
            if progress is not None:
                progress(len(told) + done, count)
        for number, said in zip(numbers, queue.told([kept[number] for number in numbers])):
            if "mismatch" not in said:
                name = f"brick {number}"
                told[number] = part_of_picture(Answer(number, said), name, name)
    return kept, told


def _depths(
    connection: Connection, bricks: Bricks, last: Sequence[np.ndarray], common: dict[str, Any]
) -> list[np.ndarray]:
    """Depths in the bricks in which opacity reaches one half, nearer ones first."""
    places = list(bricks.in_front(last))
    found: dict[int, np.ndarray] = {}
    queue = TaskQueue(connection, worker.brick_depth, os.getcwd())
    for answer in queue.run([{**common, "brick": number, "data": in_front} for number, in_front in places]):
        name = f"brick {places[answer.number][0]}"
        found[answer.number] = part_of_picture(answer, name, name)["pixels"]
    return [found[number] for number in range(len(places))]
