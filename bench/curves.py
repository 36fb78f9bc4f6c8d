"""Error against time: which time reaches an error."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Reach:
    """The ``seconds`` at which a curve reaches an error, and how that is known:

    "interpolated"  between two measured points
    "at most"       the cheapest measured point is better already
    "not reached"   no measured point is as good; ``seconds`` is None
    """

    seconds: float | None
    kind: str
    least_error: float


def lower_envelope(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Of (seconds, error): those that no other beats in both, by rising time and falling error."""
    envelope: list[tuple[float, float]] = []
    for seconds, error in sorted(points):
        if not envelope or error < envelope[-1][1]:
            envelope.append((seconds, error))
    return envelope


def reach(points: Iterable[tuple[float, float]], error: float) -> Reach:
    """When the curve through ``points`` (seconds > 0, error >= 0) reaches ``error``.

    Straight lines in the logarithms of both, between neighbours on the lower envelope; nothing is
    extrapolated.
    """
    envelope = lower_envelope(points)
    if not envelope:
        raise ValueError("a curve without points")
    least = envelope[-1][1]
    if error < least:
        return Reach(None, "not reached", least)
    if error >= envelope[0][1]:
        return Reach(envelope[0][0], "at most", least)
    for (t0, e0), (t1, e1) in zip(envelope, envelope[1:]):
        if e1 <= error:
            if e1 <= 0.0:  # no logarithm: only the exact point itself is known to reach it
                return Reach(t1, "interpolated", least)
            share = math.log(e0 / error) / math.log(e0 / e1)
            return Reach(t0 * (t1 / t0) ** share, "interpolated", least)
    raise AssertionError("an envelope's errors fall")


def geometric_mean(values: Iterable[float]) -> float:
    """NaN for no values."""
    values = list(values)
    return math.exp(math.fsum(map(math.log, values)) / len(values)) if values else math.nan
