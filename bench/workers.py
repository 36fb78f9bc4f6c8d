"""Workers of a dask cluster: what two of them do beside one, measured, and up to a thousand, simulated.

Measured: two local workers of one core each beside one of one core, in turns: the frames of an animation, and the tiles
of one picture, from the first request to the last answer, with everything loaded and compiled. Then what the client and
the scheduler spend on a task that does nothing, and how fast pictures come back. Seconds of a processor are measured
beside those of the clock, since the machine is shared; what is simulated rests on the former.

Simulated, with these figures: weak scaling, a fixed number of tasks per worker for 1 to 1000 workers. Client and
scheduler serve one request at a time: they hand out a task, and take its answer with what it carries. Frames that
workers write carry nothing; tiles carry their pixels, and bricks a whole picture each, which the client composites.
"""

from __future__ import annotations

import heapq
import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bench.options import Options
from bench.report import load_average, machine, say, table

SUMMARY = "workers of a cluster: two measured, a thousand simulated"
WORKERS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
FRAMES, SIZE = 8, 1024
QUICK_FRAMES, QUICK_SIZE = 4, 64
ROUNDS, QUICK_ROUNDS = 3, 1
TASKS_PER_WORKER, IN_FLIGHT = 16, 2
NETWORK = 1.1e9  # bytes per second: ten gigabit
_EMPTY_TASKS, _MEGABYTES = 300, 16


def nothing(request: str) -> dict[str, Any]:
    """A task for a worker: answers at once, with the ``bytes`` that it is asked for."""
    size = json.loads(request)["bytes"]
    return {"pixels": np.zeros(size, np.uint8)} if size else {"nothing": True}


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    result: dict[str, Any] = {
        "machine": machine(open_device(options.device)), "load_before": load_average(), "quick": options.quick,
        "measured": [], "simulated": [],
    }  # fmt: skip
    before = os.getcwd()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        os.chdir(folder)
        stack.callback(os.chdir, before)
        _write_scene(options)
        cores = sorted(os.sched_getaffinity(0))
        one = stack.enter_context(_pinned([cores[:1]]))
        two = stack.enter_context(_pinned([cores[:1], cores[1:2] or cores[:1]]))
        for name, call in (("frames", _frames), ("tiles", _tiles)):
            row = {"name": name, **compared(lambda c, call=call: call(c, options), one, two, options)}  # type: ignore
            result["measured"].append(row)
            say(f"{name}: {row['speed_up']:.2f} times as fast")
        result["overhead"] = overhead(two)
    frames, tiles = result["measured"]
    costs = [row["processor"]["one"]["workers"] for row in (frames, tiles)]
    result["tasks"] = tasks_of(costs[0] / _frame_count(options), costs[1], options)
    for name, task in result["tasks"].items():
        for workers in WORKERS:
            found = weak_scaling(workers, **task, **result["overhead"])
            result["simulated"].append({"task": name, "workers": workers, "efficiency": found})
    result["load_after"] = load_average()
    return result


def _frame_count(options: Options) -> int:
    return QUICK_FRAMES if options.quick else FRAMES


def _write_scene(options: Options) -> None:
    """film.toml: a turn about a smooth field, so that frames cost about the same."""
    from bench.scaling import procedural_volume

    np.save("field.npy", procedural_volume(32 if options.quick else 192).data)
    Path("film.toml").write_text(
        'version = 1\n[volume]\nfile = "field.npy"\n[transfer_function]\nopacity_unit = 40.0\npoints = [\n'
        "{ value = 0.0, opacity = 0.2, color = [0.1, 0.2, 0.8] }, { value = 127.0, opacity = 0.5, color = [0.2, 0.8, "
        "0.3] },\n{ value = 255.0, opacity = 0.8, color = [1.0, 0.4, 0.1] } ]\n"
        f"[animation]\nframes = {_frame_count(options)}\norbit_degrees = 90\n",
        encoding="utf-8",
    )


@contextmanager
def _pinned(cores: list[list[int]]) -> Iterator[Any]:
    """A worker on each of ``cores``."""
    from clvol.cluster.connection import connected

    with connected(len(cores), None) as connection:
        connection.cores = cores
        yield connection


