"""What accuracy costs in time: every scene's sweep over its knobs, and VTK's own curve beside it.

clvol's curve is the Pareto front that `clvol tradeoff` finds; its page for each scene is kept among the results. VTK's
knob is its sample distance; its seconds are the smaller of its window's (less an empty one's) and its mapper's own,
as in bench/peers.py, and its errors those of its rays against the same exact integral over all pixels.
"""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Any

import numpy as np

from bench.curves import lower_envelope, reach
from bench.options import Options
from bench.peers import peer_threads
from bench.report import load_average, machine, say, table
from bench.scenes import CHEST, DATA, SCENES, BenchScene, available
from clvol.accuracy.timing import take_turns

SUMMARY = "error against time over all knobs, and VTK's curve beside it"
VTK_STEPS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.1)
SIZE, SETTINGS = 512, 160
QUICK = {"size": 96, "settings": 12, "frames": 1, "vtk": (2.0, 0.5)}
ERRORS = (3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5)


def run(options: Options) -> dict[str, Any] | None:
    from bench.vtk_peer import vtk_version
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    result: dict[str, Any] = {
        "machine": machine(device), "vtk": vtk_version(), "threads": peer_threads(device),
        "quick": options.quick, "load_before": load_average(), "missing": [], "scenes": [],
    }  # fmt: skip
    for scene in available((*SCENES, CHEST), options.scenes, result["missing"]):
        result["scenes"].append(_sweep(scene, scene.load(), device, options))
    if not options.scenes or "demo" in options.scenes:
        result["scenes"].append(_demo(device, options))
    result["load_after"] = load_average()
    return result if result["scenes"] else None


def _sweep(scene: BenchScene, volume, device: Any, options: Options) -> dict[str, Any]:
    size = QUICK["size"] if options.quick else SIZE
    asked = scene.scene(volume, size, classification=scene.classification)
    measured, exact = _tradeoff(asked, scene.name, device, options)
    measured["vtk"] = _vtk(asked.resolve(), exact, device, options)
    if measured["vtk"]:
        measured["ratios"] = ratios(measured["front"], measured["vtk"])
    return measured


def _demo(device: Any, options: Options) -> dict[str, Any]:
    """The scene that is shipped; it has an origin, which the peer does not take."""
    from clvol import load_scene

    overrides = ("image.width=96", "image.height=96") if options.quick else ()
    asked = load_scene(str(DATA / "demo.toml"), overrides)
    return _tradeoff(asked, "demo", device, options)[0] | {"vtk": []}


def _tradeoff(asked, name: str, device: Any, options: Options) -> tuple[dict[str, Any], np.ndarray]:
    from clvol.accuracy.report import write_report
    from clvol.accuracy.tradeoff import measure_tradeoff

    begun = time.perf_counter()
    frames = QUICK["frames"] if options.quick else options.frames
    settings = QUICK["settings"] if options.quick else SETTINGS
    found, pictures = measure_tradeoff(asked, devices=[device], frames=frames, settings=settings)
    found["scene"]["name"] = name
    page = write_report(found, pictures, _folder(options) / name)[0]
    points = {point["id"]: point for point in found["points"]}
    front = [points[key] for key in found["front"]]
    say(f"{name}: {len(points)} settings, {time.perf_counter() - begun:.0f} s: {page}")
    return {
        "scene": name,
        "size": found["scene"]["width"],
        "front": [
            {"label": p["label"], "settings": p["settings"], "rmse": p["rmse"],
             "seconds": p["seconds"]["median"], "spread": p["seconds"]["spread"]}
            for p in front
        ],
        "baseline": points[found["baseline"]],
        "all": [(p["seconds"]["median"], p["rmse"]) for p in found["points"]],
        "sentences": [s["text"] for s in found["sentences"]],
    }, pictures["reference"]  # fmt: skip


