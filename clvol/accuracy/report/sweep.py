"""What a sweep found, looked up the ways that its report needs it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
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

    @cached_property
    def _by_id(self) -> dict[str, Point]:
        return {p["id"]: p for p in self.points}

    def point(self, key: str) -> Point:
        return self._by_id[key]

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

    @cached_property
    def _ranks(self) -> dict[str, dict[tuple, int]]:
        """For each knob its values among the points: in its own order, others after that."""
        ranks = {}
        for knob in self.knobs:
            name = knob["name"]
            found = dict.fromkeys(
                _key(p["settings"][name]) for p in self.points
                if p["settings"].get(name) is not None
            )
            order = [key for key in map(_key, knob["values"]) if key in found]
            ranks[name] = {key: i for i, key in enumerate(dict.fromkeys([*order, *found]))}
        return ranks

    def values(self, knob: str) -> list[Any]:
        """What the knob is set to among the points, in its own order."""
        return [value for _, value in self._ranks[knob]]

    def rank(self, point: Point, knob: str) -> int:
        """The place of the point's value among :meth:`values`; after all where it has none."""
        ranks = self._ranks[knob]
        return ranks.get(_key(point["settings"].get(knob)), len(ranks))

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
        return 0 if knob is None else self.rank(point, knob["name"])

    def alone(self, knob: str) -> list[Point]:
        """The points where this knob alone varies, in the order of its values."""
        found = [p for p in self.points if p.get("sweep") == knob]
        if found and self.baseline not in found:
            found.append(self.baseline)
        return sorted(found, key=lambda p: (self.rank(p, knob), median(p) or 0.0))

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


def time_of(point: Point) -> float:
    """Seconds per frame of a point that is :func:`plottable`."""
    return point["seconds"]["median"]


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


def _key(value: Any) -> tuple[bool, Any]:
    """Equal for equal settings, where True is not 1."""
    return isinstance(value, bool), value
