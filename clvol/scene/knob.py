"""Knobs: the keys of a scene that trade accuracy for time.

A key declares itself where it is defined, in its field's annotation. What sweeps settings (error
against time, the cheapest settings for an error) finds the knobs there, and lists none itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


def _always(*_: Any) -> bool:
    return True


def _itself(value: Any) -> Any:
    return value


@dataclass(frozen=True, eq=False)
class Knob:
    """``values``: what to try, from cheap to accurate where ``is_ladder``, else alternatives in any
    order; or a function of a resolved scene that gives them.

    ``methods``: the values of integration.method that it is of; none given: all.
    ``applies(scene)``: whether the knob has any effect beside the scene's other keys. ``is_main``: the
    one that accuracy is bought with first; a notch more of it is worth about as much everywhere.
    ``is_continuous``: any value between two of the ladder's may be taken as well.
    ``of_picture``: a pixel depends on its neighbours, so single pixels do not show the effect.
    ``alone``: alternatives that are tried one knob at a time, not in all combinations with others'.
    ``saves_memory``: cheap values are worth something even where they save no time.
    ``order``: of a ladder's values that are no numbers, the number by which they ascend or descend.
    """

    title: str
    unit: str
    values: tuple | Callable[[Any], tuple]
    is_ladder: bool = True
    is_main: bool = False
    is_continuous: bool = False
    of_picture: bool = False
    alone: bool = False
    saves_memory: bool = False
    methods: tuple[str, ...] = ()
    applies: Callable[[Any], bool] = _always
    order: Callable[[Any], Any] = _itself

    def is_of(self, method: str) -> bool:
        """Whether the knob is one of that integration.method."""
        return not self.methods or method in self.methods

    def counts(self, scene: Any) -> bool:
        """Whether it has any effect beside the scene's method and other keys."""
        return self.is_of(scene.integration.method) and self.applies(scene)

    def values_for(self, resolved: Any) -> tuple:
        return self.values(resolved) if callable(self.values) else self.values
