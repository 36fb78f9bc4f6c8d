"""Charts of the results, as PNG."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_VTK, _CLVOL, _GOAL = "#8d99a6", "#1667b0", "#c0392b"
_SHADES = ("#1667b0", "#7fb2e0", "#0b3c6b", "#b9d4ee")


def _plt():
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({
        "font.size": 10,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.titlesize": 11,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "legend.frameon": False,
        "figure.constrained_layout.use": True,
    })
    return plt


def _save(plt, figure, path: Path, notes: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.supxlabel(notes, fontsize=8, color="#666666", x=0.01, ha="left")
    figure.savefig(path, dpi=150)
    plt.close(figure)
    return path


def _grid(axis) -> None:
    """Faint lines behind all that is drawn."""
    axis.grid(True, which="major", color="#e6e6e6", linewidth=0.6)
    axis.set_axisbelow(True)


def _plain_log(axis, *, x: bool = True, y: bool = True) -> None:
    """Ticks at 1, 2, 5 of each decade where there are few, written as numbers; powers elsewhere."""
    from matplotlib.ticker import FuncFormatter, LogFormatterSciNotation, LogLocator, NullFormatter

    for wanted, one, limits in ((x, axis.xaxis, axis.get_xlim()), (y, axis.yaxis, axis.get_ylim())):
        if not wanted:
            continue
        few = limits[1] / limits[0] < 100
        one.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
        small = 1e-3 <= limits[0] and limits[1] < 1e5
        one.set_major_formatter(
            FuncFormatter(lambda v, _: f"{v:g}") if small else LogFormatterSciNotation()
        )
        one.set_minor_formatter(NullFormatter())


def _notes(result: dict[str, Any]) -> str:
    found = result["machine"]
    parts = [found["processor"], f"{found['cores']} cores"]
    if "device" in found:
        parts.append(found["device"]["platform"])
    if "vtk" in result:
        parts.append(f"VTK {result['vtk']}")
    if found["commit"]:
        parts.append(f"commit {found['commit']}")
    return ", ".join(parts) + (", QUICK RUN: no result" if result.get("quick") else "")


def ratio_chart(result: dict[str, Any], path: Path) -> Path:
    """How many times as fast as VTK: at the same step, and at the same error."""
    plt = _plt()
    scenes = result["scenes"]
    names = list(dict.fromkeys(s["scene"] for s in scenes))
    sizes = sorted({s["size"] for s in scenes})
    figure, axes = plt.subplots(1, 2, figsize=(10, 1.2 + 0.75 * len(names)), sharey=True)
    panels = (
        ("ratio", "Same step (1 voxel)", 3.0),
        ("ratio_at_vtk_error", "Same error (of VTK's rays at step 1)", 8.0),
    )
    thickness = 0.8 / len(sizes)
    for axis, (key, title, goal) in zip(axes, panels):
        for j, size in enumerate(sizes):
            for i, name in enumerate(names):
                found = [s for s in scenes if s["scene"] == name and s["size"] == size]
                value = found[0]["headline"][key] if found else None
                y = i + (j - (len(sizes) - 1) / 2) * thickness
                label = f"{size} × {size} pixels" if i == 0 else None
                axis.barh(y, value or 0.0, thickness * 0.92, color=_SHADES[j % 4], label=label)
                text = "not reached" if found and value is None else f"{value:.1f}" if found else ""
                if found and key != "ratio" and found[0]["headline"]["clvol_to_vtk_error"][
                        "kind"] == "at most":
                    text = "≥ " + text
                axis.annotate(text, (value or 0.0, y), (3, 0), textcoords="offset points",
                              va="center", fontsize=8)
        axis.axvline(goal, color=_GOAL, linewidth=1.2)
        axis.annotate(f"{goal:g}×", (goal, 1.0), (2, 1), xycoords=("data", "axes fraction"),
                      textcoords="offset points", color=_GOAL, fontsize=9)
        axis.set_title(title, pad=14)
        axis.set_xlabel("VTK's seconds / clvol's")
        axis.set_xlim(0, None)
        axis.margins(x=0.12)
    summaries = {s["scene"]: s["summary"] for s in scenes}
    axes[0].set_yticks(range(len(names)), [f"{n}\n{summaries[n]}" for n in names])
    axes[0].invert_yaxis()
    for axis in axes:
        axis.tick_params(axis="y", length=0)
    if len(sizes) > 1:
        axes[1].legend(loc="lower right", fontsize=9)
    return _save(plt, figure, path, _notes(result))


def _step_curve(
    axis, points: list[dict], color: str, marker: str, named: Sequence[float] | None = None
) -> None:
    """Error against time over steps, with the ``named`` steps (all, if None) written beside."""
    points = sorted(points, key=lambda p: -p["step"])
    x, y = [1e3 * p["seconds"] for p in points], [p["rmse"] for p in points]
    axis.loglog(x, y, color=color, marker=marker, markersize=4.5, linewidth=1.5, zorder=2)
    for p in points:
        if named is None or p["step"] in named:
            axis.annotate(f"{p['step']:g}", (1e3 * p["seconds"], p["rmse"]), (5, 3),
                          textcoords="offset points", fontsize=8, color=color)


def error_time_chart(result: dict[str, Any], size: int, path: Path) -> Path:
    """Error against time over steps, one panel a scene."""
    plt = _plt()
    scenes = [s for s in result["scenes"] if s["size"] == size]
    columns = min(3, len(scenes) + 1)
    rows = -(-(len(scenes) + 1) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(3.9 * columns, 3.2 * rows), squeeze=False)
    panels = list(axes.flat)
    for axis, s in zip(panels, scenes):
        for key, color, marker in (("vtk", _VTK, "s"), ("clvol", _CLVOL, "o")):
            _step_curve(axis, s[key], color, marker, (8.0, 2.0, 1.0, 0.1, 0.125))
        points = sorted(s["vtk"], key=lambda p: -p["step"])
        x, y = [1e3 * p["seconds"] for p in points], [p["window_rmse"] for p in points]
        axis.loglog(x, y, color=_VTK, marker="s", markersize=3.5, markerfacecolor="white",
                    linewidth=0.9, alpha=0.8)
        axis.axhline(s["headline"]["vtk_rmse"], color=_VTK, linewidth=0.8, linestyle=":")
        axis.set_title(f"{s['scene']}: {s['summary']}\nclvol: {s['classification']}", fontsize=9)
        _grid(axis)
        axis.set_xlabel("milliseconds a frame")
        axis.set_ylabel("RMSE")
        _plain_log(axis)
    for axis in panels[len(scenes):]:
        axis.axis("off")
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=_VTK, marker="s", label=f"VTK {result['vtk']}, fixed-point ray cast"),
        Line2D([], [], color=_VTK, marker="s", markerfacecolor="white", linewidth=0.9,
               label="the same, as drawn in its window"),
        Line2D([], [], color=_CLVOL, marker="o", label="clvol"),
        Line2D([], [], color=_VTK, linestyle=":", label="error of VTK's rays at step 1"),
        Line2D([], [], linestyle="", label=f"{size} × {size} pixels; numbers: step in voxels"),
        Line2D([], [], linestyle="", label="RMSE of linear RGBA against the exact integral"),
    ]
    panels[len(scenes)].legend(handles=handles, loc="center left", fontsize=9)
    return _save(plt, figure, path, _notes(result))


def tradeoff_chart(result: dict[str, Any], path: Path) -> Path:
    """Error against time: everything that was tried, the front, and VTK's curve."""
    plt = _plt()
    scenes = result["scenes"]
    columns = min(4, len(scenes) + 1)
    rows = -(-(len(scenes) + 1) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(3.6 * columns, 3.3 * rows), squeeze=False)
    panels = list(axes.flat)
    for axis, s in zip(panels, scenes):
        tried = [(1e3 * t, e) for t, e in s["all"] if e]
        axis.loglog(*zip(*tried), ".", color=_SHADES[3], markersize=3.5, zorder=1)
        front = [(1e3 * p["seconds"], p["rmse"]) for p in s["front"] if p["rmse"] > 0]
        axis.loglog(*zip(*front), "o-", color=_CLVOL, markersize=4.5, linewidth=1.6, zorder=3)
        own = s["baseline"]
        axis.loglog(1e3 * own["seconds"]["median"], own["rmse"], "D", color=_CLVOL, zorder=4,
                    markerfacecolor="white", markersize=6)
        if s["vtk"]:
            _step_curve(axis, s["vtk"], _VTK, "s")
        axis.set_title(f"{s['scene']}, {s['size']}\u00b2")
        _grid(axis)
        axis.set_xlabel("milliseconds a frame")
        axis.set_ylabel("RMSE")
        _plain_log(axis)
    for axis in panels[len(scenes):]:
        axis.axis("off")
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=_CLVOL, marker="o", label="clvol: the best settings found"),
        Line2D([], [], color=_SHADES[3], marker=".", linestyle="", label="all settings tried"),
        Line2D([], [], color=_CLVOL, marker="D", markerfacecolor="white", linestyle="",
               label="the scene's own settings"),
        Line2D([], [], color=_VTK, marker="s",
               label=f"VTK {result['vtk']}, fixed-point ray cast,\nsteps in voxels"),
        Line2D([], [], linestyle="", label="RMSE of linear RGBA against the exact integral"),
    ]
    panels[len(scenes)].legend(handles=handles, loc="center left", fontsize=9)
    return _save(plt, figure, path, _notes(result))


