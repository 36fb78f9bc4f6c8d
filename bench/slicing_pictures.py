"""The pictures of the suite "slicing": what its figures are of, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

_GAIN = 20.0  # of differences


def slicing_sheet(bench: Any, light: Any, path: Path) -> Path:
    """Rows: popping, narrow peaks, frame buffers of few bits, and shadows. ``bench`` is the suite's, ``light`` that of
    half angles."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = (_popping(bench), _peaks(bench), _buffers(bench), _lights(light))
    figure = Figure(figsize=(13, 13.6), dpi=90, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, shown in zip(figure.subplots(len(rows), 4), rows):
        for ax, (title, rgb) in zip(axes, shown):
            ax.imshow(_displayed(rgb), interpolation="nearest")
            ax.set_title(title, fontsize=9)
            ax.set_axis_off()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


def _popping(bench: Any) -> list[tuple[str, np.ndarray]]:
    shown = {}
    for geometry in ("object-aligned", "view-aligned"):
        sides = [
            bench.frame("engine-smooth", bench.around(angle), {"geometry": geometry}, classification="post").rgba
            for angle in (44.95, 45.05)
        ]
        shown[geometry] = sides, _GAIN * np.abs(sides[0] - sides[1])
    stacks, jump = shown["object-aligned"]
    return [
        ("planes of voxels, 44.95°", stacks[0]), ("45.05°", stacks[1]),
        (f"their difference x {_GAIN:g}", jump),
        (f"planes across the view: difference x {_GAIN:g}", shown["view-aligned"][1]),
    ]  # fmt: skip


def _peaks(bench: Any) -> list[tuple[str, np.ndarray]]:
    camera = bench.around(20.0)
    shown = []
    for slices, classification in ((64, "post"), (64, "preintegrated"), (512, "post"), (512, "preintegrated")):
        slicing = {"geometry": "view-aligned", "slices": slices}
        name = "midpoints" if classification == "post" else "pre-integrated slabs"
        rgba = bench.frame("engine-peaks", camera, slicing, classification=classification).rgba
        shown.append((f"{slices} slices, {name}", rgba))
    return shown


def _buffers(bench: Any) -> list[tuple[str, np.ndarray]]:
    camera = bench.around(20.0)
    shown = []
    for slices, accumulate in ((1024, "float32"), (1024, "half"), (1024, "uint8"), (128, "uint8")):
        slicing = {"geometry": "view-aligned", "slices": slices, "accumulate": accumulate}
        rgba = bench.frame("engine-smooth", camera, slicing, classification="post").rgba
        shown.append((f"{slices} slices, {accumulate}", rgba))
    return shown


def _lights(light: Any) -> list[tuple[str, np.ndarray]]:
    scattering = {"scattering": 0.8, "scatter_color": [0.9, 0.6, 0.4], "cone_degrees": 40.0}
    rays, slices = light.picture("rays"), light.picture("middle")
    return [
        ("shadow rays", 2.0 * rays), ("half-angle slices", 2.0 * slices),
        (f"their difference x {_GAIN:g}", _GAIN * np.abs(rays - slices)),
        ("half-angle slices, scattering, from behind", 2.0 * light.picture("middle", 130.0, **scattering)),
    ]  # fmt: skip


def _displayed(rgba: np.ndarray) -> np.ndarray:
    """sRGB over black."""
    linear = np.clip(rgba[..., :3], 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
