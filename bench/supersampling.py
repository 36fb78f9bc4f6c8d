"""More than one ray per pixel: what patterns and thresholds cost, and what error they leave.

Per scene, RMSE against 64 rays per pixel (a regular grid of 8 by 8), rays per pixel and seconds of a frame: one ray,
2 and 4 everywhere, 4 on the rotated grid, everywhere and at edges by three thresholds, and graded by four. The goal is
the error of the regular 4 everywhere with at most 35 % of its rays. Then `--max-error --pixel-area`, in small pictures,
where pixels hold more: whether it holds over all pixels, against 225 rays per pixel, none of which is one of the
picture's own.
After Klein et al. 2005, section 4.3.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from bench.options import Options
from bench.report import load_average, machine, table
from bench.scenes import SCENES, BenchScene, available
from clvol.accuracy.timing import take_turns

SUMMARY = "rays per pixel: error, rays and time of patterns and thresholds"
SIZE, QUICK_SIZE = 512, 64
TARGET_SIZE = 128  # of pictures with --pixel-area
GOAL = 0.35  # of the rays of four everywhere
ERRORS = (1e-2, 3e-3)
_SIDE, _TARGET_SIDE = 8, 15  # rays per side of a pixel of what is compared with
THRESHOLDS = (0.02, 0.03, 0.05)
GRADED = (0.01, 0.015, 0.03, 0.065)
_FINE = {"step": 1 / 8, "early_termination": 0.0}  # of rays that stand for exact ones
VARIANTS: dict[str, dict[str, Any]] = {
    "1": {},
    "2": {"samples": 2, "refine": "all"},
    "4 regular": {"samples": 4, "refine": "all", "sample_pattern": "regular"},
    "4 rotated": {"samples": 4, "refine": "all"},
    **{f"4 regular, edges {t}": {"samples": 4, "edge_threshold": t, "sample_pattern": "regular"} for t in THRESHOLDS},
    **{f"4 rotated, edges {t}": {"samples": 4, "edge_threshold": t} for t in THRESHOLDS},
    **{f"4 graded, edges {t}": {"samples": 4, "edge_threshold": t, "refine": "graded"} for t in GRADED},
}


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    result: dict[str, Any] = {
        "machine": machine(device), "quick": options.quick, "load_before": load_average(),
        "missing": [], "rows": [], "targets": [],
    }  # fmt: skip
    for scene in available(SCENES, options.scenes, result["missing"]):
        volume, size = scene.load(), QUICK_SIZE if options.quick else SIZE
        truth = _many_rays(scene, volume, size, device, _SIDE, _settings(scene))
        result["rows"] += _variants(scene, volume, size, device, truth)
        small = QUICK_SIZE if options.quick else TARGET_SIZE
        truth = _many_rays(scene, volume, small, device, _TARGET_SIDE, _FINE)
        for error in ERRORS[:1] if options.quick else ERRORS:
            result["targets"].append(_target(scene, volume, small, device, truth, error))
    result["load_after"] = load_average()
    return result if result["rows"] else None


def _settings(scene: BenchScene) -> dict[str, Any]:
    return {"classification": scene.classification}


def _rmse(rgba: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean((rgba.astype(np.float64) - truth) ** 2)))


def _many_rays(
    scene: BenchScene, volume: Any, size: int, device: Any, side: int, integration: dict[str, Any]
) -> np.ndarray:
    """float64 [size, size, 4]: means of ``side`` by ``side`` rays per pixel."""
    from clvol.device.view import PixelLattice
    from clvol.opencl.context import DeviceContext
    from clvol.render.prepared_cache import PreparedCache

    resolved = scene.scene(volume, size, **integration).resolve()
    context = DeviceContext(device)
    try:
        prepared = PreparedCache(context).prepare(resolved)
        total = np.zeros((size, size, 4))
        for row in range(side):
            for column in range(side):
                lattice = PixelLattice(side, column, row, alone=True)
                whole = side * size
                total += prepared.render(resolved.camera, whole, whole, depth=False, lattice=lattice).rgba
        return total / side**2
    finally:
        context.release()


def _variants(scene: BenchScene, volume: Any, size: int, device: Any, truth: np.ndarray) -> list[dict[str, Any]]:
    from clvol import Renderer

    renderers: dict[str, Renderer] = {}
    frames: dict[str, Any] = {}
    try:
        for name, image in VARIANTS.items():
            made = scene.scene(volume, size, {"image": image}, **_settings(scene))
            renderers[name] = Renderer(made, devices=[device])
            frames[name] = renderers[name].render(depth=False)

        def timed(name: str):
            def frame() -> float:
                begun = time.perf_counter()
                renderers[name].render(depth=False)
                return time.perf_counter() - begun

            return frame

        times = take_turns({name: timed(name) for name in VARIANTS}, 5)
    finally:
        for renderer in renderers.values():
            renderer.close()
    pixels = size * size
    return [
        {
            "scene": scene.name, "variant": name, "rmse": _rmse(frame.rgba, truth),
            "rays_per_pixel": frame.stats["rays"] / pixels, "seconds": times[name]["median"],
            "rounds": frame.stats.get("supersampling", {}).get("rounds"),
        }
        for name, frame in frames.items()
    ]  # fmt: skip


def _target(scene: BenchScene, volume: Any, size: int, device: Any, truth: np.ndarray, error: float) -> dict[str, Any]:
    """What `--max-error --pixel-area` claims, and its error over all pixels."""
    from clvol.accuracy.error_target import render_to_error

    begun = time.perf_counter()
    asked = scene.scene(volume, size, **_settings(scene))
    frame = render_to_error(asked, error, devices=[device], depth=False, pixel_area=True)
    accuracy = frame.stats["accuracy"]
    return {
        "scene": scene.name, "error": error, "claimed": accuracy["rmse"], "bound": accuracy["bound"],
        "true": _rmse(frame.rgba, truth), "settings": accuracy["settings"],
        "rays_per_pixel": frame.stats["rays"] / size**2, "seconds": frame.stats["seconds"]["render"],
        "search_seconds": time.perf_counter() - begun,
    }  # fmt: skip


def reached(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of one scene's rows: the least share of the rays of four everywhere (regular) with which pixels that are refined
    at edges have at most its error; None where none has."""
    full = next(row for row in rows if row["variant"] == "4 regular")
    held = [row for row in rows if "edges" in row["variant"] and row["rmse"] <= full["rmse"]]
    best = min(held, key=lambda row: row["rays_per_pixel"], default=None)
    if best is None:
        return {"share": None, "variant": None}
    return {"share": best["rays_per_pixel"] / full["rays_per_pixel"], "variant": best["variant"]}