def ladder_chart(result: dict[str, Any], path: Path) -> Path:
    """Nanoseconds a sample and core of the inner loop's parts."""
    plt = _plt()
    scenes = result["scenes"]
    figure, axes = plt.subplots(
        1, len(scenes), figsize=(1.5 + 4.3 * len(scenes), 2.9), sharey=True, squeeze=False
    )
    for axis, s in zip(axes[0], scenes):
        names = [r["name"] for r in s["rungs"]]
        values = [r["ns_a_sample_and_core"] for r in s["rungs"]]
        colors = [_VTK, _SHADES[3], _SHADES[1], _SHADES[0]]
        axis.barh(range(len(names)), values, 0.7, color=colors)
        for i, value in enumerate(values):
            axis.annotate(f"{value:.2f}", (value, i), (3, 0), textcoords="offset points",
                          va="center", fontsize=9)
        axis.set_yticks(range(len(names)), names)
        axis.tick_params(axis="y", length=0)
        axis.set_title(s["scene"])
        axis.set_xlabel("ns a sample and core")
        axis.margins(x=0.15)
    axes[0][0].invert_yaxis()
    return _save(plt, figure, path, _notes(result))


def stack_chart(result: dict[str, Any], names: Sequence[str], path: Path) -> Path:
    """Processor time of a frame by what it is spent on, a bar per scene. ``names``: of the parts, in their order."""
    plt = _plt()
    scenes = result["scenes"]
    figure, axis = plt.subplots(figsize=(9, 1.6 + 0.55 * len(scenes)))
    lefts = [0.0] * len(scenes)
    for name, color in zip(names, plt.get_cmap("tab10").colors):
        values = [1e3 * s["parts"][name] for s in scenes]
        axis.barh(range(len(scenes)), values, 0.7, left=lefts, color=color, label=name)
        lefts = [left + value for left, value in zip(lefts, values)]
    axis.set_yticks(range(len(scenes)), [f"{s['scene']} ({s['classification']})" for s in scenes])
    axis.tick_params(axis="y", length=0)
    axis.invert_yaxis()
    axis.set_xlabel("ms of processor time per frame")
    axis.legend(fontsize=8, ncols=3, loc="upper center", bbox_to_anchor=(0.4, -0.32))
    return _save(plt, figure, path, _notes(result))


