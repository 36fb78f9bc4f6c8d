"""The plots of the page, as inline SVG that is coloured by the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Any

from clvol.accuracy.report import wording
from clvol.accuracy.report.label_layout import (
    Box,
    Label,
    LogAxis,
    Placed,
    limits,
    place_labels,
)
from clvol.accuracy.report.sweep import Point, Sweep, median, plottable, time_of

_TEXT = 12.0  # pixels
_LANE = 38.0  # pixels below the plot for points without error
_LONG = 40  # largest number of characters of a label
_FEW = 8  # largest number of labels of a narrow plot


def text_width(text: str, size: float = _TEXT) -> float:
    """The approximate width of ``text`` in pixels with common system fonts, rather too large."""
    widths = {**dict.fromkeys("ijl.,:;'|!()[] -/", 0.36), **dict.fromkeys("mwMW@%…—×", 0.92)}
    return size * sum(widths.get(c, 0.72 if c.isupper() else 0.58) for c in text)


def ranges(sweep: Sweep, before: float = 0.05) -> tuple[tuple[float, float], tuple[float, float]]:
    """The ranges of seconds and of RMSE that the plots show; a default range if there are no points."""
    points = [p for p in sweep.points if plottable(p)]
    times = limits([time_of(p) for p in points], before=before, after=0.06)
    errors = limits([p["rmse"] for p in points], before=0.07, after=0.07)
    return times or (1e-3, 1.0), errors or (1e-6, 1.0)


class Plot:
    """Axes of one plot in an SVG of ``width`` by ``height`` pixels."""

    def __init__(
        self, sweep: Sweep, width: float, height: float, margins: Box, before: float = 0.05
    ) -> None:
        """``margins``: left, top, right, bottom. ``before``: room on the side of the shortest time."""
        self.sweep, self.width, self.height = sweep, width, height
        left, top, right, bottom = margins
        self.frame = (left, top, width - right, height - bottom)
        times, errors = ranges(sweep, before)
        shown = [p for p in sweep.points if plottable(p)]
        self.lane = any(p["rmse"] == 0 for p in shown)
        self.only_lane = self.lane and all(p["rmse"] == 0 for p in shown)
        self.floor = self.frame[3] - (_LANE if self.lane else 0)
        self.x = LogAxis(*times, self.frame[0], self.frame[2])
        self.y = LogAxis(*errors, self.floor, self.frame[1])

    def at(self, point: Point) -> tuple[float, float]:
        """The position of a plottable point; points without error lie in the lane below the axis."""
        error = point["rmse"]
        y = self.frame[3] - _LANE / 2 if error == 0 else self.y.place(error)
        return self.x.place(time_of(point)), y

    def axes(self, x_title: str, y_title: str, most: tuple[int, int] = (9, 8)) -> list[str]:
        left, top, right, bottom = self.frame
        parts = []
        for value in self.x.minor():
            parts.append(_line(self.x.place(value), top, self.x.place(value), bottom, "fine"))
        for value in [] if self.only_lane else self.y.decades():
            parts.append(_line(left, self.y.place(value), right, self.y.place(value), "grid"))
        for value in self.x.decades():
            parts.append(_line(self.x.place(value), top, self.x.place(value), bottom, "grid"))
        parts.append(_line(left, bottom, right, bottom, "axis"))
        parts.append(_line(left, top, left, bottom, "axis"))
        for value in self.x.ticks(most[0]):
            at = self.x.place(value)
            parts.append(_line(at, bottom, at, bottom + 4, "axis"))
            parts.append(_text(at, bottom + 18, wording.seconds(value, 2), "tick middle"))
        ticks = [] if self.only_lane else self.y.ticks(most[1])
        for value, text in zip(ticks, error_ticks(ticks)):
            at = self.y.place(value)
            parts.append(_line(left - 4, at, left, at, "axis"))
            parts.append(_text(left - 8, at + 4, text, "tick end"))
        if self.lane:
            parts.append(_line(left, self.floor, right, self.floor, "break"))
            parts.append(_text(left - 8, bottom - _LANE / 2 + 4, "0", "tick end"))
        if x_title:
            parts.append(_text(right, bottom + 38, x_title, "title end"))
        if y_title:
            parts.append(_text(0, top - 12, y_title, "title"))
        return parts

    def bar(self, point: Point) -> tuple[float, float, float, float]:
        """The line from the fastest to the slowest frame: x0, y0, x1, y1."""
        fastest, slowest = (point["seconds"].get(k) or time_of(point) for k in ("min", "max"))
        y = self.at(point)[1]
        return self.x.place(fastest), y, self.x.place(slowest), y

    def spread(self, point: Point, mark: str) -> str:
        return _line(*self.bar(point), mark)

    def dot(self, point: Point, mark: str, radius: float) -> str:
        x, y = self.at(point)
        text = describe(point)
        return (
            f'<circle class="{mark}" data-id="{escape(str(point["id"]))}" cx="{x:.1f}" cy="{y:.1f}"'
            f' r="{radius:g}"><title>{escape(text)}</title></circle>'
        )

    def ring(self, point: Point, radius: float) -> str:
        x, y = self.at(point)
        return f'<circle class="ring" cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}"/>'

    def svg(self, parts: Sequence[str], mark: str, title: str) -> str:
        inside = "\n".join(part for part in parts if part)
        return (
            f'<svg class="{mark}" viewBox="0 0 {self.width:g} {self.height:g}" role="img" '
            f'aria-label="{escape(title)}">\n{inside}\n</svg>'
        )


def front_plot(sweep: Sweep, width: float, height: float, mark: str) -> str:
    """A plot of all points, with the front connected and labelled and the scene's own settings ringed."""
    narrow = width < 600
    plot = Plot(
        sweep, width, height, (54, 34, 12, 46),
        before=0.08 if narrow else 0.24,  # the labels stand on the side where there are no points
    )
    tunable = sweep.color_tunable()
    front = [p for p in sweep.front if plottable(p)]
    baseline = sweep.baseline if plottable(sweep.baseline) else None
    keys = {p["id"] for p in front} | ({baseline["id"]} if baseline else set())
    others = [p for p in sweep.points if plottable(p) and p["id"] not in keys]

    parts = plot.axes("time per frame, median \N{RIGHTWARDS ARROW}", "\N{UPWARDS ARROW} error (RMSE)",
                      (5, 8) if narrow else (9, 8))
    parts += [plot.spread(p, "spread faint") for p in others]
    parts += [plot.dot(p, f"pt c{sweep.color_class(p, tunable)}", 3.6) for p in others]
    places = [plot.at(p) for p in front]
    if len(front) > 1:
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        parts.append(f'<polyline class="front-line" points="{path}"/>')
    named = [*front, *([baseline] if baseline and baseline not in front else [])]
    parts += [plot.spread(p, "spread") for p in named]
    labels = _names(plot, named, baseline)[: _FEW if narrow else None]
    placed = place_labels(
        labels,
        (plot.frame[0] + 4, plot.frame[1], plot.frame[2], plot.frame[3] - 2),
        [(*plot.at(p), 10 if p is baseline else 6) for p in named],
        [(*a, *b) for a, b in zip(places, places[1:])],
        [plot.at(p) for p in others],
        [plot.bar(p) for p in (*named, *others)],
    )
    parts += [_leader(p) for p in placed if p.leader]
    for point in named:
        kind = "pt on-front" if point in front else "pt"
        parts.append(plot.dot(point, f"{kind} c{sweep.color_class(point, tunable)}", 5.5))
    if baseline:
        parts.append(plot.ring(baseline, 9.5))
    for p in placed:
        own = " own" if baseline and p.label.key == baseline["id"] else ""
        parts.append(
            f'<text class="name{own} {p.anchor}" x="{p.x:.1f}" '
            f'y="{p.y + 4:.1f}">{escape(p.label.text)}</text>'
        )
    return plot.svg(parts, mark, f"Error against time of {len(sweep.points)} settings")


