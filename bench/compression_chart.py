"""The chart of rate against distortion: bench/compression.png."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.charts import _GOAL, _grid, _notes, _plain_log, _plt, _save
from bench.compression_scenes import CODED_SCENES

# curve: (label, colour, marker, line style)
CURVES = {
    "rvq, rate": ("rvq, rate or PSNR asked for", "#1667b0", "o", "-"),
    "rvq, bound": ("rvq, largest error asked for", "#1667b0", "D", "--"),
    "sz3, bound": ("SZ3, largest error asked for", "#d0812a", "s", "--"),
    "zfp, accuracy": ("zfp, fixed accuracy", "#6b7785", "^", "--"),
    "zfp, rate": ("zfp, fixed rate", "#a9b3bd", "v", "-"),
    "hvq": ("hvq (Schneider and Westermann 2003)", "#5a9e4b", "P", ""),
    "vq-mean": ("vq-mean", "#5a9e4b", "X", ""),
    "vq": ("vq (Engel and Ertl 2002)", "#5a9e4b", "*", ""),
}
# key of a row: (label of the axis, factor, logarithmic)
PANELS = {
    "psnr": ("PSNR of the voxels, dB", 1.0, False),
    "largest": ("largest error of a voxel, % of the range", 100.0, True),
    "delta_e": ("mean CIEDE2000 of the picture", 1.0, True),
}


def rate_chart(result: dict[str, Any], path: Path) -> Path:
    """PSNR, largest error and the picture's mean CIEDE2000 over bits per voxel, a column per volume."""
    plt = _plt()
    names = list(dict.fromkeys(row["volume"] for row in result["rates"]))
    figure, axes = plt.subplots(3, len(names), figsize=(1.0 + 3.3 * len(names), 9.6), squeeze=False, sharex="col")
    drawn = set()
    for column, name in zip(axes.T, names):
        rows = [row for row in result["rates"] if row["volume"] == name]
        for axis, (key, (label, factor, logarithmic)) in zip(column, PANELS.items()):
            for curve, (_, color, marker, style) in CURVES.items():
                points = curve_points(rows, curve, key, factor, logarithmic)
                if not points:
                    continue
                drawn.add(curve)
                axis.plot(*zip(*points), color=color, marker=marker, linestyle=style or "none", linewidth=1.5,
                          markersize=7 if not style else 4.5, zorder=3 if curve.startswith("rvq") else 2)
            axis.set_xscale("log")
            if logarithmic:
                axis.set_yscale("log")
            _plain_log(axis, y=logarithmic)
            _grid(axis)
            if axis is column[0]:
                axis.set_title(name)
                _goal(axis, name)
            if axis is column[-1]:
                axis.set_xlabel("bits per voxel")
            if name == names[0]:
                axis.set_ylabel(label)
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=color, marker=marker, linestyle=style or "none", label=label)
        for curve, (label, color, marker, style) in CURVES.items() if curve in drawn
    ]  # fmt: skip
    if any(scene.goal and scene.name in names for scene in CODED_SCENES):
        handles.append(Line2D([], [], color=_GOAL, marker="+", markersize=11, linestyle="none", label="goal"))
    figure.legend(handles=handles, loc="outside upper left", ncols=max(1, len(names) - 1), fontsize=9)
    return _save(plt, figure, path, _notes(result))


def curve_points(
    rows: list[dict[str, Any]], curve: str, key: str, factor: float, logarithmic: bool
) -> list[tuple[float, float]]:
    """(bits per voxel, value) of what an axis can show, by rising rate. What "rvq" does for a PSNR lies on the curve of
    its rates."""
    names = (curve, "rvq, psnr") if curve == "rvq, rate" else (curve,)
    found = sorted((row["bits"], factor * row[key]) for row in rows if row["curve"] in names and row[key] is not None)
    return [(bits, value) for bits, value in found if value > 0 or not logarithmic]


def _goal(axis: Any, name: str) -> None:
    goal = next(scene.goal for scene in CODED_SCENES if scene.name == name)
    if goal is not None:
        axis.plot(*goal, "+", color=_GOAL, markersize=13, markeredgewidth=2, zorder=4)