def scaling_chart(result: dict[str, Any], path: Path) -> Path:
    """Seconds against samples over two sweeps, and seconds a sample over each."""
    plt = _plt()
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.9))
    labels = {"volume": "volume edge (voxels)", "image": "image edge (pixels)"}
    every: list[Sequence[float]] = []
    for key, color, marker in zip(labels, (_CLVOL, "#d0812a"), "os"):
        points = result[key]
        x, y = [p["samples"] / 1e6 for p in points], [p["seconds"] for p in points]
        every += list(zip(x, y))
        edges = [p["edge"] for p in points]
        label = labels[key]
        left.loglog(x, y, color=color, marker=marker, label=f"{label} {edges[0]} to {edges[-1]}")
        right.semilogx(edges, [p["ns_a_sample_and_core"] for p in points], color=color,
                       marker=marker, label=label, base=2)
    x = [min(e[0] for e in every), max(e[0] for e in every)]
    share = sorted(e[1] / e[0] for e in every)[len(every) // 2]
    left.loglog(x, [v * share for v in x], color="#999999", linewidth=0.9, linestyle="--",
                label="proportional", zorder=0)
    _plain_log(left)
    left.set_xlabel("million samples a frame")
    left.set_ylabel("seconds a frame")
    left.set_title("Time against samples")
    left.legend(fontsize=9)
    right.set_xlabel("edge")
    right.set_ylabel("ns a sample and core")
    right.set_ylim(0, None)
    right.set_title("Cost of a sample")
    right.legend(fontsize=9)
    edges = sorted({p["edge"] for key in labels for p in result[key]})
    right.set_xticks(edges, list(map(str, edges)))
    right.minorticks_off()
    for axis in (left, right):
        _grid(axis)
    return _save(plt, figure, path, _notes(result))


def convergence_chart(result: dict[str, Any], path: Path) -> Path:
    """Error against h, one panel a row, all to the same scale: the same order has the same slope
    everywhere. From the coarsest error, where orders 1, 2 and 3 would lead."""
    plt = _plt()
    axis_labels = {
        "step": "step", "grid": "voxel edge",
        "pixel": "pixel edge / picture edge",
    }  # fmt: skip
    rows = result["rows"]
    columns = min(5, len(rows) + 1)
    lines = -(-(len(rows) + 1) // columns)
    figure, axes = plt.subplots(
        lines, columns, figsize=(2.95 * columns, 2.75 * lines), squeeze=False
    )
    panels = list(axes.flat)
    octaves, decades = 5.6, 4.6
    for axis, r in zip(panels, rows):
        h, errors = r["h"], r["errors"]
        fine = h[0] / 2**5
        for order in (1.0, 2.0, 3.0):
            expected = order == r["expected"]
            end = errors[0] * 2 ** (-5 * order)
            axis.loglog((h[0], fine), (errors[0], end), linestyle="--", zorder=1,
                        color=_GOAL if expected else "#c8c8c8", linewidth=1.2 if expected else 0.8)
            axis.annotate(f"{order:g}", (fine, end), (-2, 0), textcoords="offset points",
                          ha="right", va="center", fontsize=8,
                          color=_GOAL if expected else "#999999")
        axis.loglog(h, errors, color=_CLVOL, marker="o", markersize=4.5, linewidth=0.8)
        if r["floor"] > 0:
            axis.axhline(r["floor"], color=_VTK, linewidth=0.9, linestyle=":")
        axis.set_title(textwrap.fill(r["title"], 34) + "\n", fontsize=9, pad=3)
        found = "DEPARTS: " if r["departure"] else ""
        axis.annotate(
            f"{found}order {r['observed']:.2f}, theory {r['expected']:g}", (0.0, 1.0), (0, 4),
            xycoords="axes fraction", textcoords="offset points", fontsize=9,
            color=_GOAL if r["departure"] else "#333333",
        )  # fmt: skip
        axis.set_xlabel(axis_labels[r["refined"]], fontsize=8.5)
        axis.tick_params(labelsize=8)
        axis.set_xscale("log", base=2)
        axis.set_xlim(h[0] / 2**octaves, h[0] * 2**0.3)
        axis.set_ylim(errors[0] / 10**decades, errors[0] * 10**0.3)
        axis.grid(True, which="major", color="#eeeeee", linewidth=0.6)
        axis.set_axisbelow(True)
    for axis in panels[len(rows):]:
        axis.axis("off")
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=_CLVOL, marker="o", markersize=4.5, label="RMS error"),
        Line2D([], [], color=_GOAL, linestyle="--", label="the order that theory expects"),
        Line2D([], [], color="#c8c8c8", linestyle="--", label="other orders"),
        Line2D([], [], color=_VTK, linestyle=":", label="floor: rounding"),
    ]
    panels[len(rows)].legend(handles=handles, loc="center left", fontsize=9)
    return _save(plt, figure, path, _notes(result))


