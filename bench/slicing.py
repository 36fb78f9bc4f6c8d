"""What slices do to a picture, by the figures that Engel and Ertl (2002, section 4) argue with: stacks that pop, planes
and shells under wide views, narrow peaks that fall between slices, frame buffers of few bits; what slices take beside
rays; and half-angle slices (half_angle.py).

All pictures are of one volume, by the transfer functions engine-smooth and engine-peaks; errors are against the exact
integral.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from bench import half_angle
from bench.options import Options
from bench.reference_cache import exact_picture
from bench.report import closing, load_average, opening, say, table
from bench.scenes import SCENES, BenchScene, available
from bench.slicing_pictures import slicing_sheet

SUMMARY = "slices beside rays: popping, planes and shells, narrow peaks, frame buffers, half-angle slices"
SIZE, QUICK_SIZE = 256, 48
GEOMETRIES = ("object-aligned", "object-aligned-interpolated", "view-aligned", "shells")
ANGLES = (0, 10, 20, 30, 40, 44.9, 45.1, 50, 60, 70, 80, 90)
VIEWS = (30, 60, 90, 120)  # degrees of a picture's height
AROUND_45 = 0.05  # degrees on either side
SLICES = (32, 64, 128, 256, 512, 1024)
QUICK_ANGLES, QUICK_VIEWS, QUICK_SLICES = (0, 44.9, 45.1), (30, 120), (32, 128)
WIDE_SLICES = 128


class Bench:
    """Pictures of the two scenes on ``device``, ``size`` by ``size`` pixels."""

    def __init__(self, device: Any, scenes: list[BenchScene], size: int, options: Options) -> None:
        self.device, self.size, self.options = device, size, options
        self.scenes = {scene.name: (scene, scene.load()) for scene in scenes}

    def scene(self, name: str, camera: Any, integration: dict[str, Any], slicing: dict[str, Any] | None) -> Any:
        """``slicing``: keys of [slicing]; None: by rays."""
        from clvol import Camera, Slicing

        bench_scene, volume = self.scenes[name]
        method = "raycast" if slicing is None else "slicing"
        scene = bench_scene.scene(volume, self.size, method=method, early_termination=0.0, **integration)
        return scene.model_copy(update={"camera": Camera(**camera), "slicing": Slicing(**(slicing or {}))})

    def frame(self, name: str, camera: Any, slicing: dict[str, Any] | None, **integration: Any) -> Any:
        from clvol import Renderer

        with Renderer(self.scene(name, camera, integration, slicing), devices=[self.device]) as renderer:
            return renderer.render(depth=False)

    def exact(self, name: str, camera: Any, classification: str = "post") -> Any:
        resolved = self.scene(name, camera, {"classification": classification}, None).resolve()
        return exact_picture(resolved, self.device, self.options.references, self.size**2)

    def around(self, degrees: float) -> dict[str, Any]:
        """A camera that has been turned by ``degrees`` about the volume's y axis, from a view along z."""
        grid = next(iter(self.scenes.values()))[1].grid
        extent = [(n - 1) * s for n, s in zip(grid.size, grid.spacing)]
        centre, far = [e / 2 for e in extent], 2.0 * math.dist((0, 0, 0), extent)
        a = math.radians(degrees)
        position = [centre[0] + far * math.sin(a), centre[1], centre[2] - far * math.cos(a)]
        return {
            "projection": "orthographic", "position": position, "target": centre, "up": [0.0, 1.0, 0.0],
            "height": 0.75 * math.dist((0, 0, 0), extent),
        }  # fmt: skip

    def wide(self, degrees: float) -> dict[str, Any]:
        """A perspective camera before the face at z = 0, whose height the picture covers."""
        grid = next(iter(self.scenes.values()))[1].grid
        extent = [(n - 1) * s for n, s in zip(grid.size, grid.spacing)]
        away = 0.5 * extent[1] / math.tan(math.radians(degrees / 2))
        centre = [e / 2 for e in extent]
        return {
            "position": [centre[0], centre[1], -away], "target": [centre[0], centre[1], extent[2]],
            "up": [0.0, 1.0, 0.0], "fov_degrees": degrees,
        }  # fmt: skip


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    begin, quick = perf_counter(), options.quick
    result = opening(device, quick, QUICK_SIZE if quick else SIZE)
    scenes = [scene for scene in available(SCENES, (), result["missing"]) if scene.name.startswith("engine-")]
    if len(scenes) < 2:
        return None
    bench = Bench(device, scenes, result["size"], options)
    result["popping"] = list(popping(bench))
    result["angles"] = list(over_angles(bench, QUICK_ANGLES if quick else ANGLES))
    result["views"] = list(over_views(bench, QUICK_VIEWS if quick else VIEWS))
    result["peaks"] = list(over_slices(bench, QUICK_SLICES if quick else SLICES))
    result["buffers"] = list(over_buffers(bench, QUICK_SLICES if quick else SLICES))
    result["times"] = list(times(bench, 3 if quick else options.frames))
    result["half_angle"] = half_angle.measure(bench, quick)
    path = (Path(__file__).resolve().parent if not quick else options.folder) / "slicing-pictures.png"
    try:
        result["sheet"] = str(slicing_sheet(bench, half_angle.LightBench(bench, quick), path))
    except ImportError as error:
        say(f"no pictures: {error} (pip install matplotlib)")
    result["seconds"], result["load_after"] = perf_counter() - begin, load_average()
    return result


