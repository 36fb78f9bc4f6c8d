"""The same scenes with VTK's CPU ray caster and with clvol, in one run, frame by frame in turns.

Per scene and size: seconds of a frame at step 1, error of the picture, and the time that each needs
for the other's error, from curves of error against time over several steps.

What is counted
  clvol  frame.stats["seconds"]["render"]: kernels and the transfer of the picture to the host
  VTK    the smaller of two medians: the window's Render() less that of an empty window, and the
         mapper's own TimeToDraw (rays and drawing into the window)
Both have as many threads: the OpenCL device's compute units if it is a CPU, else all cores.
Errors are RMSE over pixels and RGBA, linear and premultiplied, against the exact integral. VTK has
two pictures (see vtk_peer.py), and so two errors: that of its rays, which counts as VTK's error
unless said otherwise, and that of its window. The goals are held against both.
"""

from __future__ import annotations

import contextlib
import os
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.curves import geometric_mean, reach
from bench.options import DEFAULT, Options
from bench.pictures import save_side_by_side
from bench.report import load_average, machine, say, table
from bench.scenes import SCENES, BenchScene, available
from clvol.accuracy.timing import take_turns

if TYPE_CHECKING:
    from clvol.scene.resolve import ResolvedScene

SUMMARY = "seconds and error beside VTK's CPU ray caster, five scenes"
VTK_STEPS = (2.0, 1.0, 0.5, 0.25, 0.1)
CLVOL_STEPS = (16.0, 8.0, 4.0, 3.0, 2.0, 1.5, 1.0, 0.5, 0.25, 0.125)
WHOLE_SIZE = 512  # pictures up to this size are compared whole, larger ones at random pixels
RANDOM_PIXELS = 32768
QUICK = {"sizes": (128,), "vtk": (1.0, 0.5, 0.25), "clvol": (8.0, 4.0, 2.0, 1.0, 0.5), "frames": 3}
FASTER_GOAL, MEAN_GOAL = 4.0, 6.0  # at the same step; the mean at 512^2, at 1024^2 it is 7
SAME_ERROR_GOAL, SAME_ERROR_MEAN_GOAL = 7.0, 10.0


def run(options: Options) -> dict[str, Any] | None:
    from bench.vtk_peer import vtk_version

    version = vtk_version()
    if version is None:
        say("peers: vtk is not installed (pip install vtk), so there is nothing to compare with")
        return None
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    threads = peer_threads(device)
    result: dict[str, Any] = {
        "machine": machine(device),
        "vtk": version,
        "threads": threads,
        "classification": options.classification or DEFAULT,
        "load_before": load_average(),
        "quick": options.quick,
        "missing": [],
        "scenes": [],
    }
    say(f"VTK {version} with {threads} threads, clvol on {device.name.strip()}"
        f" ({device.max_compute_units} compute units), load average {result['load_before']}")
    for scene in available(SCENES, options.scenes, result["missing"]):
        volume = scene.load()
        for size in QUICK["sizes"] if options.quick else options.sizes:
            result["scenes"].append(_compare(scene, volume, size, device, threads, options))
    result["load_after"] = load_average()
    if not result["scenes"]:
        say("peers: no scene could be measured")
        return None
    result["overall"] = overall([s["headline"] for s in result["scenes"]])
    result["overall_window"] = overall([s["headline_window"] for s in result["scenes"]])
    return result


def peer_threads(device: Any) -> int:
    """As many as the OpenCL device has compute units, if it is a CPU, else all cores."""
    import pyopencl as cl

    is_cpu = bool(device.type & cl.device_type.CPU)
    return int(device.max_compute_units) if is_cpu else os.cpu_count() or 1


