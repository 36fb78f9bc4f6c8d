"""Searches for the cheapest settings whose error is at most a given one.

This module does not render. ``measure(settings)`` does, and returns an object with the ``rmse`` and the ``seconds`` of
a picture and its ``cost``, which includes a share of the preparation. The search assumes that one notch finer on the
main ladder (the step) about halves the error; that alternatives (classification, filter) may differ widely in error
and cost; and that the other ladders change both only a little, but limit the error that the main one can reach.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any, Generic, Protocol, TypeVar

from clvol.accuracy.settings import SceneTunable, Settings, key_of

_FLOOR = 0.85  # if two notches leave more than this share of the error, a finer step no longer helps
_HOPELESS = 3.0  # times the best cost: a single measurement predicts costs only within this factor
_MORE_EXPENSIVE = 2.0  # a cost ratio on the pilot that is large enough to hold for the whole picture
_STRETCHES = 2  # bisections within one notch of the main ladder
_WORTH = 0.98  # share of the cost that a change must at most leave, to be more than noise


class Measured(Protocol):
    """What the search knows of the picture with ``settings``: its error, and seconds and cost of rendering it."""

    rmse: float
    seconds: float
    cost: float
    settings: dict[str, Any]


M = TypeVar("M", bound=Measured)


class Search(Generic[M]):
    """One search, which remembers what was measured. ``possible(settings)`` is whether they can be rendered;
    ``canonical(settings)`` is equal for settings that make the same picture."""

    def __init__(
        self,
        measure: Callable[[dict[str, Any]], M],
        tunables: Mapping[str, SceneTunable],
        possible: Callable[[Settings], bool] = lambda settings: True,
        canonical: Callable[[Settings], dict[str, Any]] = dict,
    ) -> None:
        self._measure, self._possible, self._canonical = measure, possible, canonical
        self._known: dict[tuple, M] = {}
        # Single pixels do not show effects that depend on their neighbours.
        self._tunables = {k: tunable for k, tunable in tunables.items() if not tunable.tunable.of_picture}
        alternatives = [k for k in self._tunables.values() if not k.tunable.is_ladder]
        self._alternatives = [k for k in alternatives if not k.tunable.alone]
        self._alone = [k for k in alternatives if k.tunable.alone and not k.tunable.saves_memory]
        self._last = [k for k in alternatives if k.tunable.saves_memory]
        self._ladders = [k for k in self._tunables.values() if k.tunable.is_ladder and not k.tunable.is_main]
        self._main = [k for k in self._tunables.values() if k.tunable.is_main]

    @property
    def measured(self) -> list[M]:
        return list(self._known.values())

    def measure(self, settings: Settings) -> M:
        settings = self._canonical(settings)
        key = key_of(settings)
        if key not in self._known:
            self._known[key] = self._measure(settings)
        return self._known[key]

    def cheapest(self, start: Settings, limit: float) -> M | None:
        """The cheapest settings that were found with rmse <= ``limit``; None if there are none."""
        held = self.candidates(start, limit)
        return self.refined(held[0], limit) if held else None

    def candidates(self, start: Settings, limit: float) -> list[M]:
        """For each promising combination of alternatives, settings with rmse <= ``limit``, the cheapest first. Costs
        are known roughly, so the caller may compare them again more exactly. Where there are none, alternatives that
        take more memory are tried."""
        found = self._candidates(start, limit)
        others = ({**start, k.key: value} for k in self._last for value in k.values if value != start[k.key])
        while not found and (other := next(others, None)) is not None:
            found = self._candidates(other, limit)
        return found

    def _candidates(self, start: Settings, limit: float) -> list[M]:
        found: list[M] = []
        best: M | None = None
        for look in self._alternatives_by_promise(start, limit):
            if best is None or _promise(look, limit) < _HOPELESS * best.cost:
                held = self._hold_error(look.settings, limit, best)
                if held is not None:
                    found.append(held)
                    best = min(found, key=lambda trial: trial.cost)
        found.sort(key=lambda trial: trial.cost)
        return [trial for trial in found if trial.cost <= _MORE_EXPENSIVE * found[0].cost]

    def hold(self, settings: Settings, limit: float) -> M | None:
        """The cheapest settings with rmse <= ``limit`` that have the same alternatives as ``settings``."""
        held = self._hold_error(settings, limit)
        return None if held is None else self.refined(held, limit)

    def refined(self, best: M, limit: float) -> M:
        """``best`` made cheaper while rmse <= ``limit``, by alternatives that are tried alone and by the ladders."""
        for tunable in self._alone:
            for value in tunable.values:
                settings = {**best.settings, tunable.key: value}
                if not self._possible(settings):
                    continue
                tried = self.measure(settings)
                if tried.rmse <= limit and tried.cost <= _WORTH * best.cost:
                    best = tried
        for tunable in self._ladders:
            while (value := tunable.next_to(best.settings[tunable.key], -1)) is not None:
                tried = self.measure({**best.settings, tunable.key: value})
                if tried is best or tried.rmse > limit or tried.cost > _WORTH * best.cost:
                    break
                best = tried
        return self._stretched(best, limit)

    def _alternatives_by_promise(self, start: Settings, limit: float) -> list[M]:
        """One measurement for each combination of alternatives, ordered by the cost that it predicts."""
        looks = {}
        for values in itertools.product(*(tunable.values for tunable in self._alternatives)):
            settings = {**start, **{k.key: v for k, v in zip(self._alternatives, values)}}
            if self._possible(settings):
                looks[key_of(self._canonical(settings))] = self.measure(settings)
        return sorted(looks.values(), key=lambda look: _promise(look, limit))

    def _stretched(self, best: M, limit: float) -> M:
        """``best`` made cheaper by bisection between its value of the main ladder and the next coarser one."""
        for main in self._main[:1]:
            fine, coarse = best.settings[main.key], main.next_to(best.settings[main.key], -1)
            if not main.tunable.is_continuous or coarse is None:
                continue
            for _ in range(_STRETCHES):
                middle = float(f"{math.sqrt(fine * coarse):.3g}")
                tried = self.measure({**best.settings, main.key: middle})
                if tried.rmse <= limit:
                    fine = middle
                    best = tried if tried.cost <= best.cost else best
                else:
                    coarse = middle
        return best

    def _hold_error(
        self, settings: Settings, limit: float, best: M | None = None
    ) -> M | None:
        """The coarsest value of the main ladder with rmse <= ``limit``. If there is none, the other ladders are made
        more accurate, first by one notch and then by more."""
        held, too_expensive = self._bracket(settings, limit, best)
        notches = 1
        while held is None and not too_expensive:
            raised = {k.key: k.more(settings[k.key], notches) for k in self._ladders}
            finer = {**settings, **raised}
            held, too_expensive = self._bracket(finer, limit, best)
            if all(finer[k.key] == k.values[-1] for k in self._ladders):
                break
            notches *= 2
        return held

    def _bracket(
        self, settings: Settings, limit: float, best: M | None
    ) -> tuple[M | None, bool]:
        """The coarsest value of the main ladder with rmse <= ``limit``, if there is one, and whether the search was
        stopped because it costs more than ``best``."""
        if not self._main:
            tried = self.measure(settings)
            return (tried if tried.rmse <= limit else None), False
        main = self._main[0]
        values = main.values
        at = main.near(settings[main.key])
        low, high = -1, len(values)  # indices: the finest known to be too coarse, the coarsest known to suffice
        held: M | None = None
        history: list[tuple[int, float]] = []
        while high - low > 1:
            tried = self.measure({**settings, main.key: values[at]})
            if tried.rmse <= limit:
                held, high = tried, at
            else:
                low = at
                history.append((at, tried.rmse))
                # It is much more expensive than the best and not exact enough; a finer one only costs more.
                if best is not None and tried.cost > _MORE_EXPENSIVE * best.cost:
                    return held, True
                if _is_at_floor(history):
                    break
            ratio = tried.rmse / limit if tried.rmse > 0 else 0.0
            notches = math.ceil(math.log2(min(ratio, 1e9))) if ratio > 0 else -len(values)
            at = min(max(at + notches, low + 1), high - 1)
        return held, False


def _promise(look: Measured, limit: float) -> float:
    """The predicted cost of an error of ``limit``, assuming that the error falls with the square of the cost."""
    return look.cost * math.sqrt(max(look.rmse / limit, 1e-3)) if look.rmse < math.inf else math.inf


def pareto_front(points: list[M]) -> list[M]:
    """The points that no other beats in both error and time, ordered by rising time and falling error."""
    front: list[M] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.rmse)):
        if not front or point.rmse < front[-1].rmse:
            front.append(point)
    return front


def _is_at_floor(history: list[tuple[int, float]]) -> bool:
    at, rmse = history[-1]
    coarser = [e for k, e in history if k <= at - 2]
    return bool(coarser) and rmse > _FLOOR * min(coarser)
