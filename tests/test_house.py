"""The house's rules: which way imports run, what only one room does, how long the README may be."""

from __future__ import annotations

import json

import pytest
from helpers import source_rules
from helpers.source_rules import EXCEPTIONS, LEVEL, RULES, circles, modules, room

UPDATE = "python tests/helpers/source_rules.py"


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_a_rule_is_broken_where_that_is_known_and_nowhere_else(rule):
    found = rule()
    known = json.loads(EXCEPTIONS.read_text(encoding="utf-8"))[rule.__name__]
    more = {place: n for place, n in found.items() if n > known.get(place, 0)}
    assert not more, f"{rule.__doc__} New here: {more}"
    fewer = {place: n for place, n in known.items() if found.get(place, 0) < n}
    assert not fewer, f"no longer needed in {EXCEPTIONS.name}: {sorted(fewer)}; update it by `{UPDATE}`"


def test_every_room_has_its_place_in_the_order():
    assert {room(module) for module in modules()} - {""} <= LEVEL.keys()


def test_circles_are_found():
    edges = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": {"e"}, "e": set(), "f": {"g"}, "g": {"f"}}
    assert circles(edges) == [["a", "b", "c"], ["f", "g"]]
    assert circles({"a": {"b"}, "b": set()}) == []


def test_tests_import_no_bench_and_no_other_test_and_the_bench_no_tests():
    for path in sorted((source_rules.ROOT / "tests").rglob("*.py")):
        imported = source_rules.imported_names(path)
        if "bench" not in path.relative_to(source_rules.ROOT).parts:
            assert "bench" not in imported, path
        assert not {name for name in imported if name.startswith("test_") or name == "conftest"}, path
    for folder in ("bench", "clvol"):
        for path in sorted((source_rules.ROOT / folder).rglob("*.py")):
            assert not {"tests", "helpers", "reference"} & source_rules.imported_names(path), path