def _compare(
    scene: BenchScene, volume, size: int, device: Any, threads: int, options: Options
) -> dict[str, Any]:
    from bench.reference_cache import exact_picture
    from bench.vtk_peer import VtkPeer
    from clvol.render import Renderer

    vtk_steps, clvol_steps = VTK_STEPS, CLVOL_STEPS
    frames = options.frames
    if options.quick:
        vtk_steps, clvol_steps, frames = QUICK["vtk"], QUICK["clvol"], QUICK["frames"]
    begun = time.perf_counter()
    classification = options.classification or DEFAULT
    integration = {"classification": classification}
    resolved = scene.scene(volume, size).resolve()
    most = size * size if size <= WHOLE_SIZE else RANDOM_PIXELS
    exact = exact_picture(
        resolved, device, options.references, most, lambda text: say(f"{scene.name} {size}: {text}")
    )
    load = load_average()

    with contextlib.ExitStack() as stack:
        peer = stack.enter_context(contextlib.closing(VtkPeer(resolved, threads)))
        renderers = {
            step: stack.enter_context(
                Renderer(scene.scene(volume, size, step=step, **integration), [device])
            )
            for step in clvol_steps
        }
        points = {("vtk", step): {"step": step} for step in vtk_steps}
        points |= {("clvol", step): {"step": step} for step in clvol_steps}
        pictures = {}
        for key, point in points.items():  # compiles, warms up, and is what errors are taken of
            if key[0] == "vtk":
                peer.render(key[1])
                picture, window = peer.ray_picture(), peer.window_picture()
                point["window_rmse"] = exact.rmse(window)
                if key[1] == 1.0:
                    pictures["window", 1.0] = window
            else:
                frame = renderers[key[1]].render(depth=False)
                picture = frame.rgba
                point["samples"] = frame.stats["samples"]
                if key[1] == 1.0:  # what "auto" has taken
                    classification = frame.stats.get("classification", {}).get("name", classification)
            point["rmse"], point["max_abs"] = exact.rmse(picture), exact.max_abs(picture)
            if key[0] == "vtk" or key[1] == 1.0:
                pictures[key] = picture
        mapper_seconds: dict[float, list[float]] = {step: [] for step in vtk_steps}

        def vtk_frame(step: float) -> float:
            wall, mapper = peer.render(step)
            mapper_seconds[step].append(mapper)
            return wall

        def clvol_frame(step: float) -> float:
            return renderers[step].render(depth=False).stats["seconds"]["render"]

        peer.render_empty()
        turns: dict[Any, Any] = {"empty": peer.render_empty}
        for key in sorted(points, key=lambda k: (k[1] != 1.0, -k[1], k[0])):
            frame = vtk_frame if key[0] == "vtk" else clvol_frame
            turns[key] = lambda frame=frame, step=key[1]: frame(step)
        first = (("vtk", 1.0), ("clvol", 1.0))
        times = take_turns(turns, frames, never_slow=first)
        empty = times.pop("empty")
        for key, taken in times.items():
            points[key]["time"] = taken
            points[key]["seconds"], points[key]["least"] = taken["median"], taken["min"]
            if key[0] == "vtk":
                window = taken["median"] - empty["median"]
                mapper = float(np.median(mapper_seconds[key[1]]))
                points[key]["window_less_empty"], points[key]["mapper"] = window, mapper
                points[key]["seconds"] = min(window, mapper)
                points[key]["least"] = min(
                    taken["min"] - empty["median"], *mapper_seconds[key[1]]
                )
        best = min(vtk_steps, key=lambda step: points["vtk", step]["rmse"])
        align = alignment(resolved, pictures["vtk", best], device)
        align["window_against_rays"] = float(
            np.sqrt(np.mean((pictures["window", 1.0] - pictures["vtk", 1.0]) ** 2))
        )
    measured = {
        "scene": scene.name,
        "summary": scene.summary,
        "classification": classification,
        "size": size,
        "load": load,
        "pixels_compared": len(exact.pixels),
        "empty_window": empty["median"],
        "alignment": align,
        "vtk": [points["vtk", step] for step in vtk_steps],
        "clvol": [points["clvol", step] for step in clvol_steps],
    }
    measured["headline"] = headline(measured["vtk"], measured["clvol"])
    of_window = [{**p, "rmse": p["window_rmse"]} for p in measured["vtk"]]
    measured["headline_window"] = headline(of_window, measured["clvol"])
    save_side_by_side(
        [pictures[name, 1.0] for name in ("vtk", "window", "clvol")],
        options.folder / "pictures" / f"{scene.name}-{size}.png",
    )
    h = measured["headline"]
    say(f"{scene.name} {size}: VTK {h['vtk_seconds']:.4f} s, clvol {h['clvol_seconds']:.4f} s,"
        f" {h['ratio']:.2f}x at step 1   ({time.perf_counter() - begun:.0f} s)")
    if align["best_offset"] != [0.0, 0.0] or align["best_flip"] != "none":
        say(f"{scene.name} {size}: the pictures are NOT aligned: {align}")
    return measured


