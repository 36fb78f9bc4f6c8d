"""Renders to a time: the most accurate picture whose frame takes at most the given seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from clvol.accuracy.picture_search import AIM, FLOAT32_ERROR, PictureSearch, Progress
from clvol.accuracy.trials import Trial
from clvol.errors import UsageError
from clvol.render.frame import Frame
from clvol.scene.scene import Scene

_SHORTEST = 1e-9  # seconds; no device renders a picture in less
_FIRST_ERROR, _LARGEST_ERROR = 1e-2, 0.5  # where the search begins, and where it gives up
_LOOKS_AT_TIME = 10
_USED = 0.7  # share of the time that counts as used


def render_in_time(
    scene: Scene,
    seconds: float,
    *,
    devices: Sequence[Any] | None = None,
    memory_cap: int | None = None,
    depth: bool = True,
    progress: Progress | None = None,
    seed: int = 0,
    pixel_area: bool = False,
) -> Frame:
    """Renders ``scene`` with the most accurate settings whose frame takes at most ``seconds``.

    The time is ``stats["seconds"]["render"]``, that of a compiled and resident scene; the search for settings and the
    measurement of the error are not included. The error is measured and reported as by ``render_to_error``, which has
    the same other arguments. Raises UsageError if even the fastest settings take longer.
    """
    check_time_budget(seconds)
    with PictureSearch(scene, devices, memory_cap, _FIRST_ERROR, depth, progress, seed, pixel_area) as search:
        return _in_time(search, seconds)


def check_time_budget(value: float) -> None:
    """Raises UsageError for a time that is not finite, or less than 1e-9 seconds."""
    if not 0.0 < value < math.inf:
        raise UsageError("time_budget", f"got {value!r}", "seconds, more than 0")
    if value < _SHORTEST:
        raise UsageError("time_budget", f"got {value!r}", f"seconds, at least {_SHORTEST:g}")


def _in_time(search: PictureSearch, budget: float) -> Frame:
    """Searches for the cheapest picture for a sequence of errors, until the time is used."""
    best: Trial | None = None
    low, high = 0.0, _LARGEST_ERROR  # an error that takes too long to reach, and one for which there is time
    error = _FIRST_ERROR
    for _ in range(_LOOKS_AT_TIME):
        picture = search.cheapest_picture(error)
        seconds = math.inf if picture is None else picture.seconds
        if seconds <= budget * AIM:
            best, high = picture, error
            if seconds >= _USED * budget or error <= FLOAT32_ERROR:
                break
        else:
            low = error
        # The error falls roughly with the square of the time.
        over = min(seconds / (AIM * budget), 1e3)  # limited so that its square does not overflow
        guess = error * min(max(over**2, 0.03), 30.0)
        if low > 0:
            guess = max(guess, low * (high / low) ** 0.25)
        most = high * (low / high) ** 0.25 if low > 0 else high / 1.3
        error = max(min(guess, most), FLOAT32_ERROR)
        if low > 0 and high / low < 1.2:
            break
    if best is None:
        least = min(trial.seconds for trial in search.pictures.values())
        raise UsageError("time_budget", f"got {budget:g} s", f"at least {least:.3g} s on this device")
    found = search.measured(best, 1, None)
    return search.frame(best, found, {"time_budget": budget}, 1)
