"""Who rendered what of a frame, and when."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass
class Span:
    """``device`` (number) rendered ``tiles`` (numbers) from ``begin`` to ``end``, in seconds since the frame began.
    ``counts``: whether its result is part of the picture."""

    device: int
    stage: int
    begin: float
    end: float
    tiles: np.ndarray
    counts: bool


@dataclass
class Schedule:
    """Who rendered what of a frame, over time. ``seconds``: of the whole frame. ``tile``: pixels (width, height)."""

    names: list[str]
    tile: tuple[int, int] = (1, 1)
    seconds: float = 0.0
    spans: list[Span] = field(default_factory=list)
    costs: list[float] = field(default_factory=list)  # by device
    states: list[str] = field(default_factory=list)

    def describe(self) -> dict[str, Any]:
        """For stats. ``efficiency``: the seconds that the frame would take if all devices that took part had been busy
        at their speeds until the end, over the seconds that it took."""
        busy = [sum(s.end - s.begin for s in self.spans if s.device == k) for k in range(len(self.names))]
        tiles = [sum(len(s.tiles) for s in self.spans if s.device == k and s.counts) for k in range(len(self.names))]
        speeds = [cost / seconds for cost, seconds in zip(self.costs, busy) if seconds > 0 and cost > 0]
        ideal = sum(self.costs) / sum(speeds) if speeds else self.seconds
        every = max(sum(tiles), 1)
        devices = [
            {
                "name": name, "tiles": tiles[k], "share": tiles[k] / every, "busy_seconds": busy[k],
                "idle_share": max(1.0 - busy[k] / self.seconds, 0.0) if self.seconds else 0.0,
                "state": self.states[k],
            }
            for k, name in enumerate(self.names)
        ]  # fmt: skip
        return {"efficiency": min(ideal / self.seconds, 1.0) if self.seconds else 1.0, "devices": devices}
