"""Half-angle slices (Kniss et al. 2003) beside the light volume and shadow rays, as a part of the suite "slicing": the
slices' distance, resolution of the light's buffer, the angle of the light with its switch at 90 degrees, light that
leaks past an opaque wall, scattering over the spacing, and time.

All pictures are of the engine, lit, but for the wall. Errors are against shadow rays at a step of 1/8; of angles, 1/4.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import table

SIZE, QUICK_SIZE = 128, 32
STEPS, QUICK_STEPS = (4.0, 2.0, 1.0, 0.5), (2.0, 1.0)
RESOLUTIONS, QUICK_RESOLUTIONS = (32, 64, 128, 256, 512), (32, 64)
ANGLES, QUICK_ANGLES = (0, 30, 60, 89.9, 90.1, 120, 150, 180), (0, 89.9, 90.1, 180)
AROUND_90 = 0.05  # degrees on either side
FINE_STEP, FINE_ANGLE_STEP, QUICK_FINE_STEP = 0.125, 0.25, 0.5  # of truths; those of many angles are coarser
BUFFER = 256  # texels of the light's buffer, where nothing else is said
LIGHT = {"ambient": 0.1, "diffuse": 0.9, "specular": 0.0}
SLANTED = 50.0  # degrees between the view and the light
WALLS, QUICK_WALLS = (1, 2, 4), (2,)  # voxels
WAYS = ("middle", "front", "light volume 64", "light volume 256", "rays")


def measure(bench: Any, quick: bool) -> dict[str, Any]:
    """``bench``: of the suite "slicing"."""
    light = LightBench(bench, quick)
    return {
        "size": light.size, "spacing": list(light.over_steps(QUICK_STEPS if quick else STEPS)),
        "resolution": list(light.over_resolutions(QUICK_RESOLUTIONS if quick else RESOLUTIONS)),
        "light_angles": list(light.over_angles(QUICK_ANGLES if quick else ANGLES)),
        "switch": list(light.across_the_switch((2.0, 1.0) if quick else STEPS)),
        "leakage": list(light.behind_walls(QUICK_WALLS if quick else WALLS)),
        "scattering": list(light.scattered(QUICK_STEPS if quick else STEPS)),
        "times": light.times(3 if quick else 7),
    }  # fmt: skip


class LightBench:
    def __init__(self, bench: Any, quick: bool) -> None:
        self.bench, self.size = bench, QUICK_SIZE if quick else SIZE
        self.quick = quick
        self.camera = bench.around(20.0)
        self._truths: dict[float, np.ndarray] = {}

    def light(self, degrees: float) -> dict[str, Any]:
        """A light that many degrees off the view, from the side and a little from above."""
        forward = np.subtract(self.camera["target"], self.camera["position"])
        forward = forward / np.linalg.norm(forward)
        across = np.cross(forward, [0.0, 1.0, 0.0])
        across = across / np.linalg.norm(across) - np.array([0.0, 0.4, 0.0])
        across = across - (across @ forward) * forward
        a = np.radians(degrees)
        direction = np.cos(a) * forward + np.sin(a) * across / np.linalg.norm(across)
        return {"type": "directional", "direction": direction.tolist()}

    def scene(self, way: str, degrees: float = SLANTED, step: float = 1.0, buffer: int = BUFFER, **shadow: Any) -> Any:
        """``way``: one of WAYS. ``shadow``: further keys of [shadow]."""
        from clvol import Light, Material, Shadow, Slicing

        by_slices = way in ("middle", "front")
        integration = {"classification": "post", "step": step, "step_error": 0.0}
        made = self.bench.scene("engine-smooth", self.camera, integration, {} if by_slices else None)
        image = made.image.model_copy(update={"width": self.size, "height": self.size})
        if by_slices:
            tables = {"slicing": Slicing(geometry="half-angle", light_at=way)}
            tables["shadow"] = Shadow(resolution=buffer, **shadow)
        elif way == "rays":
            tables = {"shadow": Shadow(method="rays", bound=0.0)}
        else:
            tables = {"shadow": Shadow(resolution=int(way.split()[-1]), **shadow)}
        lights = [Light(**self.light(degrees))]
        return made.model_copy(update={"light": lights, "material": Material(**LIGHT), "image": image, **tables})

    def picture(self, *asked: Any, **how: Any) -> np.ndarray:
        from clvol import Renderer

        with Renderer(self.scene(*asked, **how), devices=[self.bench.device]) as renderer:
            return renderer.render(depth=False).rgba

    def truth(self, degrees: float = SLANTED) -> np.ndarray:
        if degrees not in self._truths:
            fine = FINE_STEP if degrees == SLANTED else FINE_ANGLE_STEP
            self._truths[degrees] = self.picture("rays", degrees, QUICK_FINE_STEP if self.quick else fine)
        return self._truths[degrees]

    def error(self, way: str, degrees: float = SLANTED, **how: Any) -> float:
        return _rms(self.picture(way, degrees, **how), self.truth(degrees))

    def over_steps(self, steps: tuple[float, ...]) -> Iterator[dict[str, Any]]:
        """Slices as far apart, and steps of the eye's and of shadow rays."""
        for step in steps:
            yield {"step": step, **{way: self.error(way, step=step) for way in WAYS}}

    def over_resolutions(self, resolutions: tuple[int, ...]) -> Iterator[dict[str, Any]]:
        for n in resolutions:
            way = f"light volume {n}"
            yield {"resolution": n, "half-angle": self.error("middle", buffer=n), "light volume": self.error(way)}

    def over_angles(self, angles: tuple[float, ...]) -> Iterator[dict[str, Any]]:
        for angle in angles:
            ways = ("middle", "front", "light volume 64", "rays")
            yield {"angle": angle, **{way: self.error(way, angle) for way in ways}}

    def across_the_switch(self, steps: tuple[float, ...]) -> Iterator[dict[str, Any]]:
        """How far two pictures on either side of 90 degrees differ, and two as far apart beside it."""
        for step in steps:
            row = {"step": step}
            for name, middle in (("across", 90.0), ("beside", 80.0)):
                sides = [self.picture("middle", middle + turn, step=step) for turn in (-AROUND_90, AROUND_90)]
                row[name] = _rms(*sides)
            yield row

    def scattered(self, steps: tuple[float, ...]) -> Iterator[dict[str, Any]]:
        """How far a picture with all light scattered differs from one with none: of the cone's own directions, and of
        slices, which lies nearer to none the closer they are."""
        shadow = {"scattering": 1.0, "scatter_color": [0.0, 0.0, 0.0], "cone_degrees": 40.0}
        for step in steps:
            row = {"step": step}
            for way in ("middle", "light volume 64"):
                row[way] = _rms(self.picture(way, step=step, **shadow), self.picture(way, step=step))
            yield row

    def behind_walls(self, walls: tuple[int, ...]) -> Iterator[dict[str, Any]]:
        """Fog before an opaque wall, lit from behind at a slant: how much light there is, of that without the wall."""
        for thickness in walls:
            yield {"wall": thickness, **{way: _leaks(self.bench.device, way, thickness) for way in WAYS}}

    def times(self, frames: int) -> list[dict[str, Any]]:
        """Seconds of a picture of a camera that moves, medians in turns: the light of slices is found for each."""
        from clvol import Renderer

        rows = []
        with ExitStack() as stack:
            made = {way: stack.enter_context(Renderer(self.scene(way), devices=[self.bench.device])) for way in WAYS}
            seconds: dict[str, list[float]] = {way: [] for way in WAYS}
            for way in WAYS:
                made[way].render(depth=False)
            for _ in range(frames):
                for way in WAYS:
                    seconds[way].append(made[way].render(depth=False).stats["seconds"]["render"])
            for way in WAYS:
                stats = made[way].render(depth=False).stats
                rows.append({"way": way, "seconds": statistics.median(seconds[way]), "samples": stats["samples"],
                             "shadow_samples": stats["counters"].get("shadow_samples", 0)})  # fmt: skip
        return rows


