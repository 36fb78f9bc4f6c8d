"""Which step of a series is shown at which time."""

from __future__ import annotations

import math
from dataclasses import dataclass

_ROUNDING = 1e-6  # steps: frames meet the steps that they are meant to show, whatever the frame rate


@dataclass(frozen=True)
class StepTimes:
    """``count`` steps, ``rate`` of them in a second from time 0 on. ``loop``: after the last one comes the first one,
    else the last one stays. ``fixed``: the step that is shown at all times."""

    count: int
    rate: float
    loop: bool = False
    fixed: int | None = None

    def at(self, time: float) -> int:
        """The number of the step at ``time`` in seconds."""
        if self.fixed is not None:
            return self.fixed
        number = math.floor(time * self.rate + _ROUNDING)
        return number % self.count if self.loop else min(max(number, 0), self.count - 1)


def rate_of(steps: int, frames: int, fps: float) -> float:
    """Steps per second where the scene states none: all steps are spread over the frames of an animation; a picture
    that is none is at the time of the step with its number, at a frame for each step."""
    return fps if frames == 1 else steps * fps / frames


def frames_of(steps: int, rate: float | None, fps: float) -> int:
    """How many frames show all steps, where the scene states no number of frames: one for each, unless it states the
    ``rate`` of steps per second."""
    return steps if rate is None else max(1, math.ceil(steps * fps / rate - _ROUNDING))
