"""Transfer functions: classification of random peaks (Engel and Ertl 2002, figures 3, 39 and 40), and what tables of
integral functions cost and err beside the closed form and beside the table of all segments.

Random functions have a peak of its own colour in each of many intervals: each peak is an iso-surface, so that what a
rule of classification misses is seen. Errors are root mean squares of a picture's linear premultiplied RGBA against
pre-integration at a sixteenth of the step; of segments, against the integral in double precision.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.options import Options
from bench.pictures import save_side_by_side
from bench.report import load_average, machine, say, table
from bench.scenes import VOLUMES, camera
from clvol.accuracy.timing import take_turns

SUMMARY = "random peaks by classification; integral tables beside the closed form"
PICTURE = Path(__file__).resolve().parent / "random-peaks.png"
SIZE, QUICK_SIZE = 320, 48
STEPS, QUICK_STEPS = (2.0, 1.0, 0.5), (1.0,)
ENTRIES, QUICK_ENTRIES = (64, 256, 1024), (64,)
RULES = ("pre", "post", "preintegrated")
_TRUTH = 1 / 16
_FRAMES = 7
_CHORDS = 20_000
_ORBITAL = 16  # voxels per edge, as in figure 3


def random_function(low: float, high: float, peaks: int, seed: int, opacity: float) -> dict[str, Any]:
    """[transfer_function] of ``peaks`` peaks that touch, of random colours and opacities up to ``opacity``."""
    rng = np.random.default_rng(seed)
    knots = np.linspace(low, high, 2 * peaks + 1)
    points = []
    for k, value in enumerate(knots):
        color, top = [float(x) for x in rng.uniform(0.0, 1.0, 3)], float(rng.uniform(0.2, 1.0) * opacity)
        points.append({"value": float(value), "opacity": k % 2 * top, "color": color})
    return {"points": points, "opacity_unit": 1.0, "color_space": "linear"}


def green_noise(low: float, high: float, points: int, seed: int) -> dict[str, Any]:
    """Figure 3: random green between straight red and blue."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0.0, 1.0, points)
    found = [
        {"value": low + t * (high - low), "opacity": 0.25 * t**0.5, "color": [t, g, 1 - t]}
        for t, g in zip(x.tolist(), rng.uniform(0.0, 1.0, points).tolist())
    ]
    return {"points": found, "opacity_unit": 1.0, "color_space": "linear"}


def orbital(n: int = _ORBITAL) -> np.ndarray:
    """uint8 [n, n, n]: the density of a hydrogen orbital (3d, m = 0), computed."""
    z, y, x = (np.mgrid[:n, :n, :n] - (n - 1) / 2) * (18.0 / (n - 1))
    r = np.sqrt(x * x + y * y + z * z) + 1e-9
    wave = r * r * np.exp(-r / 3.0) * (3.0 * (z / r) ** 2 - 1.0)
    return np.round(255.0 * wave**2 / (wave**2).max()).astype(np.uint8)


def run(options: Options) -> dict[str, Any] | None:
    from clvol import Volume, load_volume
    from clvol.opencl.devices import open_device

    path = VOLUMES / "engine.nrrd"
    if not path.exists():
        say(f"random-peaks: left out, {path.name} is not in {VOLUMES}")
        return None
    device, size = open_device(options.device), QUICK_SIZE if options.quick else SIZE
    engine = Volume(load_volume(path).data, name="engine")
    weighted = {"points": [{"magnitude": 0.0, "opacity": 0.0}, {"magnitude": 25.0, "opacity": 1.0}]}
    scenes = {
        "orbital (figure 3)": (Volume(orbital()), green_noise(0.0, 255.0, 64, 1), {}),
        "engine (figure 39)": (engine, random_function(20.0, 255.0, 24, 3, 0.25), {}),
        "engine, gradient-weighted (figure 40)":
            (engine, random_function(20.0, 255.0, 24, 3, 0.25), {"gradient_opacity": weighted}),
    }  # fmt: skip
    result: dict[str, Any] = {
        "machine": machine(device), "quick": options.quick, "load_before": load_average(), "size": size, "rules": [],
        "tables": [], "pictures": [],
    }  # fmt: skip
    for name, (volume, function, tables) in scenes.items():
        rows, pictures = _by_rule(device, name, volume, function, tables, size, options.quick)
        result["rules"] += rows
        path = options.folder / "random-peaks" / f"{len(result['pictures'])}.png"
        result["pictures"].append(str(save_side_by_side(pictures, path)))
        say(f"{name}: done")
    volume, function, _ = scenes["engine (figure 39)"]
    result["tables"] = _tables(device, volume, function, size, options.quick)
    result["load_after"] = load_average()
    return result


def _scene(volume: Any, function: dict[str, Any], tables: dict[str, Any], size: int, **integration: Any) -> Any:
    from clvol import Scene

    integration = {"early_termination": 0.0, "step_error": 0.0, **integration}
    return Scene(volume=volume, camera=camera(volume), transfer_function=function, integration=integration,
                 image={"width": size, "height": size}, **tables)  # fmt: skip


def _picture(device: Any, scene: Any) -> np.ndarray:
    from clvol import Renderer

    with Renderer(scene, devices=[device]) as renderer:
        return renderer.render(depth=False).rgba


def _rmse(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean((a - b) ** 2)))