def _leaks(device: Any, way: str, thickness: int) -> float:
    from clvol import Renderer, Scene, TransferFunction, Volume

    n = 64
    z, _, x = np.mgrid[:n, :n, :n]
    values = (n - x).astype(np.float32)  # fog whose gradient is across the view
    values[44 : 44 + thickness] += 500.0
    shares = []
    for opacity in (1.0, 0.0):
        function = TransferFunction([0, 300, 300, 999], [0.03, 0.03, opacity, opacity], [[1.0, 1.0, 1.0]] * 4)
        by_slices = way in ("middle", "front")
        shadow = {"method": "rays", "bound": 0.0} if way == "rays" else {"resolution": BUFFER}
        if "volume" in way:
            shadow = {"resolution": int(way.split()[-1])}
        scene = Scene(
            volume=Volume(values), transfer_function=function, image={"width": 24, "height": 24}, shadow=shadow,
            camera={"projection": "orthographic", "position": [31.5, 31.5, -90.0], "target": [31.5, 31.5, 31.5],
                    "up": [0.0, 1.0, 0.0], "height": 16.0},
            light=[{"type": "directional", "direction": [-0.35, 0.1, -1.0]}], material={**LIGHT, "ambient": 0.0},
            integration={"method": "slicing" if by_slices else "raycast", "classification": "post",
                         "early_termination": 0.0},
            **({"slicing": {"geometry": "half-angle", "light_at": way}} if by_slices else {}),
        )  # fmt: skip
        with Renderer(scene, devices=[device]) as renderer:
            shares.append(float(renderer.render(depth=False).rgba[..., :3].mean()))
    return shares[0] / shares[1]


