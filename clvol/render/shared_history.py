"""What devices that share pictures keep of the last one, for the next (``coherence.mode`` "reproject")."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from clvol.integrators.base import SHARED_COHERENCE, KeptDepths
from clvol.integrators.raycast.history import LATE_BEFORE, NOTHING_REUSED, LateStarts
from clvol.integrators.raycast.measured_gain import LEAST_PIXELS, MeasuredGain


class Arrays(Protocol):
    """The part of ``device_group.Arrays`` that is needed here."""

    def make(self, shape: Sequence[int], dtype: Any) -> np.ndarray: ...

    def release(self, arrays: Sequence[np.ndarray | None], still_used: bool) -> None: ...


class SharedHistory:
    """Whether the next picture keeps where its rays first contribute, and where those of the last one did."""

    def __init__(self, arrays: Arrays) -> None:
        self.late, self.gain = LateStarts(), MeasuredGain()
        self._arrays = arrays
        self._last: np.ndarray | None = None
        self._number = self._number_of_last = 0  # pictures so far, those that were not completed among them
        self._kept: KeptDepths | None = None  # of the picture that is rendered
        self._reason: str | None = None
        self._begun, self._measured = 0.0, False

    def begin(self, width: int, height: int) -> KeptDepths | None:
        """Called before a picture. None: it is rendered without."""
        self._begun, self._measured = perf_counter(), width * height >= LEAST_PIXELS
        self._reason = self.late.rests()
        if self._reason is None and self._measured:
            self._reason = self.gain.turn()
        self._number += 1
        if self._reason is not None:
            self._replace(None, False)
            self._kept = None
            return None
        before = self._last if self._last is not None and self._last.shape == (height, width) else None
        if self.late.starts_from_hull():
            before, self._reason = None, LATE_BEFORE
        now = self._arrays.make((height, width), np.float32)
        self._kept = KeptDepths(now, before, self._number, self._number_of_last)
        return self._kept

    def again(self) -> KeptDepths:
        """For the same picture, from the hull."""
        assert self._kept is not None
        now = self._kept.now
        self._kept = KeptDepths(self._arrays.make(now.shape, np.float32), None, self._number, 0)
        return self._kept

    def end(
        self, counters: dict[str, int], known: Mapping[str, Any], samples: int, still_used: bool,
        render_again: Callable[[KeptDepths], None],
    ) -> dict[str, Any]:  # fmt: skip
        """What stats say of coherence, of a picture that is complete. Takes what is counted of it out of ``counters``.
        ``known``: what the devices say. ``render_again(kept)`` renders it once more."""
        reused, holes, late, audited = (counters.pop(name, 0) for name in SHARED_COHERENCE)
        if self._kept is None:
            if self._measured:
                self.gain.took(perf_counter() - self._begun, reused=False)
            return NOTHING_REUSED | {"mode": "cells", "reason": self._reason}
        takes = reused + audited > 0
        reason = None if takes else self._reason or known["reason"] or "the first picture"
        notes = {
            "mode": "reproject", "reused_starts": reused, "holes": holes if takes else 0, "late_starts": late,
            "samples_saved": audited * (known["audit"] - 1) - (samples - audited) if takes else 0,
            "reinitialised": not takes, "reason": reason,
        }  # fmt: skip
        if late:
            self._arrays.release([self._kept.now], still_used)
            render_again(self.again())
            self.late.found()
            self.gain.lost()
        elif self._measured and takes:
            self.gain.took(perf_counter() - self._begun, reused=True)
        self._replace(None if still_used else self._kept.now, still_used)
        return notes

    def _replace(self, last: np.ndarray | None, still_used: bool) -> None:
        if self._last is not None:
            self._arrays.release([self._last], still_used)
        self._last, self._number_of_last = last, self._number