def tunable_plot(sweep: Sweep, tunable: dict[str, Any]) -> str:
    """A plot of error against time as this tunable alone varies, on the axes that all plots share."""
    plot = Plot(sweep, 340, 250, (50, 14, 10, 28))
    points = [p for p in sweep.alone(tunable["name"]) if plottable(p)]
    alone = {p["id"] for p in points}
    parts = plot.axes("", "", (5, 6))
    parts += [plot.dot(p, "pt ghost", 2) for p in sweep.points
              if plottable(p) and p["id"] not in alone]
    places = [plot.at(p) for p in points]
    if len(points) > 1:
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        parts.append(f'<polyline class="knob-line" points="{path}"/>')
    parts += [plot.spread(p, "spread") for p in points]
    labels = []
    for point, (x, y) in zip(points, places):
        text = wording.shorten(wording.setting(point["settings"].get(tunable["name"])), 20)
        labels.append(Label(point["id"], text, x, y, text_width(text, 11), 13))
    own = sweep.baseline["id"]
    labels.sort(key=lambda label: label.key != own)
    placed = place_labels(
        labels, (plot.frame[0] + 3, plot.frame[1] - 6, plot.frame[2], plot.frame[3] - 2),
        [(x, y, 5) for x, y in places], [(*a, *b) for a, b in zip(places, places[1:])],
    )
    parts += [_leader(p) for p in placed if p.leader]
    parts += [plot.dot(p, "pt knob", 4) for p in points]
    parts += [plot.ring(p, 7.5) for p in points if p["id"] == own]
    parts += [
        f'<text class="name small {p.anchor}" x="{p.x:.1f}" y="{p.y + 3.5:.1f}">'
        f"{escape(p.label.text)}</text>"
        for p in placed
    ]
    return plot.svg(parts, "small", f"Error against time as {tunable['title']} varies")