def headline(vtk: list[dict], clvol: list[dict]) -> dict[str, Any]:
    """What the curves (points with "step", "seconds", "least", "rmse") say about step 1 and equal
    errors. Ratios are VTK's seconds over clvol's; ``None`` where a curve does not reach the error.
    "ratio_of_least", of the shortest times, is there to judge a busy machine by.
    """
    v, c = (next(p for p in points if p["step"] == 1.0) for points in (vtk, clvol))
    curves = {name: [(p["seconds"], p["rmse"]) for p in points]
              for name, points in (("vtk", vtk), ("clvol", clvol))}
    ours, theirs = reach(curves["clvol"], v["rmse"]), reach(curves["vtk"], c["rmse"])
    return {
        "vtk_seconds": v["seconds"],
        "clvol_seconds": c["seconds"],
        "ratio": v["seconds"] / c["seconds"],
        "ratio_of_least": v["least"] / c["least"],
        "vtk_rmse": v["rmse"],
        "clvol_rmse": c["rmse"],
        "clvol_to_vtk_error": vars(ours),
        "ratio_at_vtk_error": v["seconds"] / ours.seconds if ours.seconds else None,
        "vtk_to_clvol_error": vars(theirs),
        "ratio_at_clvol_error": theirs.seconds / c["seconds"] if theirs.seconds else None,
    }


def overall(heads: list[dict]) -> dict[str, Any]:
    """What ``headline`` says of each picture, all together."""
    ratios = [h["ratio"] for h in heads]
    same = [h["ratio_at_vtk_error"] for h in heads]
    reached = [r for r in same if r is not None]
    return {
        "pictures": len(heads),
        "least_ratio": min(ratios),
        "mean_ratio": geometric_mean(ratios),
        "least_ratio_at_vtk_error": min(reached) if len(reached) == len(same) else None,
        "mean_ratio_at_vtk_error": geometric_mean(reached) if len(reached) == len(same) else None,
        "always_lower_error": all(h["clvol_rmse"] < h["vtk_rmse"] for h in heads),
    }


def alignment(resolved: ResolvedScene, picture: np.ndarray, device: Any) -> dict[str, Any]:
    """Where in VTK's pixels its rays go: RMSE of its picture against the exact rays through points
    shifted by half a pixel, and against its own flips; [0, 0] and "none" are best where it agrees.
    """
    from clvol.integrators.reference.picture import integrate_world_rays

    height, width, _ = picture.shape
    seen = np.argwhere(picture[..., 3] > 0)
    seen = seen[np.random.default_rng(1).permutation(len(seen))[:1500]]
    rows, columns = seen.T
    camera = resolved.camera
    forward, right, up = camera.basis()
    pixel = 2 * np.tan(np.radians(camera.fov_degrees) / 2) / height

    def exact(dx: float, dy: float) -> np.ndarray:
        u, v = columns + 0.5 + dx - width / 2, rows + 0.5 + dy - height / 2
        rays = forward + pixel * (u[:, None] * right - v[:, None] * up)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        eye = np.broadcast_to(np.array(camera.position), rays.shape)
        rgba, _, _ = integrate_world_rays(
            resolved.volume, resolved.transfer_function, eye, rays, device, tolerance=1e-5
        )
        return rgba

    def rmse(of: np.ndarray, rgba: np.ndarray) -> float:
        return float(np.sqrt(np.mean((of[rows, columns] - rgba) ** 2)))

    shifts = (-0.5, 0.0, 0.5)
    by_offset = {(dx, dy): rmse(picture, exact(dx, dy)) for dx in shifts for dy in shifts}
    centre = exact(0.0, 0.0)
    by_flip = {
        "none": by_offset[0.0, 0.0],
        "left-right": rmse(picture[:, ::-1], centre),
        "up-down": rmse(picture[::-1], centre),
        "both": rmse(picture[::-1, ::-1], centre),
    }

    def vertex(low: float, middle: float, high: float) -> float:
        """Of the parabola through squared errors at -0.5, 0, 0.5."""
        bend = low**2 - 2 * middle**2 + high**2
        return 0.25 * (low**2 - high**2) / bend if bend > 0 else 0.0

    return {
        "best_offset": list(min(by_offset, key=by_offset.get)),
        "best_flip": min(by_flip, key=by_flip.get),
        "offset_estimate": [
            vertex(*(by_offset[dx, 0.0] for dx in shifts)),
            vertex(*(by_offset[0.0, dy] for dy in shifts)),
        ],
        "rmse": {f"{dx:g}, {dy:g}": error for (dx, dy), error in by_offset.items()},
        "rmse_flipped": by_flip,
    }