def _rms(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.sqrt(np.mean((one - other) ** 2)))


# ---- report


def show(part: dict[str, Any]) -> list[str]:
    def errors(rows: list[dict[str, Any]]) -> str:
        names = list(rows[0])
        cells = [[row[names[0]], *(f"{row[name]:.5f}" for name in names[1:])] for row in rows]
        return table(names, cells)

    size = part["size"]
    return [
        f"Half-angle slices, {size} x {size} pixels, {BUFFER} texels: error over the slices' distance.\n"
        + errors(part["spacing"]),
        "Error over the resolution of the light's buffer, or of a light volume.\n" + errors(part["resolution"]),
        "Error over the angle between light and view.\n" + errors(part["light_angles"]),
        "Switch: RMSE between two pictures 0.1° apart, across 90° and at 80°, over the slices' distance.\n"
        + errors(part["switch"]),
        "Leakage: light on fog before an opaque wall (thickness in voxels) that is lit from behind, of that without"
        " the wall.\n" + errors(part["leakage"]),
        "Scattering: RMSE between all light scattered within 40° and none.\n" + errors(part["scattering"]),
        "Time: ms a frame (million samples of the eye's rays, of the light).\n"
        + table(
            ["way", "ms", "samples", "of light"],
            [[r["way"], f"{1e3 * r['seconds']:.1f}", f"{r['samples'] / 1e6:.2f}", f"{r['shadow_samples'] / 1e6:.2f}"]
             for r in part["times"]],
        ),
    ]  # fmt: skip


def draw(part: dict[str, Any], path: Path) -> Path:
    """Errors over the slices' distance, the buffer's resolution and the light's angle."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 3.8), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, rows, title, label in zip(
        figure.subplots(1, 3), (part["spacing"], part["resolution"], part["light_angles"]),
        ("over the slices' distance", "over the resolution of the light", "over the light's angle"),
        ("smallest voxel edges", "texels, or points", "degrees between light and view"),
    ):  # fmt: skip
        key, *columns = rows[0]
        for column in columns:
            axes.plot([r[key] for r in rows], [r[column] for r in rows], marker="o", ms=4, label=column)
        axes.set_yscale("log")
        if key != "angle":
            axes.set_xscale("log", base=2)
            axes.set_xticks([r[key] for r in rows], [str(r[key]) for r in rows])
        axes.set(title=f"shadows {title}", xlabel=label, ylabel="RMSE")
        axes.grid(True, color="#e6e6e6", linewidth=0.6)
        axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path