def popping(bench: Bench) -> Iterator[dict[str, Any]]:
    """How far two pictures on either side of 45° differ, and two as far apart beside it."""
    for geometry in (*GEOMETRIES, "rays"):
        slicing = None if geometry == "rays" else {"geometry": geometry}
        row = {"geometry": geometry}
        for name, middle in (("across", 45.0), ("beside", 40.0)):
            first, second = (
                bench.frame("engine-smooth", bench.around(middle + turn), slicing, classification="post").rgba
                for turn in (-AROUND_45, AROUND_45)
            )
            row[name] = float(np.sqrt(np.mean((first - second) ** 2)))
        yield row


def over_angles(bench: Bench, angles: tuple[float, ...]) -> Iterator[dict[str, Any]]:
    for angle in angles:
        camera = bench.around(angle)
        exact = bench.exact("engine-smooth", camera)
        row: dict[str, Any] = {"angle": angle}
        for geometry in GEOMETRIES:
            step = 0.5 if geometry == "object-aligned-interpolated" else 1.0  # a slice between two planes of voxels
            frame = bench.frame("engine-smooth", camera, {"geometry": geometry}, classification="post", step=step)
            row[geometry] = exact.rmse(frame.rgba)
        slicing = {"geometry": "object-aligned", "opacity_correction": False}
        row["not corrected"] = exact.rmse(bench.frame("engine-smooth", camera, slicing, classification="post").rgba)
        row["rays"] = exact.rmse(bench.frame("engine-smooth", camera, None, classification="post").rgba)
        yield row


