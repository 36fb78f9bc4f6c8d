"""tradeoff.png: a self-contained chart of error against time."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from clvol.accuracy.report import wording
from clvol.accuracy.report.label_layout import Label, LogAxis, place_labels
from clvol.accuracy.report.svg import error_ticks, name_order, point_name, ranges
from clvol.accuracy.report.sweep import Point, Sweep, plottable, time_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

COLORS = ("#2f6db3", "#c8641b", "#2f8f6b", "#8a55b5", "#b5475c", "#8a7a1f", "#3d8fa8", "#6b6f76")
_INK, _MUTED, _GRID = "#1d1d1f", "#6b6b70", "#e7e6e2"
_WIDTH, _HEIGHT, _DOTS = 1680, 1050, 150
_SIDES = {"start": "left", "middle": "center", "end": "right"}


def tradeoff_chart(sweep: Sweep) -> bytes:
    """A PNG of 1680 x 1050 pixels that shows all points. The front is connected and labelled, the scene's own settings
    are ringed, and bars reach from the fastest to the slowest frame."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH / _DOTS, _HEIGHT / _DOTS), dpi=_DOTS, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.075, 0.09, 0.9, 0.745))
    shown = [p for p in sweep.points if plottable(p)]
    exact = any(p["rmse"] == 0 for p in shown)
    times, errors = ranges(sweep, before=0.2)
    floor = errors[0]
    if exact:  # a lane below the axis for points without error, which a logarithmic axis cannot show
        errors = (errors[0] * (errors[0] / errors[1]) ** 0.1, errors[1])
    zero = (errors[0] * floor) ** 0.5
    _axes(axes, times, errors, floor, zero if exact else None, all(p["rmse"] == 0 for p in shown))

    def at(point: Point) -> tuple[float, float]:
        return time_of(point), point["rmse"] or zero

    tunable = sweep.color_tunable()
    front = [p for p in sweep.front if plottable(p)]
    baseline = sweep.baseline if plottable(sweep.baseline) else None
    named = [*front, *([baseline] if baseline and baseline not in front else [])]

    def color(point: Point) -> str:
        return COLORS[sweep.color_class(point, tunable) % len(COLORS)]

    for point in shown:
        important = point in named
        x, y = at(point)
        low, high = (point["seconds"].get(key) or x for key in ("min", "max"))
        if low > 0:
            axes.plot([low, high], [y, y], color=_MUTED, linewidth=1.0 if important else 0.6,
                      alpha=0.7 if important else 0.25, solid_capstyle="butt", zorder=2)
        axes.plot([x], [y], "o", color=color(point), markersize=7 if important else 4.5,
                  markeredgecolor="white" if important else "none", markeredgewidth=0.8,
                  alpha=1 if important else 0.4, zorder=5 if important else 3)
    if len(front) > 1:
        axes.plot(*zip(*map(at, front)), color=_INK, linewidth=1.3, zorder=4)
    if baseline:
        axes.plot(*[[v] for v in at(baseline)], "o", markersize=12, markerfacecolor="none",
                  markeredgecolor=_INK, markeredgewidth=1.2, zorder=6)
    stream = io.BytesIO()
    with warnings.catch_warnings():  # a name may contain letters that the font lacks
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        _name_points(axes, canvas, sweep, named, front, baseline, shown, at)
        _words(figure, axes, sweep, tunable, color)
        canvas.print_png(stream)
    return stream.getvalue()