_GROUPS = {
    "light": "#d0812a", "filter": "#1667b0", "surface": "#5b8c3a", "environment": "#8e5fb0",
    "shadow": "#5c5c5c", "opacity": "#c0568a", "field": "#2a9d9d", "clip": "#a08a3c",
    "noise": "#7a6a5a", "compositing": "#4f74c8", "together": "#333333", "unused": "#9aa5b1",
}  # fmt: skip


def effects_chart(result: dict[str, Any], path: Path) -> Path:
    """What each effect costs: time beside samples, a pair of panels a scene, in groups of effects;
    a diamond where the effect that one is built on lies."""
    plt = _plt()
    scenes = result["scenes"]
    labels, places = _effect_places(scenes[0]["rows"])
    figure, axes = plt.subplots(
        1, 2 * len(scenes), figsize=(2.2 + 5.4 * len(scenes), 1.6 + 0.235 * max(places)),
        sharey=True, squeeze=False, gridspec_kw={"width_ratios": [1.9, 1.0] * len(scenes)},
    )  # fmt: skip
    for s, time, samples in zip(scenes, axes[0][::2], axes[0][1::2]):
        rows = [*s["rows"], _unused_row(s)]
        for row, y in zip(rows, places):
            _effect_bars(row, y, time, samples)
        for axis, title in ((time, f"{s['scene']}: time of a frame"), (samples, "samples")):
            axis.set_xscale("log")
            axis.axvline(1.0, color="#333333", linewidth=0.9, zorder=3)
            axis.set_title(title)
            axis.set_xlabel("times the plain scene's")
            axis.grid(True, axis="x", which="major", color="#e6e6e6", linewidth=0.6)
            axis.set_axisbelow(True)
            axis.tick_params(axis="y", length=0)
    for alike in (axes[0][::2], axes[0][1::2]):  # one scale for times, one for samples
        limits = [axis.get_xlim() for axis in alike]
        for axis in alike:
            axis.set_xlim(0.85 * min(0.5, *(low for low, _ in limits)),
                          1.7 * max(2.0, *(high for _, high in limits)))
            _plain_log(axis, y=False)
            axis.minorticks_off()
    first = axes[0][0]
    first.set_yticks(places, labels, fontsize=9)
    first.set_ylim(max(places) + 0.7, -0.7)
    size = result["size"]
    notes = (
        f"{size} × {size} pixels, step 1. Whiskers: both medians off by half their interquartile range."
        " Diamond: the effect that this one is built on.\n"
    )
    return _save(plt, figure, path, notes + _notes(result))


