"""Progress of building a store: the steps of all phases on one scale."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[int, int], None]

# Steps of a region by phase, about in proportion to the time that they take. Training takes about as long as encoding
# some regions, however many there are.
_OF_REGION = {"measuring": 1, "encoding": 20}
_TRAINING = 400
_DESCRIBING = 1


class Steps:
    """Calls ``progress(done, total)`` as phases advance; ``on_phase(name)`` when one begins. Without codes there is one
    phase, "encoding", whose steps are regions."""

    def __init__(
        self, regions: int, codes: bool, progress: Progress | None, on_phase: Callable[[str], None] | None
    ) -> None:
        self._progress, self._on_phase = progress, on_phase if codes else None
        self._codes = codes
        self._done = self._first = self._each = 0
        self._sizes = {"encoding": regions}
        if codes:
            self._sizes = {
                "measuring": _OF_REGION["measuring"] * regions, "training": _TRAINING,
                "encoding": _OF_REGION["encoding"] * regions, "describing": _DESCRIBING,
            }  # fmt: skip
        self._total = sum(self._sizes.values())

    def begin(self, phase: str) -> None:
        """The phases before ``phase`` are over."""
        if phase not in self._sizes:
            return
        names = list(self._sizes)
        self._first = self._done = sum(self._sizes[name] for name in names[: names.index(phase)])
        self._phase = phase
        self._each = _OF_REGION.get(phase, 1) if self._codes else 1
        if self._on_phase is not None:
            self._on_phase(phase)
        if self._codes:
            self._say()

    def add(self, regions: int) -> None:
        """So many more regions are done."""
        self._done += self._each * regions
        self._say()

    def part(self, done: int, total: int) -> None:
        """``done`` of ``total`` parts of the phase are done."""
        self._done = self._first + self._sizes[self._phase] * done // max(total, 1)
        self._say()

    def finish(self) -> None:
        """All is done."""
        if self._codes:
            self._done = self._total
            self._say()

    def _say(self) -> None:
        if self._progress is not None:
            self._progress(self._done, self._total)
