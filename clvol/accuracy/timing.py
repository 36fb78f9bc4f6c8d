"""Measures times as medians over rounds in which all candidates take turns, so that a temporary load on the machine
affects all of them alike."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from typing import Any

FEWEST_FRAMES = 3


def summary(seconds: list[float]) -> dict[str, Any]:
    """Statistics of ``seconds``; "spread" is the interquartile range divided by the median."""
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
    """Calls each candidate once per round, and returns the ``summary`` of the seconds that each returns.

    The caller has warmed up all candidates. A candidate slower than ``slow_seconds`` is called in the first
    FEWEST_FRAMES rounds only, unless it is in ``never_slow``. A candidate faster than ``steady_seconds`` renders an
    extra frame first, which is not counted, so that the measured frame does not start with caches that hold another
    candidate's data.
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
