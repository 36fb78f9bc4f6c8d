"""Looking for settings: the cheapest that hold an error.

Nothing here renders: ``measure(settings)`` does, and gives something with ``rmse``, ``seconds`` of
a picture and its ``cost`` (preparation counted in). What is known of the tunables is that a notch finer
of the main ladder (the step) lessens the error, about twofold; that alternatives (classification,
filter) may each be better or worse by far; and that the other ladders buy little with little, and
limit what the main one can reach.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any, Generic, Protocol, TypeVar

from clvol.accuracy.settings import SceneTunable, Settings, key_of

_FLOOR = 0.85  # two notches finer and still this share of the error: finer helps no more
_HOPELESS = 3.0  # times the best cost: what one look promises may be wrong by so much
_DEARER = 2.0  # times: what costs so much more on the pilot does so on the picture
_STRETCHES = 2  # halvings of a notch of the main ladder
_WORTH = 0.98  # what a change must bring the time down to, to be more than noise


class Measured(Protocol):
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
        # Single pixels do not show what depends on their neighbours.
        self._tunables = {k: tunable for k, tunable in tunables.items() if not tunable.tunable.of_picture}
        alternatives = [k for k in self._tunables.values() if not k.tunable.is_ladder]
        self._alternatives = [k for k in alternatives if not k.tunable.alone]
        self._alone = [k for k in alternatives if k.tunable.alone]
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
        """The cheapest settings found with rmse <= ``limit``; None if none reach it."""
        held = self.candidates(start, limit)
        return self.refined(held[0], limit) if held else None

    def candidates(self, start: Settings, limit: float) -> list[M]:
        """For each combination of alternatives that is not hopeless, settings that hold ``limit``, the
        cheapest first: costs that are known roughly may be compared again more exactly."""
        found: list[M] = []
        best: M | None = None
        for look in self._alternatives_by_promise(start, limit):
            if best is None or _promise(look, limit) < _HOPELESS * best.cost:
                held = self._hold_error(look.settings, limit, best)
                if held is not None:
                    found.append(held)
                    best = min(found, key=lambda trial: trial.cost)
        found.sort(key=lambda trial: trial.cost)
        return [trial for trial in found if trial.cost <= _DEARER * found[0].cost]

    def hold(self, settings: Settings, limit: float) -> M | None:
        """With the alternatives as they are in ``settings``: the cheapest that hold ``limit``."""
        held = self._hold_error(settings, limit)
        return None if held is None else self.refined(held, limit)

    def refined(self, best: M, limit: float) -> M:
        """``best`` with cheaper alternatives of tunables tried alone, and with cheaper ladders, as far
        as ``limit`` still holds."""
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
        """One look at each combination of alternatives, those first that promise to be cheapest."""
        looks = {}
        for values in itertools.product(*(tunable.values for tunable in self._alternatives)):
            settings = {**start, **{k.key: v for k, v in zip(self._alternatives, values)}}
            if self._possible(settings):
                looks[key_of(self._canonical(settings))] = self.measure(settings)
        return sorted(looks.values(), key=lambda look: _promise(look, limit))

    def _stretched(self, best: M, limit: float) -> M:
        """Between the main ladder's last value that holds and the first that does not."""
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
        """Of the main ladder's values the coarsest that holds ``limit``, the other ladders as they
        are or, if that is not enough, more accurate by one notch, then by more."""
        held, too_dear = self._bracket(settings, limit, best)
        notches = 1
        while held is None and not too_dear:
            raised = {k.key: k.more(settings[k.key], notches) for k in self._ladders}
            finer = {**settings, **raised}
            held, too_dear = self._bracket(finer, limit, best)
            if all(finer[k.key] == k.values[-1] for k in self._ladders):
                break
            notches *= 2
        return held

    def _bracket(
        self, settings: Settings, limit: float, best: M | None
    ) -> tuple[M | None, bool]:
        """What holds ``limit`` with the main ladder alone, if anything does; and whether that is given up
        because it costs more than ``best``."""
        if not self._main:
            tried = self.measure(settings)
            return (tried if tried.rmse <= limit else None), False
        main = self._main[0]
        values = main.values
        at = main.near(settings[main.key])
        low, high = -1, len(values)  # indices known to be too coarse; fine enough
        held: M | None = None
        history: list[tuple[int, float]] = []
        while high - low > 1:
            tried = self.measure({**settings, main.key: values[at]})
            if tried.rmse <= limit:
                held, high = tried, at
            else:
                low = at
                history.append((at, tried.rmse))
                # Dearer than the best by far and not yet good enough: finer can only be dearer.
                if best is not None and tried.cost > _DEARER * best.cost:
                    return held, True
                if _is_at_floor(history):
                    break
            ratio = tried.rmse / limit if tried.rmse > 0 else 0.0
            notches = math.ceil(math.log2(min(ratio, 1e9))) if ratio > 0 else -len(values)
            at = min(max(at + notches, low + 1), high - 1)
        return held, False


def _promise(look: Measured, limit: float) -> float:
    """What an error of ``limit`` may cost, if the error falls with the square of the cost."""
    return look.cost * math.sqrt(max(look.rmse / limit, 1e-3)) if look.rmse < math.inf else math.inf


def pareto_front(points: list[M]) -> list[M]:
    """Those that no other beats in both error and time: by falling error, rising time."""
    front: list[M] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.rmse)):
        if not front or point.rmse < front[-1].rmse:
            front.append(point)
    return front


def _is_at_floor(history: list[tuple[int, float]]) -> bool:
    at, rmse = history[-1]
    coarser = [e for k, e in history if k <= at - 2]
    return bool(coarser) and rmse > _FLOOR * min(coarser)
