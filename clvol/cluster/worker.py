"""What a worker of a cluster does: it checks that it fits, and then makes one frame or picture after the other.

All functions are called by dask with a request in JSON, on one thread, and read only files that the request names.
What has been loaded stays for the next request of its kind.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from clvol.batch.frames import FramesRun
from clvol.batch.job import Picture
from clvol.batch.run import JobRun, Options
from clvol.bricks.composite import put_together
from clvol.bricks.render import BricksRun
from clvol.cluster.facts import Digests, different_program
from clvol.errors import ClvolError, ClvolWarning, DeviceError
from clvol.json_values import plain
from clvol.opencl.devices import pin_threads
from clvol.render.some_tiles import TilesRun

_digests = Digests()
_checked: set[str] = set()  # requests' files that are those of the client
_resident: dict[str, Any] = {}  # what the last kind of request has loaded, by its key: one entry


def check(request: str) -> str:
    """Why this worker does not fit; "" if it does."""
    expected = json.loads(request)
    if reason := different_program(expected["facts"]):
        return reason
    cores = expected["cores"]
    if cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)
        os.environ.setdefault("POCL_MAX_PTHREAD_COUNT", str(len(cores)))
    pin_threads()
    return "" if os.path.isdir(expected["folder"]) else f"it has no folder {expected['folder']}"


def frame(request: str) -> dict[str, Any]:
    """Makes a frame of an animation (``clvol.cluster.frames``)."""

    def work(asked: dict[str, Any]) -> dict[str, Any]:
        run = _kept(asked["animation"], partial(FramesRun.from_request, asked["animation"]))
        return run.make(asked["frame"])

    return _answered(request, work)


def picture(request: str) -> dict[str, Any]:
    """Makes a picture of a job (``clvol.cluster.pictures``)."""

    def work(asked: dict[str, Any]) -> dict[str, Any]:
        run = _kept(asked["options"], lambda: JobRun([], Options(**asked["options"]), lambda result: None))
        described = asked["picture"]
        settings = tuple((key, value) for key, value in described["settings"])
        files = tuple(described["files"])
        return {"results": run.make(Picture(**{**described, "settings": settings, "files": files}))}

    return _answered(request, work)


def brick(request: str) -> dict[str, Any]:
    """Renders the partial picture of a brick (``clvol.cluster.bricks``): "pixels" as in ``PartialPicture``."""

    def work(asked: dict[str, Any]) -> dict[str, Any]:
        run = _kept(asked["scene"], lambda: BricksRun(**asked["scene"]))
        made = run.make(asked["brick"])
        return {"pixels": made.pixels, "samples": made.samples, "bytes": made.bytes}

    return _answered(request, work)


def brick_depth(request: str, in_front: np.ndarray) -> dict[str, Any]:
    """Finds depths in a brick behind what has the opacity ``in_front``: "pixels" float32 [height, width]."""

    def work(asked: dict[str, Any]) -> dict[str, Any]:
        run = _kept(asked["scene"], lambda: BricksRun(**asked["scene"]))
        return {"pixels": run.depth(asked["brick"], in_front)}

    return _answered(request, work)


def told_of(answer: dict[str, Any]) -> dict[str, Any]:
    """An answer without its pixels."""
    return {name: value for name, value in answer.items() if name != "pixels"}


def last_channel_of(answer: dict[str, Any]) -> np.ndarray:
    return np.ascontiguousarray(answer["pixels"][..., -1])


def rows_of(answer: dict[str, Any], top: int, bottom: int) -> np.ndarray:
    return np.ascontiguousarray(answer["pixels"][top:bottom])


def composited_rows(partial: list[np.ndarray]) -> np.ndarray:
    """The same rows of partial pictures, the nearest first, put together."""
    return put_together(partial, *partial[0].shape[:2])


def tiles(request: str) -> dict[str, Any]:
    """Renders a rectangle of a picture (``clvol.cluster.tiles``): "pixels" float32 [height, width, 4 or 5], the last
    channel the depth."""

    def work(asked: dict[str, Any]) -> dict[str, Any]:
        run = _kept(asked["scene"], lambda: TilesRun(**asked["scene"]))
        left, top, right, bottom = asked["rectangle"]
        made = run.make((left, top, right, bottom))
        pixels = made.rgba if made.depth is None else np.concatenate([made.rgba, made.depth[..., None]], axis=-1)
        return {"pixels": pixels, "samples": made.samples, "rays": made.rays, "counters": made.counters}

    return _answered(request, work)


def _kept(described: Any, make: Any) -> Any:
    """What ``make()`` has made before for what is ``described``, or makes now, after the last one was closed."""
    key = json.dumps(described, sort_keys=True)
    if key not in _resident:
        for other in _resident.values():
            other.close()
        _resident.clear()
        _resident[key] = make()
    return _resident[key]


def _answered(request: str, work: Any) -> dict[str, Any]:
    """The answer of ``work`` in the folder of the request; {"mismatch": reason} if this worker does not fit."""
    asked = json.loads(request)
    reason = different_program(asked["facts"]) or _different_files(asked)
    if reason:
        return {"mismatch": reason, "worker": _address()}
    told: list[list[str | None]] = []
    with _inside(asked["folder"]), _warnings_told(told):
        try:
            answer = work(asked)
        except DeviceError as error:
            return {"mismatch": str(error), "worker": _address(), "status": error.exit_status}
        except ClvolError as error:
            answer = {"error": str(error), "status": error.exit_status}
        except MemoryError:
            return {"mismatch": "it has no memory for the scene", "worker": _address()}
    pixels = answer.pop("pixels", None)
    return plain({**answer, "worker": _address(), "warnings": told}) | ({} if pixels is None else {"pixels": pixels})


def _different_files(asked: dict[str, Any]) -> str | None:
    if not os.path.isdir(asked["folder"]):
        return f"it has no folder {asked['folder']}"
    key = json.dumps(asked["inputs"], sort_keys=True)
    if key in _checked:
        return None
    with _inside(asked["folder"]):
        reason = _digests.difference(asked["inputs"])
    if reason is None:
        _checked.add(key)
    return reason


@contextmanager
def _inside(folder: str) -> Iterator[None]:
    """File names of the block are relative to ``folder``, as those of the client."""
    before = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


@contextmanager
def _warnings_told(told: list[list[str | None]]) -> Iterator[None]:
    """Adds (where, what, advice) of each warning of the block to ``told``."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ClvolWarning)
        yield
    for each in caught:
        if isinstance(message := each.message, ClvolWarning):
            told.append([message.where, message.what, message.advice])


def _address() -> str:
    from distributed import get_worker

    return str(get_worker().address)