def _effect_places(rows: list[dict]) -> tuple[list[str], list[float]]:
    """The bars' labels and heights; half a bar's room between two groups, and the unused ones last."""
    labels, places, y, group = [], [], -1.0, None
    for row in (*rows, {"name": "stated without consequence", "group": "unused"}):
        y += 1.0 if group in (None, row["group"]) else 1.5
        group = row["group"]
        labels.append(row["name"])
        places.append(y)
    return labels, places


def _unused_row(scene: dict[str, Any]) -> dict[str, Any]:
    """All effects without consequence together, as a row like an effect's."""
    unused = scene["unused"]
    if "time" not in unused:
        return {"group": "unused", "refused": "refused"}
    same = unused["cases"][-1]["samples"]
    return {"group": "unused", "plain": {**unused["time"], "samples": 1.0 if same else math.nan}}


def _effect_bars(row: dict[str, Any], y: float, time, samples) -> None:
    color = _GROUPS[row["group"]]
    if "refused" in row:
        time.annotate("refused", (1.0, y), (4, 0), textcoords="offset points", va="center",
                      fontsize=8, color="#999999")
        return
    plain = row["plain"]
    whiskers = [[plain["ratio"] - plain["low"]], [plain["high"] - plain["ratio"]]]
    time.barh(y, plain["ratio"] - 1.0, 0.74, left=1.0, color=color, zorder=2)
    time.errorbar(plain["ratio"], y, xerr=whiskers, color="#222222", linewidth=0.9, capsize=2,
                  zorder=4)
    below = plain["ratio"] / row["over"]["ratio"] if row.get("over") else 1.0
    if row.get("over"):  # what it is built on costs as much
        time.plot(below, y, "d", color="#ffffff", markersize=4.5,
                  markeredgecolor="#222222", markeredgewidth=0.8, zorder=5)
    samples.barh(y, plain["samples"] - 1.0, 0.74, left=1.0, color=color, alpha=0.55, zorder=2)
    for axis, value, end in (
        (time, plain["ratio"], max(plain["high"], below, 1.0)),
        (samples, plain["samples"], max(plain["samples"], 1.0)),
    ):
        axis.annotate(f"{value:.2f}" if value < 10 else f"{value:.0f}", (end, y), (4, 0),
                      textcoords="offset points", va="center", fontsize=8)