def _frames(connection: Any, options: Options) -> float:
    from clvol.batch.frames import Animation
    from clvol.cluster.frames import frames_on_workers

    size = QUICK_SIZE if options.quick else SIZE
    overrides = [f"image.width={size}", f"image.height={size}", "integration.step=0.5"]
    animation = Animation("film.toml", overrides, ["f_%04d.npy"])
    start = time.perf_counter()
    made = list(frames_on_workers(connection, animation, ["film.toml"], range(_frame_count(options))))
    assert not any(frame.error for frame in made)
    return time.perf_counter() - start


def _tiles(connection: Any, options: Options) -> float:
    from clvol.cluster.tiles import tiles_on_workers

    size = QUICK_SIZE if options.quick else SIZE
    overrides = ["animation.frames=1", f"image.width={size}", f"image.height={size}", "integration.step=0.125"]
    scene = {"path": "film.toml", "overrides": overrides, "devices": None, "memory_cap": None, "depth": False}
    start = time.perf_counter()
    tiles_on_workers(connection, scene, (size, size), ["film.toml"])
    return time.perf_counter() - start


def compared(call: Callable[[Any], float], one: Any, two: Any, options: Options) -> dict[str, Any]:
    """Seconds of one worker and of two, in turns: medians, and the ratio with its quartiles. ``processor``: the seconds
    of a processor that workers and client took. ``possible``: the ratio on two cores that do nothing else, if the one
    worker leaves the client a core, and two of them share theirs with it."""
    for connection in (one, two):
        call(connection)
    rounds: list[dict[str, tuple[float, float, float]]] = []
    for _ in range(QUICK_ROUNDS if options.quick else ROUNDS):
        rounds.append({"one": _timed(call, one), "two": _timed(call, two)})
    found = {
        name: [statistics.median(r[name][k] for r in rounds) for k in range(3)] for name in ("one", "two")
    }  # fmt: skip
    ratios = [r["one"][0] / r["two"][0] for r in rounds]
    return {
        "one": found["one"][0], "two": found["two"][0],
        "speed_up": statistics.median(ratios), "quartiles": [float(q) for q in np.percentile(ratios, [25, 75])],
        "processor": {name: {"workers": each[1], "client": each[2]} for name, each in found.items()},
        "possible": found["one"][1] / (0.5 * (found["two"][1] + found["two"][2])),
    }  # fmt: skip


def _timed(call: Callable[[Any], float], connection: Any) -> tuple[float, float, float]:
    """Seconds on the clock, and of a processor: of the workers, and of this process, which is client and scheduler."""
    import psutil

    workers = [psutil.Process(pid) for pid in connection.client.run(os.getpid).values()]

    def processor() -> float:
        return sum(sum(each.cpu_times()[:2]) for each in workers)

    before, own = processor(), time.process_time()
    seconds = call(connection)
    return seconds, processor() - before, time.process_time() - own


def overhead(connection: Any) -> dict[str, float]:
    """``serial``: seconds of a processor that client and scheduler take per task, from many tasks that do nothing;
    ``byte``: and per byte of an answer."""
    from clvol.cluster.queue import TaskQueue

    def seconds(count: int, size: int) -> float:
        queue = TaskQueue(connection, nothing, os.getcwd())
        start = time.process_time()
        assert len(list(queue.run([{"bytes": size}] * count))) == count
        return time.process_time() - start

    seconds(20, 0)
    few, many = seconds(20, 0), seconds(20 + _EMPTY_TASKS, 0)
    per_task = (many - few) / _EMPTY_TASKS
    size = _MEGABYTES << 20
    large = (seconds(12, size) - seconds(2, size)) / 10
    return {"serial": per_task, "byte": max(large - per_task, 0.0) / size}


def tasks_of(frame: float, picture: float, options: Options) -> dict[str, dict[str, float]]:
    """Seconds, and bytes of the answer, of a frame of ``frame`` seconds; of a sixth of a picture of ``picture``
    seconds; of a brick whose partial picture takes as long as the frame; and of a frame of ten seconds."""
    size = QUICK_SIZE if options.quick else SIZE
    return {
        "frames": {"cost": frame, "bytes": 0.0},
        "frames of 10 s": {"cost": 10.0, "bytes": 0.0},
        "tiles": {"cost": picture / 6, "bytes": size * size * 16 / 6},
        "bricks": {"cost": frame, "bytes": float((QUICK_SIZE if options.quick else SIZE) ** 2 * 16)},
    }