def _vtk(resolved, exact: np.ndarray, device: Any, options: Options) -> list[dict[str, Any]]:
    from bench.vtk_peer import VtkPeer, vtk_version

    if vtk_version() is None:
        return []
    steps = QUICK["vtk"] if options.quick else VTK_STEPS
    with contextlib.closing(VtkPeer(resolved, peer_threads(device))) as peer:
        points, mapper = [], {step: [] for step in steps}
        for step in steps:
            peer.render(step)
            rmse = float(np.sqrt(np.mean((peer.ray_picture() - exact) ** 2)))
            points.append({"step": step, "rmse": rmse})

        def frame(step: float) -> float:
            wall, own = peer.render(step)
            mapper[step].append(own)
            return wall

        peer.render_empty()
        turns: dict[Any, Any] = {"empty": peer.render_empty}
        turns |= {step: lambda step=step: frame(step) for step in steps}
        times = take_turns(turns, QUICK["frames"] if options.quick else options.frames)
        for point in points:
            window = times[point["step"]]["median"] - times["empty"]["median"]
            point["seconds"] = min(window, float(np.median(mapper[point["step"]])))
            point["spread"] = times[point["step"]]["spread"]
    return points


def ratios(front: list[dict], vtk: list[dict]) -> list[dict[str, Any]]:
    """How many times as long VTK takes, at the error of each of its own points that is worth its time."""
    curve = [(p["seconds"], p["rmse"]) for p in front]
    found = []
    for seconds, error in lower_envelope([(p["seconds"], p["rmse"]) for p in vtk]):
        ours = reach(curve, error)
        ratio = seconds / ours.seconds if ours.seconds else None
        found.append({"rmse": error, "vtk_seconds": seconds, "clvol_seconds": ours.seconds,
                      "kind": ours.kind, "ratio": ratio})  # fmt: skip
    return found


def show(result: dict[str, Any]) -> str:
    lines = ["Seconds of a frame for an error (RMSE of linear RGBA), as cheaply as the sweep found:"]
    rows = []
    for s in result["scenes"]:
        curve = [(p["seconds"], p["rmse"]) for p in s["front"]]
        rows.append([s["scene"], s["size"], *(_seconds(reach(curve, e)) for e in ERRORS)])
    lines += [table(["scene", "size", *(f"{e:g}" for e in ERRORS)], rows), ""]
    for s in result["scenes"]:
        lines.append(f"{s['scene']}:")
        lines += [
            f"  {p['rmse']:.2e}  {p['seconds']:.4f} s  {p['label']}" for p in s["front"]
        ]
    compared = [s for s in result["scenes"] if s.get("ratios")]
    if compared:
        lines += ["", "VTK's curve: at the error of each of its points, its seconds over clvol's"]
        lines.append(table(
            ["scene", "VTK's errors", "ratios", "least"],
            [[s["scene"], " ".join(f"{r['rmse']:.2g}" for r in s["ratios"]),
              " ".join(_times(r) for r in s["ratios"]),
              f"{min((r['ratio'] or 0.0) for r in s['ratios']):.2f}"] for s in compared],
        ))  # fmt: skip
        below = all(r["ratio"] and r["ratio"] > 1 for s in compared for r in s["ratios"])
        lines.append("clvol's curve lies " + ("below VTK's at every error" if below
                                               else "NOT below VTK's at every error"))
    lines.append(f"load average {result['load_before']} to {result['load_after']}")
    if result["quick"]:
        lines.append("This was a quick run at a small size: no figure of it is a result.")
    return "\n".join(lines)


def _seconds(found) -> str:
    if found.seconds is None:
        return f"> ({found.least_error:.1e})"
    return ("<=" if found.kind == "at most" else "") + f"{found.seconds:.4f}"


def _times(found: dict[str, Any]) -> str:
    if found["ratio"] is None:
        return "not reached"
    return (">=" if found["kind"] == "at most" else "") + f"{found['ratio']:.1f}"


def draw(result: dict[str, Any], options: Options) -> list:
    from bench.charts import tradeoff_chart

    committed = Path(__file__).resolve().parent / "tradeoff.png"
    path = options.folder / "tradeoff.png" if options.quick or options.scenes else committed
    return [tradeoff_chart(result, path)]


def _folder(options: Options) -> Path:
    return options.folder / "tradeoff"