def crossover_chart(result: dict[str, Any], path: Path) -> Path:
    """Seconds over what a sample costs, one panel a scene: the plain ray caster and the method
    "pyramid", where they cross, and both with the cubic filter."""
    plt = _plt()
    parts, ways = result["crossover"], (("plain", _VTK, "s"), ("pyramid", _CLVOL, "o"))
    columns = min(3, len(parts) + 1)
    rows = -(-(len(parts) + 1) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(3.9 * columns, 3.2 * rows), squeeze=False)
    panels = list(axes.flat)
    for axis, part in zip(panels, parts):
        *dearer, cubic = part["rows"]
        for way, color, marker in ways:
            axis.loglog([r["cost"] for r in dearer], [r[way]["median"] for r in dearer],
                        color=color, marker=marker, markersize=4.5, linewidth=1.5, zorder=2)
            axis.loglog(cubic["cost"], cubic[way]["median"], color=color, marker=marker,
                        markersize=7, markerfacecolor="white", linestyle="", zorder=3)
        axis.set_title(f"{part['scene']}\n{_crossing(axis, part['crossing'])}", fontsize=9)
        _grid(axis)
        axis.set_xlabel("cost of a sample, times a plain one's")
        axis.set_ylabel("seconds a frame")
        _plain_log(axis)
    for axis in panels[len(parts):]:
        axis.axis("off")
    from matplotlib.lines import Line2D

    names = {"plain": "plain ray caster, leaps over empty space", "pyramid": "pyramid"}
    handles = [
        *(Line2D([], [], color=color, marker=marker, label=names[way]) for way, color, marker in ways),
        *(Line2D([], [], color=color, marker=marker, markersize=7, markerfacecolor="white",
                 linestyle="", label=f"{way}, cubic filter") for way, color, marker in ways),
        Line2D([], [], color=_GOAL, linestyle="--", label="from here on the pyramid is faster"),
        Line2D([], [], linestyle="", label=f"{result['size']} × {result['size']} pixels, step 1"),
    ]  # fmt: skip
    panels[len(parts)].legend(handles=handles, loc="center left", fontsize=9)
    return _save(plt, figure, path, _notes(result))


def _crossing(axis, found: dict[str, Any]) -> str:
    """Marks where the pyramid becomes faster; gives it in words."""
    if found["kind"] == "at most":
        return "pyramid faster below a plain sample's cost"
    if found["seconds"] is None:
        return "pyramid not faster at any cost tried"
    axis.axvline(found["seconds"], color=_GOAL, linewidth=1.2, linestyle="--", zorder=1)
    return f"pyramid faster from a cost of {found['seconds']:.2g} on"