def weak_scaling(workers: int, cost: float, bytes: float, serial: float, byte: float) -> float:
    """Efficiency of ``workers`` with TASKS_PER_WORKER tasks each: ideal time over time. A task takes ``cost`` seconds
    of a worker, and half of ``serial`` to be handed out; its answer takes the other half, and the time of its
    ``bytes``: of copies (``byte``) and of a network."""
    hand_out, take = 0.5 * serial, 0.5 * serial + bytes * (byte + 1 / NETWORK)
    tasks = TASKS_PER_WORKER * workers
    left, served, done = tasks, 0.0, 0
    free = [0.0] * workers
    events = [(0.0, k % 2, k // 2, False) for k in range(IN_FLIGHT * workers)]  # when, turn, worker, whether an answer
    heapq.heapify(events)
    while events:
        when, turn, worker, is_answer = heapq.heappop(events)
        begin = max(when, served)
        if is_answer:
            served, done = begin + take, done + 1
            heapq.heappush(events, (served, turn, worker, False))
        elif left:
            left -= 1
            served = begin + hand_out
            free[worker] = max(free[worker], served) + cost
            heapq.heappush(events, (free[worker], turn, worker, True))
    assert done == tasks
    return TASKS_PER_WORKER * cost / served


def bend(rows: list[dict[str, Any]], task: str) -> int | None:
    """The most workers of which ``task`` still uses four fifths."""
    good = [row["workers"] for row in rows if row["task"] == task and row["efficiency"] >= 0.8]
    return max(good, default=None)


def show(result: dict[str, Any]) -> str:
    lines = [table(
        ["what", "one worker, s", "two, s", "times as fast", "quartiles", "processor: one, two, client", "possible"],
        [
            [r["name"], f"{r['one']:.2f}", f"{r['two']:.2f}", f"{r['speed_up']:.2f}",
             "{:.2f} to {:.2f}".format(*r["quartiles"]),
             f"{r['processor']['one']['workers']:.2f}, {r['processor']['two']['workers']:.2f}, "
             f"{r['processor']['two']['client']:.2f}", f"{r['possible']:.2f}"]
            for r in result["measured"]
        ],
    )]  # fmt: skip
    serial, byte = result["overhead"]["serial"], result["overhead"]["byte"]
    lines.append(f"client and scheduler: {1e3 * serial:.2f} ms per task, {1e-6 / max(byte, 1e-15):.0f} MB/s of answers")
    rows = []
    for name, task in result["tasks"].items():
        found = {r["workers"]: r["efficiency"] for r in result["simulated"] if r["task"] == name}
        most = 1 / (serial + task["bytes"] * (byte + 1 / NETWORK)) * task["cost"]
        rows.append([name, f"{task['cost']:.3f}", f"{task['bytes'] / 1e6:.1f}", f"{most:.0f}",
                     *(f"{found[n]:.2f}" for n in WORKERS)])  # fmt: skip
    lines.append(table(["simulated: task", "s", "MB", "bends at", *map(str, WORKERS)], rows))
    lines.append(f"load average {result['load_before']} to {result['load_after']}")
    return "\n".join(lines)


def draw(result: dict[str, Any], options: Options) -> list:
    """Efficiency over the number of workers."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for name, task in result["tasks"].items():
        values = [r["efficiency"] for r in result["simulated"] if r["task"] == name]
        carried = f", {task['bytes'] / 1e6:.1f} MB" if task["bytes"] else ""
        axis.plot(WORKERS, values, marker="o", label=f"{name} ({task['cost']:.2f} s{carried})")
    axis.set_xscale("log")
    axis.set_xticks(WORKERS, list(map(str, WORKERS)))
    axis.minorticks_off()
    axis.set_ylim(0, 1.05)
    axis.set_xlabel("workers")
    axis.set_ylabel("efficiency")
    axis.set_title(f"Weak scaling, simulated: {1e3 * result['overhead']['serial']:.1f} ms per task, 10 Gbit/s")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=9)
    path = options.folder / "workers.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return [path]
