"""Combinations of the tunables whose effect only whole pictures show, in the order in which they are tried."""

from __future__ import annotations

import itertools
from typing import Any

from clvol.accuracy.settings import SceneTunable


class Combinations:
    """Combinations of the values of tunables. Those in the middle come first, because their results rule out the
    most others."""

    def __init__(self, tunables: dict[str, SceneTunable]) -> None:
        # The last value disables the tunable, so it is left out if the scene has it.
        self._ladders = {
            key: tunable.values[:-1] if tunable.values[-1] == tunable.scene_value else tunable.values
            for key, tunable in tunables.items()
        }
        combinations = itertools.product(*(range(len(values)) for values in self._ladders.values()))
        middle = [(len(values) - 1) / 2 for values in self._ladders.values()]
        self._left = sorted(
            (indices for indices in combinations if indices),
            key=lambda indices: sum(abs(a - m) for a, m in zip(indices, middle)),
        )

    def next(self) -> dict[str, Any] | None:
        """The next combination to try, by key; None if none is left. It stays until it is dropped."""
        if not self._left:
            return None
        indices = self._left[0]
        return {key: values[k] for (key, values), k in zip(self._ladders.items(), indices)}

    def drop(self, values: dict[str, Any], cheaper: bool) -> None:
        """Drops ``values`` and all combinations that are at least as cheap in every tunable; if not ``cheaper``, all
        that are at least as accurate in every tunable."""
        limits = [self._ladders[key].index(value) for key, value in values.items()]
        self._left = [
            indices for indices in self._left
            if not all(a <= b if cheaper else a >= b for a, b in zip(indices, limits))
        ]  # fmt: skip