def _by_rule(
    device: Any, name: str, volume: Any, function: dict, tables: dict, size: int, quick: bool
) -> tuple[list[dict[str, Any]], list[np.ndarray]]:
    """Errors of each rule at each step, and pictures at a step of 1 with the exact one last."""
    truth = _picture(device, _scene(volume, function, tables, size, classification="preintegrated", step=_TRUTH))
    rows, pictures = [], []
    for rule in RULES:
        row: dict[str, Any] = {"scene": name, "rule": rule}
        for step in QUICK_STEPS if quick else STEPS:
            rgba = _picture(device, _scene(volume, function, tables, size, classification=rule, step=step))
            row[f"step {step:g}"] = _rmse(rgba, truth)
            if step == 1.0:
                pictures.append(rgba)
        rows.append(row)
    return rows, [*pictures, truth]


def _tables(device: Any, volume: Any, function: dict, size: int, quick: bool) -> list[dict[str, Any]]:
    """Per way of looking segments up: time to build, error of segments, error and time of a picture."""
    from clvol import Renderer
    from clvol.transfer.integral_table import HEAD, integral_table
    from clvol.transfer.pieces import piece_table
    from clvol.transfer.preintegration import preintegrate

    made = _scene(volume, function, {}, size).resolve().transfer_function
    rng = np.random.default_rng(5)
    front, back = rng.uniform(20.0, 255.0, (2, 1000 if quick else _CHORDS))
    exact = preintegrate(made, front, back, np.ones(front.size))
    truth = _picture(device, _scene(volume, function, {}, size, classification="preintegrated", step=_TRUTH))

    ways: list[dict[str, Any]] = [
        {"way": "closed form, pieces", "build_ms": _milliseconds(lambda: piece_table(made, 1.0)), "scene": {}}
    ]
    for entries in QUICK_ENTRIES if quick else ENTRIES:
        build = lambda entries=entries: integral_table(made, 0.0, 255.0, entries, 0.0)  # noqa: E731
        nodes = build()[HEAD:].reshape(entries, 4).astype(np.float64)
        at = np.linspace(0.0, 255.0, entries)
        ends = [np.stack([np.interp(x, at, each) for each in nodes.T], axis=-1) for x in (front, back)]
        mean = (ends[1] - ends[0]) / (back - front)[:, None]
        looked_up = np.concatenate([mean[:, 1:], -np.expm1(-mean[:, :1])], axis=1)
        ways.append({
            "way": f"integral table, {entries}", "build_ms": _milliseconds(build), "segments": _rmse(looked_up, exact),
            "scene": {"segments": "integral-table", "table_size": entries},
        })  # fmt: skip
    scenes = [_scene(volume, function, {}, size, classification="preintegrated", **way.pop("scene")) for way in ways]
    with ExitStack() as stack:
        renderers = [stack.enter_context(Renderer(scene, devices=[device])) for scene in scenes]
        for way, renderer in zip(ways, renderers):
            way["rmse"] = _rmse(renderer.render(depth=False).rgba, truth)
        frame = {k: partial(_frame_seconds, renderer) for k, renderer in enumerate(renderers)}
        for k, taken in take_turns(frame, _FRAMES).items():
            ways[k]["frame_ms"] = 1e3 * taken["median"]
    return [*ways, _whole_table(made, front, back, exact, 32 if quick else 256)]


def _frame_seconds(renderer: Any) -> float:
    return renderer.render(depth=False).stats["seconds"]["render"]


def _whole_table(
    made: Any, front: np.ndarray, back: np.ndarray, exact: np.ndarray, entries: int
) -> dict[str, Any]:
    """The table of all segments of one length, by front and back value, bilinear: what integral tables stand for."""
    from scipy.ndimage import map_coordinates

    from clvol.transfer.preintegration import preintegrate

    begin = time.perf_counter()
    at = np.linspace(0.0, 255.0, entries)
    whole = preintegrate(made, at[:, None], at[None, :], np.ones((entries, entries)))
    build = 1e3 * (time.perf_counter() - begin)
    places = np.stack([front, back]) / 255.0 * (entries - 1)
    found = np.stack([map_coordinates(whole[..., k], places, order=1) for k in range(4)], axis=-1)
    return {"way": f"table of segments, {entries} x {entries}", "build_ms": build, "segments": _rmse(found, exact)}


def _milliseconds(build: Any) -> float:
    build()
    taken = []
    for _ in range(9):
        begin = time.perf_counter()
        build()
        taken.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(taken))


def show(result: dict[str, Any]) -> str:
    steps = [key for key in result["rules"][0] if key.startswith("step")]
    rules = table(["scene", "rule", *steps], [
        [row["scene"], row["rule"], *(f"{row[step]:.2e}" for step in steps)] for row in result["rules"]
    ], left=2)  # fmt: skip
    ways = table(["segments", "build, ms", "RMSE of segments", "RMSE of the picture", "frame, ms"], [
        [row["way"], f"{row['build_ms']:.2f}", _number(row.get("segments"), "{:.2e}"),
         _number(row.get("rmse"), "{:.2e}"), _number(row.get("frame_ms"), "{:.0f}")] for row in result["tables"]
    ])  # fmt: skip
    return f"{rules}\n\n{ways}\nload average {result['load_before']} to {result['load_after']}"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def draw(result: dict[str, Any], options: Options) -> list:
    """One picture: a row per scene, and pre, post, pre-integrated and exact from left to right."""
    from PIL import Image

    rows = [Image.open(path).convert("RGB") for path in result["pictures"]]
    sheet = Image.new("RGB", (rows[0].width, sum(row.height for row in rows)))
    for k, row in enumerate(rows):
        sheet.paste(row, (0, k * row.height))
    path = options.folder / "random-peaks.png" if options.quick else PICTURE
    from bench.gallery import save_small

    save_small(sheet, path)
    return [path]
