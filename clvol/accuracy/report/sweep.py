"""The result of a sweep, with the look-ups that its report needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from clvol.accuracy.report import wording

_MOST_CLASSES = 8  # number of distinguishable colours
_PREFERRED = "integration.classification"

Point = dict[str, Any]


@dataclass(frozen=True)
class Sweep:
    """Wraps ``result`` as in tradeoff.json: JSON values, with None for numbers that are not finite."""

    result: dict[str, Any]

    @property
    def points(self) -> list[Point]:
        return self.result["points"]

    @property
    def tunables(self) -> list[dict[str, Any]]:
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
        """The points of the front, by falling error and rising time."""
        return [self.point(key) for key in self.result["front"]]

    def shown(self) -> list[Point]:
        """The points with pictures: those of the front, and the scene's own settings if they are not among them."""
        front, baseline = self.front, self.baseline
        return front if baseline["id"] in self.result["front"] else [baseline, *front]

    @cached_property
    def _ranks(self) -> dict[str, dict[tuple, int]]:
        """The rank of each value of each tunable: values in the tunable's order first, then others."""
        ranks = {}
        for tunable in self.tunables:
            name = tunable["name"]
            found = dict.fromkeys(
                _key(p["settings"][name]) for p in self.points
                if p["settings"].get(name) is not None
            )
            order = [key for key in map(_key, tunable["values"]) if key in found]
            ranks[name] = {key: i for i, key in enumerate(dict.fromkeys([*order, *found]))}
        return ranks

    def values(self, tunable: str) -> list[Any]:
        """The values of the tunable among the points, in the tunable's order."""
        return [value for _, value in self._ranks[tunable]]

    def rank(self, point: Point, tunable: str) -> int:
        """The index of the point's value among :meth:`values`; their number if it has none."""
        ranks = self._ranks[tunable]
        return ranks.get(_key(point["settings"].get(tunable)), len(ranks))

    def varied(self) -> list[dict[str, Any]]:
        """The tunables that take more than one value."""
        return [k for k in self.tunables if len(self.values(k["name"])) > 1]

    def color_tunable(self) -> dict[str, Any] | None:
        """The tunable whose values colour the points; None if none varies over few enough values."""
        few = [k for k in self.varied() if len(self.values(k["name"])) <= _MOST_CLASSES]
        words = [k for k in few if isinstance(self.values(k["name"])[0], str)]
        named = [k for k in few if k["name"] == _PREFERRED]
        return next(iter([*named, *words, *few]), None)

    def color_class(self, point: Point, tunable: dict[str, Any] | None) -> int:
        """The number of the point's colour."""
        return 0 if tunable is None else self.rank(point, tunable["name"])

    def alone(self, tunable: str) -> list[Point]:
        """The points at which this tunable alone varies, in the order of its values."""
        found = [p for p in self.points if p.get("sweep") == tunable]
        if found and self.baseline not in found:
            found.append(self.baseline)
        return sorted(found, key=lambda p: (self.rank(p, tunable), median(p) or 0.0))

    def against_baseline(self, point: Point) -> str:
        """A phrase such as "2.4 times as fast as your scene's settings"; "" if a time is missing."""
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
        """The most exact point that is at least as exact as the baseline and faster by more than the spread."""
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
    """Seconds per frame; None if they were not measured."""
    value = point["seconds"]["median"]
    return value if value is not None and value > 0 else None


def time_of(point: Point) -> float:
    """Seconds per frame of a point that is :func:`plottable`."""
    return point["seconds"]["median"]


def plottable(point: Point) -> bool:
    return point["rmse"] is not None and median(point) is not None


def told_apart(a: Point, b: Point) -> bool:
    """Whether the times differ by more than their interquartile ranges can explain."""
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
