"""Opaque iso-surfaces: clvol beside VTK's ray-cast iso-surface mode.

The engine at two values, one directional light, step 1, nothing but the surface: clvol's transfer
function is transparent. VTK has this mode in OpenGL alone; on a machine without a GPU its OpenGL is
llvmpipe, on the same cores, and the result names it and its threads.

What is counted
  clvol  frame.stats["seconds"]["render"]: kernels and the transfer of the picture to the host
  VTK    Render() until OpenGL has finished, less that of an empty window; no transfer
Both take turns in one run. VTK shades a surface at the first sample behind it, clvol at the
crossing, found to 1e-4 of a voxel: the pictures are alike and not the same.
"""

from __future__ import annotations

import contextlib
import os
from typing import Any

from bench.effect_scenes import LIGHT
from bench.options import Options
from bench.peers import peer_threads
from bench.pictures import apart, save_side_by_side
from bench.report import load_average, machine, say, table
from bench.scenes import SCENES, BenchScene, available
from clvol.accuracy.timing import take_turns

SUMMARY = "opaque iso-surfaces beside VTK's ray-cast iso-surface mode"
SCENE, VALUES, SIZE, STEP = "engine-smooth", (80.0, 160.0), 512, 1.0
GOAL = 5.0
MOST_APART = 0.02  # share of the covered pixels that only one covers: outlines, a pixel wide
QUICK_SIZE, QUICK_FRAMES = 96, 3


def run(options: Options) -> dict[str, Any] | None:
    from bench.vtk_peer import vtk_version
    from clvol.opencl.devices import open_device

    version = vtk_version()
    if version is None:
        say("isosurface: vtk is not installed (pip install vtk): nothing to compare with")
        return None
    device = open_device(options.device)
    # Read when the first window opens; llvmpipe's own default is all cores.
    os.environ.setdefault("LP_NUM_THREADS", str(peer_threads(device)))
    result: dict[str, Any] = {
        "machine": machine(device), "vtk": version, "quick": options.quick,
        "load_before": load_average(), "missing": [], "rows": [],
    }  # fmt: skip
    for scene in available([s for s in SCENES if s.name == SCENE], (), result["missing"]):
        volume = scene.load()
        for value in VALUES:
            row = _compare(scene, volume, value, device, options)
            say(f"{scene.file} at {value:g}: VTK {row['vtk_seconds']:.4f} s,"
                f" clvol {row['seconds']:.4f} s, {row['ratio']:.2f}x")
            result["rows"].append(row)
    result["load_after"] = load_average()
    return result if result["rows"] else None


def surface_tables(scene: BenchScene, value: float) -> dict[str, Any]:
    """An opaque surface at ``value``, lit, in a volume that is otherwise transparent."""
    points = [
        {"value": float(at), "opacity": 0.0, "color": list(color)} for at, _, color in scene.points
    ]
    return {
        "transfer_function": {"points": points},
        "light": [LIGHT],
        "isosurface": [{"value": value, "opacity": 1.0, "color": [0.8, 0.8, 0.75]}],
    }


def _compare(
    scene: BenchScene, volume, value: float, device: Any, options: Options
) -> dict[str, Any]:
    from bench.vtk_peer import VtkIsosurface
    from clvol.render import Renderer

    size = QUICK_SIZE if options.quick else SIZE
    asked = scene.scene(volume, size, surface_tables(scene, value), step=STEP,
                        classification=scene.classification)
    with contextlib.ExitStack() as stack:
        renderer = stack.enter_context(Renderer(asked, [device]))
        peer = stack.enter_context(contextlib.closing(VtkIsosurface(asked.resolve())))
        peer.render(STEP)
        picture, opengl = peer.window_picture(), peer.opengl()
        frame = renderer.render(depth=False)
        peer.render_empty()
        turns = {
            "empty": peer.render_empty,
            "vtk": lambda: peer.render(STEP),
            "clvol": lambda: renderer.render(depth=False).stats["seconds"]["render"],
        }
        times = take_turns(
            turns, QUICK_FRAMES if options.quick else options.frames, never_slow=tuple(turns)
        )
    vtk, own = times["vtk"]["median"] - times["empty"]["median"], times["clvol"]["median"]
    save_side_by_side([picture, frame.rgba],
                      options.folder / "pictures" / f"isosurface-{value:g}-{size}.png")
    return {
        "volume": scene.file, "value": value, "size": size, "opengl": opengl,
        "vtk_seconds": vtk, "seconds": own, "ratio": vtk / own, "times": times,
        "samples": frame.stats["samples"], "counters": frame.stats.get("counters", {}),
        "apart": apart(picture, frame.rgba),
    }  # fmt: skip


def show(result: dict[str, Any]) -> str:
    rows = result["rows"]
    cells = [[
        r["volume"], r["size"], f"{r['value']:g}", f"{r['vtk_seconds']:.4f}",
        f"{r['times']['vtk']['spread']:.0%}", f"{r['seconds']:.4f}",
        f"{r['times']['clvol']['spread']:.0%}", f"{r['ratio']:.2f}", f"{r['samples'] / 1e6:.2f}",
        f"{r['apart']['rmse']:.4f}", f"{r['apart']['outline']:.2%}",
    ] for r in rows]  # fmt: skip
    head = ["volume", "size", "value", "VTK s", "spread", "clvol s", "spread", "ratio",
            "million samples", "apart", "outline"]
    opengl = rows[0]["opengl"]
    threads = f", {opengl['threads']} threads" if opengl["threads"] else ""
    least = min(r["ratio"] for r in rows)
    lines = [
        f"Opaque surface, one light, step {STEP:g}; VTK {result['vtk']} in OpenGL"
        f" {opengl['version']} on {opengl['renderer']}{threads}.",
        table(head, cells),
        f"least ratio {least:.2f} (goal {GOAL:g}): {verdict(rows)}",
        f"medians of {min(t['frames'] for r in rows for t in r['times'].values())} frames, taking"
        f" turns; load average {result['load_before']} to {result['load_after']}",
        "apart: RMSE of one picture against the other; outline: share of the covered pixels that"
        " only one covers",
    ]
    if result["quick"]:
        lines.append("This was a quick run at a small size: no figure of it is a result.")
    return "\n".join(lines)


def verdict(rows: list[dict[str, Any]]) -> str:
    """Whether the goal is met; it is not by pictures of different surfaces."""
    unlike = [
        f"{r['value']:g}"
        for r in rows
        if r["apart"]["outline"] > MOST_APART or r["apart"]["best_flip"] != "none"
    ]
    if unlike:
        return f"NOT the same surface as VTK's at {', '.join(unlike)}, so no result"
    return "met" if all(r["ratio"] >= GOAL for r in rows) else "NOT met"


def draw(result: dict[str, Any], options: Options) -> list:
    return []
