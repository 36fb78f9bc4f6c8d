"""What a sweep found, looked up the ways that its report needs it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from clvol.accuracy.report import wording

_MOST_CLASSES = 8  # colours that can be told apart
_PREFERRED = "integration.classification"

Point = dict[str, Any]


@dataclass(frozen=True)
class Sweep:
    """``result`` as in tradeoff.json: plain values, null where a number is not finite."""

    result: dict[str, Any]

    @property
    def points(self) -> list[Point]:
        return self.result["points"]

    @property
    def knobs(self) -> list[dict[str, Any]]:
        return self.result["knobs"]

    @property
    def name(self) -> str:
        return str(self.result["scene"]["name"])

    def point(self, key: str) -> Point:
        return next(p for p in self.points if p["id"] == key)

    @property
    def baseline(self) -> Point:
        """The scene's own settings."""
        return self.point(self.result["baseline"])

    @property
    def front(self) -> list[Point]:
        """Error falling, time rising."""
        return [self.point(key) for key in self.result["front"]]

    def shown(self) -> list[Point]:
        """The points with pictures: the front's, and the scene's own where it is not among them."""
        front, baseline = self.front, self.baseline
        return front if baseline["id"] in self.result["front"] else [baseline, *front]

    def values(self, knob: str) -> list[Any]:
        """The knob's values among the points: in its own order, others after that."""
        declared = next((k["values"] for k in self.knobs if k["name"] == knob), [])
        found: list[Any] = []
        for point in self.points:
            value = point["settings"].get(knob)
            if value is not None and not any(_same(value, v) for v in found):
                found.append(value)
        order = [v for v in declared if any(_same(v, f) for f in found)]
        return order + [v for v in found if not any(_same(v, o) for o in order)]

    def varied(self) -> list[dict[str, Any]]:
        """The knobs that take more than one value."""
        return [k for k in self.knobs if len(self.values(k["name"])) > 1]

    def color_knob(self) -> dict[str, Any] | None:
        """The knob whose values colour the points; None where no knob has a few of them."""
        few = [k for k in self.varied() if len(self.values(k["name"])) <= _MOST_CLASSES]
        words = [k for k in few if isinstance(self.values(k["name"])[0], str)]
        named = [k for k in few if k["name"] == _PREFERRED]
        return next(iter([*named, *words, *few]), None)

    def color_class(self, point: Point, knob: dict[str, Any] | None) -> int:
        """The number of the point's colour."""
        if knob is None:
            return 0
        value = point["settings"].get(knob["name"])
        values = self.values(knob["name"])
        return next((i for i, v in enumerate(values) if _same(v, value)), len(values))

    def alone(self, knob: str) -> list[Point]:
        """The points where this knob alone varies, in the order of its values."""
        values = self.values(knob)
        found = [p for p in self.points if p["sweep"] == knob]
        if found and self.baseline not in found:
            found.append(self.baseline)

        def order(point: Point) -> tuple[int, float]:
            value = point["settings"].get(knob)
            place = next((i for i, v in enumerate(values) if _same(v, value)), len(values))
            return place, median(point) or 0.0

        return sorted(found, key=order)

    def against_baseline(self, point: Point) -> str:
        """"2.4 times as fast as your scene's settings", or why that cannot be said."""
        if point["id"] == self.baseline["id"]:
            return "your scene's settings"
        ours, theirs = median(point), median(self.baseline)
        if ours is None or theirs is None:
            return ""
        if not told_apart(point, self.baseline):
            return "as fast as your scene's settings, within the spread"
        if ours < theirs:
            return f"{_ratio(theirs / ours)} times as fast as your scene's settings"
        return f"takes {_ratio(ours / theirs)} times as long as your scene's settings"

    def better(self) -> Point | None:
        """The most exact point that is as exact as the baseline or more so, and really faster."""
        least = self.baseline["rmse"]
        found = [
            p for p in self.points
            if p["rmse"] is not None and (least is None or p["rmse"] <= least)
            and (median(p) or math.inf) < (median(self.baseline) or 0.0)
            and told_apart(p, self.baseline)
        ]
        return min(found, key=lambda p: (p["rmse"], median(p)), default=None)

    def options(self, point: Point) -> list[str]:
        """The ``--set`` options that turn the scene into this point, unquoted."""
        settings = point["settings"]
        return [f"{k}={wording.toml(settings[k])}" for k in point["changed"] if k in settings]


def median(point: Point) -> float | None:
    """Seconds a frame, if they are a time at all."""
    value = point["seconds"]["median"]
    return value if value is not None and value > 0 else None


def plottable(point: Point) -> bool:
    return point["rmse"] is not None and median(point) is not None


def told_apart(a: Point, b: Point) -> bool:
    """Whether the times differ by more than their interquartile ranges explain."""
    ours, theirs = median(a), median(b)
    if ours is None or theirs is None:
        return False
    wide = ours * (a["seconds"].get("spread") or 0) + theirs * (b["seconds"].get("spread") or 0)
    return abs(ours - theirs) > wide / 2


def _ratio(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


def _same(a: Any, b: Any) -> bool:
    """Equal, where True is not 1."""
    return isinstance(a, bool) == isinstance(b, bool) and a == b
