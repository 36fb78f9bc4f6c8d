"""Pictures to an error: whether it holds over all pixels, and what the chosen settings are worth.

Per scene and error: `render_to_error`, its claim, the true error over all pixels against the exact
integral, and the seconds of a frame beside those that even steps need for the same true error: with
the classification that suits the scene best, and with clvol's default. Steps are a factor of sqrt(2)
apart and interpolated between; where the default early termination does not let them reach the
error, they may do without it. All frames take turns.
"""

from __future__ import annotations

import time
from typing import Any

from bench.curves import reach
from bench.options import Options
from bench.report import load_average, machine, table
from bench.scenes import SCENES, BenchScene, available
from clvol.accuracy.timing import take_turns

SUMMARY = "--max-error: does it hold, and is it cheaper than even steps"
ERRORS = (1e-2, 1e-3, 1e-4)
STEPS = tuple(2.0 ** (k / 2) for k in range(5, -11, -1))
SIZE = 512
_SLOWEST = 2.0  # seconds: finer steps are not waited for


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    result: dict[str, Any] = {
        "machine": machine(device), "quick": options.quick, "load_before": load_average(),
        "missing": [], "rows": [],
    }  # fmt: skip
    for scene in available(SCENES, options.scenes, result["missing"]):
        result["rows"] += _scene(scene, scene.load(), device, options)
    result["load_after"] = load_average()
    return result if result["rows"] else None


def _scene(scene: BenchScene, volume, device: Any, options: Options) -> list[dict[str, Any]]:
    from bench.reference_cache import exact_picture
    from clvol.accuracy.error_target import render_to_error
    from clvol.accuracy.settings import scene_settings, scene_tunables
    from clvol.accuracy.trials import Trials
    from clvol.opencl.context import DeviceContext
    from clvol.render.prepared_cache import PreparedCache

    size = 128 if options.quick else SIZE
    asked = scene.scene(volume, size, classification=scene.classification)
    resolved = asked.resolve()
    exact = exact_picture(resolved, device, options.references, size * size)
    context = DeviceContext(device)
    trials = Trials(resolved, PreparedCache(context), frames=1, exact=exact.rgba.reshape(size, size, 4))
    own = scene_settings(resolved, scene_tunables(resolved))
    rows, runs = [], {}
    for error in ERRORS[:1] if options.quick else ERRORS:
        begun = time.perf_counter()
        frame = render_to_error(asked, error, devices=[device], depth=False)
        claimed = frame.stats["accuracy"]
        rows.append({
            "scene": scene.name, "max_error": error, "true": exact.rmse(frame.rgba),
            "rmse": claimed["rmse"], "bound": claimed["bound"], "pixels": claimed["pixels"],
            "attempts": claimed["attempts"], "tried": claimed["tried"],
            "settings": claimed["settings"], "wall": time.perf_counter() - begun,
        })  # fmt: skip
        if claimed["settings"]["integration.method"] != "reference":
            runs["chosen", error] = trials.frames_of(claimed["settings"])
    least = min(row["true"] for row in rows)
    curves: dict[str, list[tuple[tuple, float]]] = {}
    for name in dict.fromkeys((scene.classification, "preintegrated")):
        curves[name] = []
        for stop in (own["integration.early_termination"], 0.0):
            if any(rmse <= least for _, rmse in curves[name]):
                break
            settings = {**own, "integration.classification": name,
                        "integration.early_termination": stop}  # fmt: skip
            for step in (1.0, 2.0) if options.quick else STEPS:
                trial = trials.run({**settings, "integration.step": step})
                key = (name, stop, step)
                curves[name].append((key, trial.rmse))
                runs[key] = trials.frames_of({**settings, "integration.step": step})
                if trial.seconds > _SLOWEST or trial.rmse <= least:
                    break
    frames = 3 if options.quick else options.frames
    times = take_turns({key: lambda run=run: run()[0] for key, run in runs.items()}, frames)
    for row in rows:
        key = "chosen", row["max_error"]
        row["seconds"] = times[key]["median"] if key in times else None
        row["spread"] = times[key]["spread"] if key in times else None
        row["even"] = {}
        for name, points in curves.items():
            found = reach([(times[k]["median"], rmse) for k, rmse in points], row["true"])
            ratio = found.seconds / row["seconds"] if row["seconds"] and found.seconds else None
            row["even"][name] = {"seconds": found.seconds, "kind": found.kind, "ratio": ratio}
        row["suits"] = row["even"][scene.classification]
        row["default"] = row["even"]["preintegrated"]
    context.release()
    return rows


def show(result: dict[str, Any]) -> str:
    rows = []
    for r in result["rows"]:
        settings = r["settings"]
        changed = ", ".join(
            str(settings[key]) if isinstance(settings[key], str) else f"{name} {settings[key]:.4g}"
            for key, name in (
                ("integration.classification", ""), ("integration.quadrature", ""),
                ("integration.step", "step"), ("integration.early_termination", "ends at"),
                ("integration.table_size", "table"), ("image.ray_spacing", "rays 1 :"),
                ("image.ray_tolerance", "tolerance"),
            )
            if key in settings
        )  # fmt: skip
        rows.append([
            r["scene"], f"{r['max_error']:g}", f"{r['true']:.2e}", f"{r['bound']:.2e}",
            "yes" if r["true"] <= r["max_error"] else "NO",
            f"{r['seconds']:.4f}" if r["seconds"] else "-", *_even(r["suits"]), *_even(r["default"]),
            f"{r['wall']:.1f}", changed,
        ])  # fmt: skip
    head = ["scene", "asked", "true", "bound", "holds", "s", "even steps, s", "ratio",
            "by default, s", "ratio", "in all, s", "settings"]
    held = sum(r["true"] <= r["max_error"] for r in result["rows"])
    names = dict.fromkeys(r["scene"] for r in result["rows"])
    cheaper = [
        f"{sum(_is_cheaper(r[kind]) for r in result['rows'] if r['max_error'] == e)} of {len(names)}"
        f" at {e:g}"
        for kind in ("suits", "default") for e in ERRORS
    ]  # fmt: skip
    lines = [
        table(head, rows),
        f"held: {held} of {len(result['rows'])}",
        "cheaper than even steps of the same true error: " + ", ".join(cheaper[: len(ERRORS)]),
        "cheaper than those with the default classification: " + ", ".join(cheaper[len(ERRORS) :]),
        f"load average {result['load_before']} to {result['load_after']}",
    ]
    if result["quick"]:
        lines.append("This was a quick run at a small size: no figure of it is a result.")
    return "\n".join(lines)


def _even(found: dict[str, Any]) -> list[str]:
    if found["seconds"] is None:
        return ["not reached", "-"]
    return [f"{found['seconds']:.4f}", f"{found['ratio']:.2f}" if found["ratio"] else "-"]


def _is_cheaper(found: dict[str, Any]) -> bool:
    return found["seconds"] is None or (found["ratio"] or 0.0) > 1.0


def draw(result: dict[str, Any], options: Options) -> list:
    return []