def show(result: dict[str, Any]) -> str:
    lines = []
    for name in dict.fromkeys(row["scene"] for row in result["rows"]):
        rows = [row for row in result["rows"] if row["scene"] == name]
        shown = [
            [row["variant"], f"{row['rmse']:.2e}", f"{row['rays_per_pixel']:.3f}", f"{1e3 * row['seconds']:.1f}"]
            for row in rows
        ]
        lines += ["", name, table(["rays", "RMSE", "rays/pixel", "ms"], shown)]
        best = reached(rows)
        if best["share"] is None:
            lines.append("the error of 4 everywhere: not reached at edges")
        else:
            verdict = "reached" if best["share"] <= GOAL else "missed"
            lines.append(f"the error of 4 everywhere by {best['variant']}: {best['share']:.1%} of its rays: {verdict}")
    shown = [
        [row["scene"], f"{row['error']:g}", f"{row['bound']:.2e}", f"{row['true']:.2e}",
         "yes" if row["true"] <= row["error"] else "NO", f"{row['rays_per_pixel']:.2f}", f"{row['seconds']:.3f}",
         f"{row['search_seconds']:.0f}"]
        for row in result["targets"]
    ]  # fmt: skip
    head = ["--pixel-area", "error", "bound", "over all pixels", "holds", "rays/pixel", "s", "in all, s"]
    lines += ["", table(head, shown), f"load average {result['load_before']} to {result['load_after']}"]
    if result["quick"]:
        lines.append("This was a quick run at a small size: no figure of it is a result.")
    return "\n".join(lines)


def draw(result: dict[str, Any], options: Options) -> list:
    return []