def _axes(
    axes: Axes,
    times: tuple[float, float],
    errors: tuple[float, float],
    floor: float,
    zero: float | None,
    only_zero: bool,
) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(times)
    axes.set_ylim(errors)
    x, y = LogAxis(*times, 0, 1), LogAxis(floor, errors[1], 0, 1)
    y_ticks = [] if only_zero else y.ticks(8)
    axes.xaxis.set_major_locator(FixedLocator(x.ticks(9)))
    axes.xaxis.set_minor_locator(FixedLocator(x.minor()))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: wording.seconds(v, 2)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_minor_locator(NullLocator())
    texts = error_ticks(y_ticks)
    axes.set_yticks([*y_ticks, zero] if zero else y_ticks, [*texts, "0"] if zero else texts)
    if zero:
        axes.axhline(floor, color=_MUTED, linewidth=0.8, linestyle=(0, (2, 3)), zorder=1)
    axes.grid(True, which="major", color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(_MUTED)
    axes.tick_params(which="both", color=_MUTED, labelcolor=_INK, labelsize=9)
    axes.set_xlabel("time per frame, median", loc="right", fontsize=9.5, color=_INK)
    axes.annotate("error (RMSE of linear RGBA)", (0, 1), (-70, 8), xycoords="axes fraction",
                  textcoords="offset pixels", fontsize=9.5, color=_INK)


def _name_points(
    axes: Axes,
    canvas: FigureCanvasAgg,
    sweep: Sweep,
    named: list[Point],
    front: list[Point],
    baseline: Point | None,
    shown: list[Point],
    at: Callable[[Point], tuple[float, float]],
) -> None:
    """Labels the points where there is room."""
    renderer = canvas.get_renderer()
    height = canvas.get_width_height()[1]
    style: dict[str, Any] = {"fontsize": 8.5, "parse_math": False, "color": _INK}

    def pixels(point: Point) -> tuple[float, float]:
        x, y = axes.transData.transform(at(point))
        return x, height - y

    def bar(point: Point) -> tuple[float, float, float, float]:
        x, y = pixels(point)
        ends = [point["seconds"].get(key) or time_of(point) for key in ("min", "max")]
        left, right = (axes.transData.transform((v, at(point)[1]))[0] for v in ends)
        return left, y, right, y

    labels = []
    for point in name_order(sweep, named, baseline):
        text = point_name(point, baseline, 48)
        sample = axes.text(0, 0, text, transform=None, **style)
        extent = sample.get_window_extent(renderer)
        sample.remove()
        size = extent.width, extent.height + 4
        labels.append(Label(str(point["id"]), text, *pixels(point), *size))
    box = axes.get_window_extent(renderer)
    frame = (box.x0 + 8, height - box.y1, box.x1, height - box.y0 - 6)
    places = [pixels(p) for p in front]
    placed = place_labels(
        labels, frame, [(*pixels(p), 14 if p is baseline else 9) for p in named],
        [(*a, *b) for a, b in zip(places, places[1:])],
        [pixels(p) for p in shown if p not in named], [bar(p) for p in shown], unit=1.5,
    )
    from matplotlib.lines import Line2D
    from matplotlib.patheffects import withStroke

    for p in placed:
        if p.leader:
            axes.add_artist(Line2D([p.label.x, p.end_x], [height - p.label.y, height - p.end_y],
                                   transform=None, color=_MUTED, linewidth=0.7, zorder=4.5))
        axes.text(p.x, height - p.y, p.label.text, transform=None, zorder=8,
                  va="center_baseline", ha=_SIDES[p.anchor],
                  path_effects=[withStroke(linewidth=2.5, foreground="white", alpha=0.85)], **style)


def _words(
    figure: Figure, axes: Axes, sweep: Sweep, tunable: dict[str, Any] | None, color: Callable[[Point], str]
) -> None:
    """Adds the title, a line on what was measured, and the legend."""
    from matplotlib.lines import Line2D

    scene, machine = sweep.result["scene"], sweep.result["machine"]
    left = 0.03
    figure.text(left, 0.945, wording.shorten(f"{sweep.name}: what accuracy costs in time", 80),
                fontsize=15, color=_INK, parse_math=False, family="serif")
    parts = [
        f"{scene['width']} × {scene['height']} pixels",
        f"{machine['device_name']}, {machine['cores']} cores",
        f"median of {sweep.result['method']['frames']} frames, bars: fastest to slowest",
        f"error against the {wording.judged_by(sweep.result)}",
    ]
    figure.text(left, 0.908, wording.shorten(", ".join(parts), 170), fontsize=8.5, color=_MUTED,
                parse_math=False)
    dot: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 6, "markeredgecolor": "none"}
    handles = []
    if tunable is not None:
        for i, value in enumerate(sweep.values(tunable["name"])):
            text = wording.setting(value)
            text = f"{tunable['title']}: {text}" if i == 0 else text
            handles.append(Line2D([], [], color=COLORS[i % len(COLORS)], label=_plain(text), **dot))
    handles.append(Line2D([], [], color=_INK, linewidth=1.3,
                          label="nothing is faster and as exact"))
    handles.append(Line2D([], [], linestyle="", marker="o", markersize=10, markerfacecolor="none",
                          markeredgecolor=_INK, label="your scene's settings"))
    legend = axes.legend(
        handles=handles, loc="upper right", bbox_to_anchor=(1.0, 1.085), ncols=len(handles),
        frameon=False, fontsize=8.5, handletextpad=0.5, columnspacing=1.6, borderpad=0.2,
    )
    for entry in legend.get_texts():
        entry.set_color(_INK)
        entry.set_parse_math(False)


def _plain(text: str) -> str:
    """``text`` shortened, without leading underscores, which would hide it from the legend."""
    return wording.shorten(text, 28).lstrip("_") or " "