def show(result: dict[str, Any]) -> str:
    frames, errors = [], []
    for s in result["scenes"]:
        rays, window = s["headline"], s["headline_window"]
        frames.append([
            s["scene"], s["size"], s["classification"], f"{rays['vtk_seconds']:.4f}", f"{rays['clvol_seconds']:.4f}",
            f"{rays['ratio']:.2f}", f"{rays['ratio_of_least']:.2f}", f"{rays['vtk_rmse']:.5f}",
            f"{window['vtk_rmse']:.5f}", f"{rays['clvol_rmse']:.5f}",
        ])  # fmt: skip
        row = [s["scene"], s["size"]]
        for h in (rays, window):
            ours = h["clvol_to_vtk_error"]
            row += [_seconds(ours), _times(h["ratio_at_vtk_error"], ours, ">=")]
        for h in (rays, window):
            theirs = h["vtk_to_clvol_error"]
            row += [_seconds(theirs), _times(h["ratio_at_clvol_error"], theirs, "<=")]
        errors.append(row)
    head = ["scene", "size", "clvol's", "VTK s", "clvol s", "ratio", "of minima", "RMSE VTK", "its window",
            "clvol"]
    lines = [
        f"Step 1, no shading, clvol's classification {result['classification']}; ratio: VTK's seconds over clvol's.",
        table(head, frames),
        "",
        "Seconds that clvol needs for VTK's step-1 error (of its rays, of its window), and VTK for"
        " clvol's.",
        table(["scene", "size", "clvol: rays", "ratio", "window", "ratio",
               "VTK: rays", "ratio", "window", "ratio"], errors),
        "",
        *_against_goals(result),
    ]
    first = [p["time"] for s in result["scenes"] for k in ("vtk", "clvol") for p in s[k]
             if p["step"] == 1.0]
    offsets = np.abs([s["alignment"]["offset_estimate"] for s in result["scenes"]]).max()
    lines += [
        f"medians of at least {min(t['frames'] for t in first)} frames, taking turns; largest"
        f" interquartile range at step 1 {max(t['spread'] for t in first):.0%} of the median;"
        f" load average {result['load_before']} to {result['load_after']},"
        f" {result['machine']['cores']} cores",
        f"VTK's rays go where clvol's do within {offsets:.2f} pixels (estimated)",
    ]
    if result["missing"]:
        lines.append(f"left out, no volume: {', '.join(result['missing'])}")
    if result["quick"]:
        lines.append("This was a quick run at a small size: no figure of it is a result.")
    return "\n".join(lines)


def _against_goals(result: dict[str, Any]) -> list[str]:
    rays, window = result["overall"], result["overall_window"]
    lines = [
        f"step 1: least ratio {rays['least_ratio']:.2f} (goal {FASTER_GOAL:g}), geometric mean"
        f" {rays['mean_ratio']:.2f} (goal {MEAN_GOAL:g}), {rays['pictures']} pictures"
    ]
    for name, o in (("rays", rays), ("window", window)):
        least, mean = o["least_ratio_at_vtk_error"], o["mean_ratio_at_vtk_error"]
        times = "not reached on every scene" if least is None else (
            f"least ratio {least:.2f} (goal {SAME_ERROR_GOAL:g}), geometric mean {mean:.2f}"
            f" (goal {SAME_ERROR_MEAN_GOAL:g})"
        )
        lower = "on every picture" if o["always_lower_error"] else "NOT on every picture"
        lines.append(f"at the step-1 error of VTK's {name}: {times}; clvol's is lower {lower}")
    return lines


def _seconds(reached: dict[str, Any]) -> str:
    if reached["seconds"] is None:
        return f"not reached ({reached['least_error']:.4f})"
    return ("<= " if reached["kind"] == "at most" else "") + f"{reached['seconds']:.4f}"


def _times(ratio: float | None, reached: dict[str, Any], bound: str) -> str:
    if ratio is None:
        return "-"
    return (f"{bound} " if reached["kind"] == "at most" else "") + f"{ratio:.2f}"


def draw(result: dict[str, Any], options: Options) -> list:
    from bench.charts import error_time_chart, ratio_chart

    made = [ratio_chart(result, options.folder / "peers-ratios.png")]
    for size in sorted({s["size"] for s in result["scenes"]}):
        path = options.folder / f"peers-error-time-{size}.png"
        made.append(error_time_chart(result, size, path))
    return made