def name_order(
    sweep: Sweep, named: Sequence[Point], baseline: Point | None
) -> list[Point]:
    """``named``, the most important to label first: the scene's own settings, those that the sentences mention, the
    ends of the front, then every second one of the rest, and so on."""
    order = [p for p in named if p is baseline]
    spoken = {s["point"] for s in sweep.result["sentences"]}
    order += [p for p in named if p["id"] in spoken and p not in order]
    order += [p for p in (*named[:1], *named[-1:]) if p not in order]
    step = 2 ** max(0, math.ceil(math.log2(max(1, len(named)))))
    while step >= 1:
        for point in named[::step]:
            if point not in order:
                order.append(point)
        step //= 2
    return order


def point_name(point: Point, baseline: Point | None, length: int) -> str:
    """The label, with a note if the point has the scene's own settings."""
    own = baseline is not None and point["id"] == baseline["id"]
    return wording.shorten(str(point["label"]), length) + (" (your scene)" if own else "")


def describe(point: Point) -> str:
    """The tooltip of a point, one line."""
    return (f"{point['label']}: error {wording.number(point['rmse'])}, "
            f"{wording.seconds(median(point))}")


def error_ticks(values: Sequence[float]) -> list[str]:
    """The labels of an axis: plain digits if they are short, otherwise powers of ten for all."""
    if all(1e-4 <= value < 1e4 for value in values):
        return [f"{value:g}" for value in values]
    exponents = [math.log10(value) for value in values]
    if all(abs(e - round(e)) < 1e-9 for e in exponents):
        return [wording.power_of_ten(round(e)) for e in exponents]
    return [wording.number(value, 1) for value in values]


def _names(plot: Plot, named: Sequence[Point], baseline: Point | None) -> list[Label]:
    labels = []
    for point in name_order(plot.sweep, named, baseline):
        text = point_name(point, baseline, _LONG)
        labels.append(Label(str(point["id"]), text, *plot.at(point), text_width(text), 15))
    return labels


def _leader(p: Placed) -> str:
    return _line(p.label.x, p.label.y, p.end_x, p.end_y, "leader")


def _line(x0: float, y0: float, x1: float, y1: float, mark: str) -> str:
    return f'<line class="{mark}" x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}"/>'


def _text(x: float, y: float, text: str, mark: str) -> str:
    return f'<text class="{mark}" x="{x:.1f}" y="{y:.1f}">{escape(text)}</text>'
