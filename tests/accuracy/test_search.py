"""The search for the cheapest settings, on models of rendering whose best settings are known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import pytest

from clvol.accuracy.search import Search, pareto_front
from clvol.accuracy.settings import SceneTunable
from clvol.accuracy.tunables import Tunable
from clvol.scene.sizes import parse_size

STEPS = tuple(2.0 ** (k / 2) for k in range(6, -11, -1))


@dataclass(eq=False)
class Point:
    settings: dict
    rmse: float
    seconds: float

    @property
    def cost(self) -> float:
        return self.seconds


def tunable(key, values, **how) -> SceneTunable:
    return SceneTunable(key, Tunable(key, "", values, **how), values, values[0], "")


KNOBS = {
    k.key: k
    for k in (
        tunable("step", STEPS, is_main=True),
        tunable("kind", ("a", "b", "c"), is_ladder=False),
        tunable("table", (32, 64, 128, 256)),
        tunable("spacing", (4, 2, 1), of_picture=True),
    )
}
START = {"step": 1.0, "kind": "a", "table": 64, "spacing": 1}


def model(settings) -> Point:
    """"a": second order, quick; "b": as good at once, three times as dear; "c": wrong for ever."""
    step, kind = settings["step"], settings["kind"]
    sampling = {"a": 1e-2 * step**2, "b": 1e-3 * step**2, "c": 5e-2 + 1e-3 * step}[kind]
    table = 1.0 / settings["table"] ** 2
    weight = {"a": 1.0, "b": 3.0, "c": 0.3}[kind]
    seconds = weight / step * (1 + 1e-3 * settings["table"])
    return Point(dict(settings), math.hypot(sampling, table), seconds)


def searched(limit, start=START, measure=model, **how):
    calls = []

    def counted(settings):
        calls.append(settings)
        return measure(settings)

    search = Search(counted, KNOBS, **how)
    return search.cheapest(start, limit), calls


def best_of_all(limit):
    points = [
        model({"step": s, "kind": k, "table": t, "spacing": 1})
        for s, k, t in product(STEPS, "abc", (32, 64, 128, 256))
    ]
    return min((p for p in points if p.rmse <= limit), key=lambda p: p.seconds, default=None)


@pytest.mark.parametrize("limit", [0.3, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4])
def test_it_finds_the_cheapest_or_nearly_and_looks_at_few(limit):
    found, calls = searched(limit)
    assert found.rmse <= limit
    assert found.seconds <= 1.4 * best_of_all(limit).seconds
    assert len(calls) <= 40
    keys = [tuple(sorted(call.items())) for call in calls]
    assert len(set(keys)) == len(keys), "nothing is measured twice"


def test_what_cannot_be_held_is_said_not_to_be():
    assert searched(1e-9)[0] is None


def test_tables_that_limit_are_refined_and_those_that_do_not_are_not():
    assert searched(5e-5)[0].settings["table"] == 256
    assert searched(1e-1)[0].settings["table"] == 32


def test_tunables_of_pictures_are_left_alone():
    assert {call["spacing"] for call in searched(1e-3)[1]} == {1}


def test_what_is_impossible_is_never_measured():
    _, calls = searched(1e-3, possible=lambda settings: settings["kind"] != "b")
    assert "b" not in {call["kind"] for call in calls}


def test_an_alternative_with_a_floor_is_given_up_early():
    _, calls = searched(1e-3)
    assert sum(call["kind"] == "c" for call in calls) <= 12


def test_an_error_of_nothing_at_all_is_no_trouble():
    found, _ = searched(1e-3, measure=lambda s: Point(dict(s), 0.0, 1.0 / s["step"]))
    assert found.settings["step"] == STEPS[0]
    infinite, _ = searched(1e-3, measure=lambda s: Point(dict(s), math.inf, 1.0))
    assert infinite is None


def test_the_front_has_what_nothing_beats():
    points = [Point({}, e, t) for e, t in [(1.0, 1.0), (0.5, 2.0), (0.6, 3.0), (0.5, 2.5), (0.1, 9.0)]]
    assert [(p.rmse, p.seconds) for p in pareto_front(points)] == [(1.0, 1.0), (0.5, 2.0), (0.1, 9.0)]
    assert pareto_front([]) == []


def test_alternatives_that_are_tried_alone_are_not_combined_but_taken_where_they_are_cheaper():
    """Two more tunables of four values: 16 times as many combinations, and only few more looks."""
    more = {
        key: tunable(key, ("w", "x", "y", "z"), is_ladder=False, alone=True) for key in ("one", "two")
    }
    factors = {"w": 1.0, "x": 0.5, "y": 2.0, "z": 0.4}

    def measure(settings):
        point = model(settings)
        wrong = 3.0 if settings["two"] == "z" else 1.0  # cheap, and not good enough
        seconds = point.seconds * factors[settings["one"]] * factors[settings["two"]]
        return Point(dict(settings), wrong * point.rmse, seconds)

    looks = []

    def counted(settings):
        looks.append(settings)
        return measure(settings)

    search = Search(counted, {**KNOBS, **more})
    best = search.cheapest({**START, "one": "w", "two": "w"}, 1e-3)
    assert best.rmse <= 1e-3
    assert (best.settings["one"], best.settings["two"]) == ("z", "x")
    plain = []
    Search(lambda s: plain.append(s) or model(s), KNOBS).cheapest(START, 1e-3)
    assert len(looks) <= len(plain) + 12


def test_values_that_are_no_numbers_have_an_order_of_their_own():
    sizes = ("900 KiB", "2 MiB", "16 MiB", "1 GiB")
    memory = tunable("memory", sizes, order=parse_size)
    assert memory.next_to("2 MiB", 1) == "16 MiB" and memory.next_to("2 MiB", -1) == "900 KiB"
    assert memory.next_to("3 MiB", 1) == "16 MiB" and memory.next_to("3 MiB", -1) == "2 MiB"
    assert memory.next_to("1 KiB", 1) == "900 KiB" and memory.next_to("2 GiB", 1) is None
    assert memory.more("3 MiB", 9) == "1 GiB" and memory.near("3 MiB") == 1