def over_views(bench: Bench, views: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    """Planes across the view, with and without correction, and shells, at the same number of slices."""
    for degrees in views:
        camera = bench.wide(degrees)
        exact = bench.exact("engine-smooth", camera)
        row: dict[str, Any] = {"degrees": degrees}
        for name, slicing in (
            ("planes", {"geometry": "view-aligned"}),
            ("planes, not corrected", {"geometry": "view-aligned", "opacity_correction": False}),
            ("shells", {"geometry": "shells"}),
        ):
            slicing = {**slicing, "slices": WIDE_SLICES}
            row[name] = exact.rmse(bench.frame("engine-smooth", camera, slicing, classification="post").rgba)
        yield row


def over_slices(bench: Bench, counts: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    """Errors of three narrow peaks, and the share of pixels, of those that absorb a tenth, that have less than half the
    opacity they should have: holes."""
    camera = bench.around(20.0)
    exact = bench.exact("engine-peaks", camera)
    seen = exact.rgba[:, 3] > 0.1
    rows, columns = exact.pixels[seen].T
    for slices in counts:
        row: dict[str, Any] = {"slices": slices}
        for classification in ("post", "preintegrated"):
            slicing = {"geometry": "view-aligned", "slices": slices}
            rgba = bench.frame("engine-peaks", camera, slicing, classification=classification).rgba
            row[classification] = exact.rmse(rgba)
            row[f"{classification} holes"] = float(np.mean(rgba[rows, columns, 3] < 0.5 * exact.rgba[seen, 3]))
        yield row


def over_buffers(bench: Bench, counts: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    camera = bench.around(20.0)
    exact = bench.exact("engine-smooth", camera)
    for slices in counts:
        row: dict[str, Any] = {"slices": slices}
        for accumulate in ("float32", "half", "uint8"):
            slicing = {"geometry": "view-aligned", "slices": slices, "accumulate": accumulate}
            row[accumulate] = exact.rmse(bench.frame("engine-smooth", camera, slicing, classification="post").rgba)
        yield row


def times(bench: Bench, frames: int) -> Iterator[dict[str, Any]]:
    """Slices a step apart beside rays, in turns: medians of seconds, and samples. Hardware looks up both sides of a
    slab in the texture, where here the side in front is known: that would double the samples."""
    from contextlib import ExitStack

    from clvol import Renderer

    for name in bench.scenes:
        camera = bench.around(20.0)
        asked = {
            "rays": bench.scene(name, camera, {}, None),
            **{geometry: bench.scene(name, camera, {}, {"geometry": geometry}) for geometry in GEOMETRIES},
        }
        with ExitStack() as stack:
            renderers = {
                key: stack.enter_context(Renderer(scene, devices=[bench.device])) for key, scene in asked.items()
            }
            seconds: dict[str, list[float]] = {key: [] for key in asked}
            samples = {key: renderer.render(depth=False).stats["samples"] for key, renderer in renderers.items()}
            for _ in range(frames):
                for key, renderer in renderers.items():
                    seconds[key].append(renderer.render(depth=False).stats["seconds"]["render"])
        yield {"scene": name, "seconds": {k: statistics.median(v) for k, v in seconds.items()}, "samples": samples}


# ---- report


def show(result: dict[str, Any]) -> str:
    parts = [
        "Popping: RMSE between two pictures 0.1° apart.\n"
        + table(
            ["geometry", "across 45°", "at 40°"],
            [[r["geometry"], f"{r['across']:.5f}", f"{r['beside']:.5f}"] for r in result["popping"]],
        ),
        "Error over the view's angle.\n" + _errors(result["angles"], "angle", (*GEOMETRIES, "not corrected", "rays")),
        f"Error over the angle that a picture covers, {WIDE_SLICES} slices.\n"
        + _errors(result["views"], "degrees", ("planes", "planes, not corrected", "shells")),
        "Narrow peaks: error, and share of pixels with holes.\n"
        + table(
            ["slices", "post", "holes", "preintegrated", "holes"],
            [
                [r["slices"], f"{r['post']:.5f}", f"{r['post holes']:.1%}", f"{r['preintegrated']:.5f}",
                 f"{r['preintegrated holes']:.1%}"]
                for r in result["peaks"]
            ],
        ),
        "Precision of the frame buffer.\n" + _errors(result["buffers"], "slices", ("float32", "half", "uint8")),
        "Time: ms a frame (million samples).\n"
        + table(
            ["scene", "rays", *GEOMETRIES],
            [
                [r["scene"], *(f"{1e3 * r['seconds'][k]:.1f} ({r['samples'][k] / 1e6:.1f})" for k in r["seconds"])]
                for r in result["times"]
            ],
        ),
        *half_angle.show(result["half_angle"]),
        "\n".join(closing(result)),
    ]  # fmt: skip
    return "\n\n".join(parts)


def _errors(rows: list[dict[str, Any]], key: str, columns: tuple[str, ...]) -> str:
    return table([key, *columns], [[row[key], *(f"{row[column]:.5f}" for column in columns)] for row in rows])


def draw(result: dict[str, Any], options: Options) -> list:
    """Errors over the view's angle, over how wide the view is, and over the number of slices."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    (angles, views), (peaks, buffers) = figure.subplots(2, 2)
    for axes, rows, key, columns, title, label in (
        (angles, "angles", "angle", (*GEOMETRIES, "rays"), "error over the view's angle", "degrees from the z axis"),
        (views, "views", "degrees", ("planes", "planes, not corrected", "shells"),
         f"planes and shells, {WIDE_SLICES} slices", "degrees that the picture covers"),
        (peaks, "peaks", "slices", ("post", "preintegrated"), "three narrow peaks", "slices"),
        (buffers, "buffers", "slices", ("float32", "half", "uint8"), "precision of the frame buffer", "slices"),
    ):  # fmt: skip
        for column in columns:
            axes.plot([r[key] for r in result[rows]], [r[column] for r in result[rows]], marker="o", ms=4, label=column)
        axes.set_yscale("log")
        if key == "slices":
            axes.set_xscale("log", base=2)
            axes.set_xticks([r[key] for r in result[rows]], [str(r[key]) for r in result[rows]])
        axes.set(title=title, xlabel=label, ylabel="RMSE")
        axes.grid(True, color="#e6e6e6", linewidth=0.6)
        axes.legend(fontsize=8)
    path = options.folder / "slicing.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    sheets = [Path(result["sheet"])] if "sheet" in result else []
    return [path, half_angle.draw(result["half_angle"], path.with_name("half-angle.png")), *sheets]
