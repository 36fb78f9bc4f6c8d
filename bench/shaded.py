"""Shaded frames: clvol beside VTK's shaded CPU ray caster, and beside its own unshaded ones.

Per scene, size and light (one directional, one at the eye): seconds of a frame at step 1 with the
default Blinn-Phong material and the linear filter; VTK's gradients are precomputed, clvol's precomputed
too, and as it chooses by itself (for 8-bit volumes on the fly). VTK, clvol
shaded both ways and clvol unshaded take turns in one run; what is counted is as in bench/peers.py. clvol's
classification is what a user gets ("auto"), shaded and unshaded alike.
How far the two pictures lie apart is told to show that both draw the same; their shading differs
(see vtk_peer.py), so it is no error of either.
"""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np

from bench.curves import geometric_mean
from bench.effect_scenes import HEADLIGHT, LIGHT
from bench.options import DEFAULT, Options
from bench.peers import peer_threads
from bench.pictures import apart, save_side_by_side
from bench.report import load_average, machine, say, table
from bench.scenes import SCENES, BenchScene, available
from clvol.accuracy.timing import take_turns

SUMMARY = "shaded frames beside VTK's shaded CPU ray caster, and beside unshaded ones"
LIGHTS = {"directional": LIGHT, "headlight": HEADLIGHT}
STEP = 1.0
VTK_GOAL, OWN_GOAL = 3.0, 1.8
QUICK_SIZE, QUICK_FRAMES = 96, 3


def run(options: Options) -> dict[str, Any] | None:
    from bench.vtk_peer import vtk_version
    from clvol.opencl.devices import open_device

    version = vtk_version()
    if version is None:
        say("shaded: vtk is not installed (pip install vtk), so there is nothing to compare with")
        return None
    device = open_device(options.device)
    result: dict[str, Any] = {
        "machine": machine(device), "vtk": version, "threads": peer_threads(device),
        "quick": options.quick, "load_before": load_average(), "missing": [], "rows": [],
    }  # fmt: skip
    for scene in available(SCENES, options.scenes, result["missing"]):
        volume = scene.load()
        for size in (QUICK_SIZE,) if options.quick else options.sizes:
            for light in LIGHTS:
                row = _compare(scene, volume, size, light, device, result["threads"], options)
                say(f"{scene.name} {size} {light}: {row['vtk_ratio']:.2f}x VTK,"
                    f" {row['own_ratio']:.2f} of unshaded")
                result["rows"].append(row)
    result["load_after"] = load_average()
    return result if result["rows"] else None


def _compare(
    scene: BenchScene, volume, size: int, light: str, device: Any, threads: int, options: Options
) -> dict[str, Any]:
    from bench.vtk_peer import VtkPeer
    from clvol.render import Renderer

    integration = {"classification": options.classification or DEFAULT, "step": STEP}
    tables = {"light": [LIGHTS[light]], "gradient": {"storage": "precomputed"}}
    shaded = scene.scene(volume, size, tables, **integration)
    chosen = scene.scene(volume, size, {"light": [LIGHTS[light]]}, **integration)
    plain = scene.scene(volume, size, **integration)
    with contextlib.ExitStack() as stack:
        renderers = {
            "shaded": stack.enter_context(Renderer(shaded, [device])),
            "chosen": stack.enter_context(Renderer(chosen, [device])),
            "unshaded": stack.enter_context(Renderer(plain, [device])),
        }
        peer = stack.enter_context(contextlib.closing(VtkPeer(shaded.resolve(), threads)))
        peer.render(STEP)  # finds the gradients, once
        frames = {name: renderer.render(depth=False) for name, renderer in renderers.items()}
        rays = peer.ray_picture()
        peer.render_empty()
        mapper_seconds: list[float] = []

        def vtk_frame() -> float:
            wall, mapper = peer.render(STEP)
            mapper_seconds.append(mapper)
            return wall

        turns: dict[str, Any] = {"empty": peer.render_empty, "vtk": vtk_frame}
        for name, renderer in renderers.items():
            turns[name] = lambda r=renderer: r.render(depth=False).stats["seconds"]["render"]
        times = take_turns(
            turns, QUICK_FRAMES if options.quick else options.frames, never_slow=tuple(turns)
        )
    window = times["vtk"]["median"] - times["empty"]["median"]
    vtk = min(window, float(np.median(mapper_seconds)))
    own, unshaded = times["shaded"]["median"], times["unshaded"]["median"]
    save_side_by_side([rays, frames["shaded"].rgba, frames["unshaded"].rgba],
                      options.folder / "pictures" / f"shaded-{scene.name}-{light}-{size}.png")
    return {
        "scene": scene.name, "size": size, "light": light,
        "classification": integration["classification"],
        "vtk_seconds": vtk, "shaded_seconds": own, "unshaded_seconds": unshaded,
        "vtk_ratio": vtk / own, "own_ratio": own / unshaded, "times": times,
        "chosen_seconds": times["chosen"]["median"],
        "chosen_vtk_ratio": vtk / times["chosen"]["median"],
        "chosen_own_ratio": times["chosen"]["median"] / unshaded,
        "spread": max(times[name]["spread"] for name in ("vtk", *renderers)),
        "samples": {name: frame.stats["samples"] for name, frame in frames.items()},
        "counters": frames["shaded"].stats.get("counters", {}),
        "is_lit": not np.array_equal(frames["shaded"].rgba, frames["unshaded"].rgba),
        "apart": apart(rays, frames["shaded"].rgba),
    }  # fmt: skip


