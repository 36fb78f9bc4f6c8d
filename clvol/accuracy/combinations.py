"""Combinations of the tunables that whole pictures are needed for, in the order in which they are tried."""

from __future__ import annotations

import itertools
from typing import Any

from clvol.accuracy.settings import SceneTunable


class Combinations:
    """Combinations of the values of tunables, middle ones first, so that what is learnt from one leaves few
    others to be tried."""

    def __init__(self, tunables: dict[str, SceneTunable]) -> None:
        # Without its last value, which is to do without the tunable.
        self._ladders = {
            key: tunable.values[:-1] if tunable.values[-1] == tunable.scene_value else tunable.values
            for key, tunable in tunables.items()
        }
        places = itertools.product(*(range(len(values)) for values in self._ladders.values()))
        middle = [(len(values) - 1) / 2 for values in self._ladders.values()]
        self._left = sorted(
            (p for p in places if p), key=lambda p: sum(abs(a - m) for a, m in zip(p, middle))
        )

    def next(self) -> dict[str, Any] | None:
        if not self._left:
            return None
        place = self._left[0]
        return {key: values[k] for (key, values), k in zip(self._ladders.items(), place)}

    def drop(self, values: dict[str, Any], cheaper: bool) -> None:
        """Takes out this one, and all that are cheaper in no tunable less (or else more accurate)."""
        place = [self._ladders[key].index(value) for key, value in values.items()]
        self._left = [
            p for p in self._left
            if not all(a <= b if cheaper else a >= b for a, b in zip(p, place))
        ]  # fmt: skip
