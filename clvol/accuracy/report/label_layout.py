"""The layout of a log-log plot: axes, and labels that do not cover anything."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class LogAxis:
    """Maps the values ``low`` ... ``high`` to the pixels ``start`` ... ``end`` (in either direction)."""

    low: float
    high: float
    start: float
    end: float

    def place(self, value: float) -> float:
        """The position of ``value``; values beyond the ends are placed at the ends."""
        share = math.log(max(value, 1e-300) / self.low) / math.log(self.high / self.low)
        return self.start + min(1.0, max(0.0, share)) * (self.end - self.start)

    def decades(self) -> list[float]:
        return self._within((1,))

    def ticks(self, most: int = 9) -> list[float]:
        """The values to label: decades if there are at least three, otherwise the multiples by 1, 2 and 5 (or 1 and 3)
        for which there is room."""
        decades = self.decades()
        if len(decades) >= 3:
            every = math.ceil(len(decades) / most)
            return decades[::-1][::every][::-1]
        for digits in ((1, 2, 5), (1, 3)):
            found = self._within(digits)
            if 2 <= len(found) <= most:
                return found
        return decades if len(decades) == 2 else self._within((1, 2, 3, 5, 7))

    def minor(self) -> list[float]:
        """The values of fine grid lines."""
        return self._within(range(2, 10)) if math.log10(self.high / self.low) < 5 else []

    def _within(self, digits: Iterable[int]) -> list[float]:
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        values = [float(f"{d}e{n}") for n in range(first, last + 1) for d in digits]
        return [v for v in values if self.low * (1 - 1e-9) <= v <= self.high * (1 + 1e-9)]


def limits(
    values: Iterable[float], before: float = 0.05, after: float = 0.05, least: float = 0.8
) -> tuple[float, float] | None:
    """The range of the positive ``values``, extended by the shares ``before`` and ``after`` of its logarithm, and at
    least ``least`` decades wide; None if there are no positive values."""
    logs = [math.log10(v) for v in values if v > 0 and math.isfinite(v)]
    if not logs:
        return None
    low, high = min(logs), max(logs)
    short = least - (high - low)
    if short > 0:
        low, high = low - short / 2, high + short / 2
    extent = high - low
    return 10 ** (low - before * extent), 10 ** (high + after * extent)


Box = tuple[float, float, float, float]  # left, top, right, bottom


@dataclass(frozen=True)
class Label:
    """``text`` for the point at (``x``, ``y``), ``width`` by ``height`` pixels."""

    key: str
    text: str
    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class Placed:
    """A label that has a position. ``x`` is that of the text's ``anchor`` ("start", "middle" or "end", whichever is
    next to the point), ``y`` that of its vertical middle. ``leader``: whether it is so far from its point that it
    needs a line to ``(end_x, end_y)``, the nearest position on its box."""

    label: Label
    x: float
    y: float
    anchor: str
    end_x: float
    end_y: float
    leader: bool


_SIDES = (  # directions from the point to the label, in order of preference
    (-1, 0.75), (-1, 0), (1, -0.75), (1, 0), (-1, -0.75), (1, 0.75), (0, 1), (0, -1),
    (-1, 2), (1, -2), (-1, -2), (1, 2),
)
_DISTANCES = (9, 16, 26, 40, 58, 80, 106)
_NEAR = 14  # pixels: closer labels need no line


def place_labels(
    labels: Sequence[Label],
    frame: Box,
    obstacles: Sequence[tuple[float, float, float]],
    lines: Sequence[tuple[float, float, float, float]] = (),
    faint: Sequence[tuple[float, float]] = (),
    bars: Sequence[tuple[float, float, float, float]] = (),
    unit: float = 1.0,
) -> list[Placed]:
    """Places the labels, most important first, each at the free position of lowest cost; labels for which there is no
    room are left out.

    No label leaves ``frame`` or covers another label or an obstacle (x, y, radius), and no leader crosses a label.
    Crossing ``lines`` and, at lower cost, ``bars`` (x0, y0, x1, y1) and ``faint`` points (x, y) is allowed. ``unit``:
    a factor for distances where pixels are small.
    """
    placed: list[Placed] = []
    boxes: list[Box] = []
    leaders: list[tuple[float, float, float, float]] = []
    for label in labels:
        best: tuple[float, Placed, Box] | None = None
        for rank, (dx, dy) in enumerate(_SIDES):
            for distance in _DISTANCES:
                box = _box(label, dx, dy, distance * unit)
                candidate = _candidate(label, box, unit)
                cost = 1.0 * distance + 2.5 * rank
                if best is not None and cost >= best[0]:
                    continue
                leader = (label.x, label.y, candidate.end_x, candidate.end_y)
                if not _inside(box, frame) or any(_overlap(box, b, 3) for b in boxes):
                    continue
                if any(_covers(box, x, y, r + 1) for x, y, r in obstacles):
                    continue
                if any(_crosses(box, *line) for line in leaders):
                    continue
                if candidate.leader and any(_crosses(b, *leader) for b in boxes):
                    continue
                if candidate.leader:
                    cost += 60 * sum(
                        _distance(x, y, *leader) < r
                        for x, y, r in obstacles if (x, y) != (label.x, label.y)
                    )
                    cost += 25 * sum(_meet(leader, line) for line in leaders)
                cost += 70 * sum(_crosses(box, *line) for line in lines)
                cost += 8 * sum(_crosses(box, *line) for line in bars)
                cost += 10 * sum(_covers(box, x, y, 3) for x, y in faint)
                if best is None or cost < best[0]:
                    best = (cost, candidate, box)
        if best is not None:
            placed.append(best[1])
            boxes.append(best[2])
            if best[1].leader:
                leaders.append((label.x, label.y, best[1].end_x, best[1].end_y))
    return placed


def _box(label: Label, dx: float, dy: float, distance: float) -> Box:
    length = math.hypot(dx, dy)
    x, y = label.x + dx / length * distance, label.y + dy / length * distance
    left = x - label.width if dx < 0 else x if dx > 0 else x - label.width / 2
    top = y - label.height / 2 + (math.copysign(label.height / 2, dy) if dx == 0 else 0)
    return left, top, left + label.width, top + label.height


def _candidate(label: Label, box: Box, unit: float) -> Placed:
    left, top, right, bottom = box
    middle = (top + bottom) / 2
    x = right + 2 if right < label.x else left - 2 if left > label.x else label.x
    y = middle if x != label.x else top if top > label.y else bottom
    far = math.hypot(x - label.x, y - label.y) > _NEAR * unit
    if right < label.x:
        return Placed(label, right, middle, "end", x, y, far)
    if left > label.x:
        return Placed(label, left, middle, "start", x, y, far)
    return Placed(label, (left + right) / 2, middle, "middle", x, y, far)


def _inside(box: Box, frame: Box) -> bool:
    return (box[0] >= frame[0] and box[1] >= frame[1]
            and box[2] <= frame[2] and box[3] <= frame[3])


def _overlap(a: Box, b: Box, gap: float) -> bool:
    return (a[0] < b[2] + gap and b[0] < a[2] + gap
            and a[1] < b[3] + gap / 3 and b[1] < a[3] + gap / 3)


def _covers(box: Box, x: float, y: float, radius: float) -> bool:
    return (box[0] - radius < x < box[2] + radius) and (box[1] - radius < y < box[3] + radius)


def _crosses(box: Box, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether the line crosses the box (Liang and Barsky 1984)."""
    enter, leave = 0.0, 1.0
    for start, step, low, high in ((x0, x1 - x0, box[0], box[2]), (y0, y1 - y0, box[1], box[3])):
        if step == 0:
            if not low < start < high:
                return False
            continue
        a, b = sorted(((low - start) / step, (high - start) / step))
        enter, leave = max(enter, a), min(leave, b)
    return enter < leave


def _distance(x: float, y: float, x0: float, y0: float, x1: float, y1: float) -> float:
    """The distance of the point (x, y) from the line segment."""
    dx, dy = x1 - x0, y1 - y0
    length = dx * dx + dy * dy
    t = 0.0 if length == 0 else min(1.0, max(0.0, ((x - x0) * dx + (y - y0) * dy) / length))
    return math.hypot(x - x0 - t * dx, y - y0 - t * dy)


def _meet(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two lines cross."""
    def side(line: Sequence[float], x: float, y: float) -> float:
        return (line[2] - line[0]) * (y - line[1]) - (line[3] - line[1]) * (x - line[0])

    return (side(a, b[0], b[1]) * side(a, b[2], b[3]) < 0
            and side(b, a[0], a[1]) * side(b, a[2], a[3]) < 0)