def show(result: dict[str, Any]) -> str:
    rows = result["rows"]
    head = ["scene", "size", "light", "clvol's", "VTK s", "precomputed s", "ratio", "as chosen s",
            "ratio", "unshaded s", "of unshaded", "as chosen", "spread", "samples lit", "apart"]
    cells = [[
        r["scene"], r["size"], r["light"], r["classification"], f"{r['vtk_seconds']:.4f}",
        f"{r['shaded_seconds']:.4f}", f"{r['vtk_ratio']:.2f}", f"{r['chosen_seconds']:.4f}",
        f"{r['chosen_vtk_ratio']:.2f}", f"{r['unshaded_seconds']:.4f}", f"{r['own_ratio']:.2f}",
        f"{r['chosen_own_ratio']:.2f}", f"{r['spread']:.0%}", _lit_share(r), f"{r['apart']['rmse']:.4f}",
    ] for r in rows]  # fmt: skip
    ratios, own = [r["vtk_ratio"] for r in rows], [r["own_ratio"] for r in rows]
    frames = min(t["frames"] for r in rows for t in r["times"].values())
    lines = [
        f"Step {STEP:g}, Blinn-Phong, linear filter, precomputed gradients; VTK {result['vtk']},"
        f" {result['threads']} threads. Ratio: VTK's seconds over clvol's.",
        table(head, cells, left=1),
        f"{_summary(ratios, own)}; {verdict(rows)}",
        "gradients as clvol chooses: " + _summary(
            [r["chosen_vtk_ratio"] for r in rows], [r["chosen_own_ratio"] for r in rows]
        ),
        f"medians of at least {frames} frames, taking turns; spread: interquartile range over"
        f" median, the largest of the three; load average {result['load_before']} to"
        f" {result['load_after']}, {result['machine']['cores']} cores",
    ]
    turned = [f"{r['scene']} {r['light']}" for r in rows if r["apart"]["best_flip"] != "none"]
    unlit = [f"{r['scene']} {r['light']}" for r in rows if not r["is_lit"]]
    if unlit:
        lines.append(f"NOT lit, so no result: {', '.join(unlit)}")
    if turned:
        lines.append(f"NOT the same way round as VTK's: {', '.join(turned)}")
    if result["missing"]:
        lines.append(f"left out, no volume: {', '.join(result['missing'])}")
    if result["quick"]:
        lines.append("This was a quick run at a small size: no figure of it is a result.")
    return "\n".join(lines)


def _summary(ratios: list[float], own: list[float]) -> str:
    return (f"VTK: least ratio {min(ratios):.2f} (goal {VTK_GOAL:g}), geometric mean"
            f" {geometric_mean(ratios):.2f}; of clvol's own unshaded time: largest {max(own):.2f}"
            f" (goal at most {OWN_GOAL:g})")


def verdict(rows: list[dict[str, Any]]) -> str:
    """Whether both goals are met by every row, or which rows meet which not."""
    missed = [
        f"{r['scene']} {r['size']} {r['light']} ({name})"
        for r in rows
        for name, is_met in (
            ("VTK", r["vtk_ratio"] >= VTK_GOAL), ("unshaded", r["own_ratio"] <= OWN_GOAL)
        )
        if not is_met
    ]  # fmt: skip
    return f"missed: {', '.join(missed)}" if missed else "both met everywhere"


def _lit_share(row: dict[str, Any]) -> str:
    lit, samples = row["counters"].get("lit_samples"), row["samples"]["shaded"]
    return "-" if lit is None or not samples else f"{lit / samples:.0%}"


def draw(result: dict[str, Any], options: Options) -> list:
    return []
