"""Taking times: medians over rounds in which all candidates take turns, so that a machine that is
busy for a while does not favour one of them."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from typing import Any

FEWEST_FRAMES = 3


def summary(seconds: list[float]) -> dict[str, Any]:
    """Median and spread of some times."""
    quartiles = statistics.quantiles(seconds, n=4) if len(seconds) > 1 else [seconds[0]] * 3
    return {
        "median": statistics.median(seconds),
        "min": min(seconds),
        "max": max(seconds),
        "spread": (quartiles[2] - quartiles[0]) / statistics.median(seconds),
        "frames": len(seconds),
    }


def take_turns(
    candidates: Mapping[Any, Callable[[], float]],
    rounds: int,
    slow_seconds: float = 1.0,
    never_slow: tuple[Any, ...] = (),
    steady_seconds: float = 0.5,
) -> dict[Any, dict[str, Any]]:
    """Calls each candidate once a round; it returns its own seconds. The caller has warmed up.

    A candidate slower than ``slow_seconds`` is called in the first FEWEST_FRAMES rounds only,
    unless it is in ``never_slow``. One quicker than ``steady_seconds`` first makes a frame that does not
    count, and so do all others in their turn: what is measured is a frame that follows a frame, not
    one that finds the caches full of another candidate's data. Returns ``summary`` of each.
    """
    seconds: dict[Any, list[float]] = {key: [] for key in candidates}
    for _ in range(rounds):
        for key, call in candidates.items():
            taken = seconds[key]
            slow = len(taken) >= FEWEST_FRAMES and statistics.median(taken) > slow_seconds
            if not slow or key in never_slow:
                if not taken or statistics.median(taken) < steady_seconds:
                    call()
                taken.append(call())
    return {key: summary(taken) for key, taken in seconds.items()}
