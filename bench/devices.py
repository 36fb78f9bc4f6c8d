"""Several devices: how well they share pictures, measured on parts of this machine's processor, and simulated with the
measured costs of tiles for fleets of any size.

Measured: two halves of a device beside the whole one at 1024². A device of one unit (POCL_MAX_PTHREAD_COUNT=1) is
measured together with a part of another runtime of the processor instead; parts of PoCL's device (3.1) use all of its
threads, and would take that runtime's core. Efficiency: the ideal time, if devices worked at the speeds that they have
alone and ended together, over the time of the frame.

Simulated: 2 to 64 devices whose speeds differ by up to 1 : 20, with launches that cost 0.2 % and 1 % of a frame; the
first frame, divided by the visible cells before each tile, and the tenth of a turn by 1° per frame, divided by what the
ninth cost. Fleets of more than 16 devices have tiles of 8² pixels.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.options import Options
from bench.report import load_average, machine, say, table
from bench.scenes import SCENES, available
from clvol.schedule.dispatch import Dispatcher
from clvol.schedule.virtual import Simulated, simulate

SUMMARY = "several devices: efficiency, measured and simulated"
SIZE, QUICK_SIZE = 1024, 96
FLEETS, RATIOS, LAUNCHES = (2, 4, 16, 64), (1, 4, 20), (0.002, 0.01)
QUICK_FLEETS = (2, 4)
GOALS = {0.002: 0.97, 0.01: 0.93}
_MANY = 16  # devices up to which tiles have 16^2 pixels


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    size = QUICK_SIZE if options.quick else SIZE
    device = open_device(options.device)
    result: dict[str, Any] = {
        "machine": machine(device), "load_before": load_average(), "quick": options.quick, "size": size,
        "missing": [],
        "measured": [], "simulated": [],
    }  # fmt: skip
    missing: list[str] = result["missing"]
    for bench_scene in available(SCENES, options.scenes, missing):
        volume = bench_scene.load()
        scene = bench_scene.scene(volume, size)
        for row in measured(scene, 3 if options.quick else options.frames, options.device):
            result["measured"].append({"scene": bench_scene.name, **row})
            say(f"{bench_scene.name}, {' + '.join(row['devices'])}: efficiency {row['efficiency']:.3f}")
        costs = {tile: tile_costs(scene, device, tile) for tile in (16, 8)}
        for row in simulated(costs, QUICK_FLEETS if options.quick else FLEETS):
            result["simulated"].append({"scene": bench_scene.name, **row})
        if "chart" not in result:
            result["chart"] = {"scene": bench_scene.name, **gantt(costs[16])}
        say(f"{bench_scene.name}: simulated")
    result["load_after"] = load_average()
    return result if result["simulated"] else None


# ---- measured


def measured(scene: Any, frames: int, name: str | None) -> Iterator[dict[str, Any]]:
    """A row of halves of one device, or of one of a single unit and a part of another runtime of the processor."""
    from clvol.opencl.devices import by_processor, list_devices, select

    first = select(list_devices(), name)[0]
    if first.compute_units > 1:
        yield _row(scene, [f"{first.name}:{k}/2" for k in (1, 2)], [[first.name]], frames)
        return
    others = next((same for same in by_processor(list_devices()) if first in same), [])
    for other in others:
        if other != first and other.compute_units > 1:
            mixed = [first.name, f"{other.name}:2/2"]
            yield _row(scene, mixed, [[each] for each in mixed], frames)


def _row(scene: Any, devices: list[str], alone: list[list[str]], frames: int) -> dict[str, Any]:
    """``devices`` together beside each of ``alone``, in turns: medians of seconds."""
    from contextlib import ExitStack

    from clvol import Renderer

    with ExitStack() as stack:
        renderers = [stack.enter_context(Renderer(scene, devices=each)) for each in [devices, *alone]]
        for renderer in renderers:
            for _ in range(2):
                renderer.render()
        seconds: list[list[float]] = [[] for _ in renderers]
        ratios, reported = [], []
        for _ in range(frames):
            for renderer, found in zip(renderers, seconds):
                frame = renderer.render()
                found.append(frame.stats["seconds"]["render"])
                if "schedule" in frame.stats:
                    reported.append(frame.stats["schedule"]["efficiency"])
            together, *each = (found[-1] for found in seconds)
            ratios.append(1 / sum(1 / one for one in each) / together)
    return {
        "devices": devices, "efficiency": statistics.median(ratios),
        "quartiles": [float(q) for q in np.percentile(ratios, [25, 75])],
        "seconds": [statistics.median(found) for found in seconds],
        "reported": statistics.median(reported) if reported else None,
    }  # fmt: skip


# ---- simulated


def tile_costs(scene: Any, device: Any, tile: int, frames: int = 10) -> dict[str, np.ndarray]:
    """Costs of tiles: "expected" before the first frame, "first", "ninth" and "tenth" of a turn by 1° per frame."""
    from clvol.integrators.base import PictureArrays
    from clvol.integrators.raycast.caster import Raycaster
    from clvol.opencl.context import DeviceContext
    from clvol.schedule.animation import orbited

    resolved = scene.resolve()
    context = DeviceContext(device)
    caster = Raycaster(context, resolved, tile=(tile, tile))
    width, height = resolved.image.width, resolved.image.height
    arrays = [PictureArrays(np.empty((height, width, 4), np.float32), None)]
    found = {}
    for name, number in (("first", 0), ("ninth", frames - 2), ("tenth", frames - 1)):
        parts = caster.parts(orbited(resolved.camera, float(number)), width, height, depth=False)
        assert parts is not None
        if number == 0:
            found["expected"] = parts.expected_costs(0)
        parts.begin(0, arrays)
        found[name] = parts.render(0, np.arange(parts.stages[0])).costs
    context.release()
    return found


def simulated(costs: dict[int, dict[str, np.ndarray]], fleets: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    for devices in fleets:
        of = costs[16 if devices <= _MANY else 8]
        for ratio in RATIOS:
            for launch in LAUNCHES:
                first = fleet(of["expected"], of["first"], devices, ratio, launch, measured=False)
                tenth = fleet(of["ninth"], of["tenth"], devices, ratio, launch, measured=True)
                yield {
                    "devices": devices, "ratio": ratio, "launch": launch,
                    "first": first.efficiency, "tenth": tenth.efficiency,
                    "packages": [len(first.spans) / devices, len(tenth.spans) / devices],
                }  # fmt: skip


def fleet(
    expected: np.ndarray, costs: np.ndarray, devices: int, ratio: float, launch: float, *, measured: bool
) -> Simulated:
    """A frame of ``devices`` with speeds from 1 to ``ratio``, which ideally takes a second."""
    speeds = np.geomspace(1, ratio, devices)
    speeds = (speeds / speeds.sum() * costs.sum()).tolist()
    launches = [launch] * devices
    scaled = expected * (costs.sum() / expected.sum())
    columns = math.isqrt(len(costs))
    dispatcher = Dispatcher(scaled, speeds, launches, measured=measured, columns=columns)
    return simulate(dispatcher, costs, speeds, launches)


def gantt(costs: dict[str, np.ndarray], devices: int = 4, ratio: float = 4, launch: float = 0.01) -> dict[str, Any]:
    """The first frame of a small fleet: (device, begin, end) of its packages."""
    found = fleet(costs["expected"], costs["first"], devices, ratio, launch, measured=False)
    spans = [(package.device, begin, end) for package, begin, end in found.spans]
    return {"spans": spans, "speeds": np.geomspace(1, ratio, devices).tolist(), "efficiency": found.efficiency}


# ---- report


def show(result: dict[str, Any]) -> str:
    lines = []
    if result["measured"]:
        rows = [
            [
                row["scene"], " + ".join(row["devices"]), f"{row['efficiency']:.3f}",
                "{:.3f} to {:.3f}".format(*row["quartiles"]), " / ".join(f"{1e3 * s:.0f}" for s in row["seconds"]),
            ]
            for row in result["measured"]
        ]  # fmt: skip
        lines.append(table(["scene", "devices", "efficiency", "quartiles", "ms together / alone"], rows, left=2))
    rows = []
    for launch in LAUNCHES:
        for devices in sorted({row["devices"] for row in result["simulated"]}):
            cells = [f"{100 * launch:g} %", str(devices)]
            for ratio in RATIOS:
                same = [
                    row for row in result["simulated"]
                    if (row["launch"], row["devices"], row["ratio"]) == (launch, devices, ratio)
                ]  # fmt: skip
                for frame in ("first", "tenth"):
                    values = [row[frame] for row in same]
                    cells.append(f"{statistics.mean(values):.3f} ({min(values):.3f})")
            rows.append(cells)
    heads = [f"1 : {ratio}, {frame}" for ratio in RATIOS for frame in ("first", "tenth")]
    lines.append("Simulated: mean efficiency over the scenes (least).\n" + table(["launch", "devices", *heads], rows))
    return "\n\n".join(lines)


def draw(result: dict[str, Any], options: Options) -> list:
    """Efficiency over devices, and a frame of four devices over time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=[1, 1.4])
    fleets = sorted({row["devices"] for row in result["simulated"]})
    for frame, style in (("first", "--"), ("tenth", "-")):
        for launch, color in zip(LAUNCHES, ("tab:blue", "tab:orange")):
            values = [
                [r[frame] for r in result["simulated"] if r["devices"] == n and r["launch"] == launch] for n in fleets
            ]
            left.plot(fleets, [statistics.mean(v) for v in values], style, color=color, marker="o",
                      label=f"{frame} frame, launch {100 * launch:g} %")  # fmt: skip
            left.fill_between(fleets, [min(v) for v in values], [max(v) for v in values], color=color, alpha=0.1)
    left.set_xscale("log", base=2)
    left.set_xticks(fleets, [str(n) for n in fleets])
    left.set(xlabel="devices", ylabel="efficiency", title="simulated, speeds 1 : 1 to 1 : 20", ylim=(None, 1))
    left.legend(fontsize=8, loc="lower left")
    chart = result["chart"]
    for device, begin, end in chart["spans"]:
        right.barh(device, end - begin, left=begin, height=0.7, color=f"C{device}", edgecolor="black", linewidth=0.5)
    count = len(chart["speeds"])
    right.set_yticks(range(count), [f"speed {speed:.1f}" for speed in chart["speeds"]])
    right.set_ylim(count - 0.5, -0.5)
    right.set(xlabel="time, ideally 1", title=f"first frame of {chart['scene']}, efficiency {chart['efficiency']:.3f}")
    path = options.folder / "devices.png"
    figure.savefig(path, metadata={"Software": "clvol"})
    return [path]
