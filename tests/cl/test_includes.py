"""Headers of cl/: what includes what."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from clvol.opencl.kernels_path import kernel_folder

FILES = sorted(path for path in kernel_folder().iterdir() if path.suffix in (".h", ".cl"))


def includes(folder: Path) -> dict[str, list[str]]:
    """The files of ``folder`` that each of its files includes, whatever the switches."""
    names = {path.name: path for path in folder.iterdir() if path.suffix in (".h", ".cl")}
    found = {name: re.findall(r'^\s*#\s*include\s*"([^"]+)"', path.read_text(), re.MULTILINE) for name, path in names.items()}
    return {name: [other for other in others if other in names] for name, others in found.items()}


def include_cycle(graph: dict[str, list[str]]) -> list[str]:
    """Files of which each includes the next and the last one the first; empty where there are none."""
    done: set[str] = set()

    def search(name: str, path: list[str]) -> list[str]:
        if name in path:
            return path[path.index(name) :]
        if name in done:
            return []
        for other in graph[name]:
            if cycle := search(other, [*path, name]):
                return cycle
        done.add(name)
        return []

    for name in graph:
        if cycle := search(name, []):
            return cycle
    return []


def test_no_file_includes_itself():
    assert include_cycle(includes(kernel_folder())) == []


def test_cycles_are_found():
    assert include_cycle({"a": ["b", "c"], "b": [], "c": ["d"], "d": ["a"]}) == ["a", "c", "d"]
    assert include_cycle({"a": ["b", "c"], "b": ["c"], "c": []}) == []


def test_no_kernel_is_included_but_by_a_test():
    graph = includes(kernel_folder())
    assert not [(name, other) for name, others in graph.items() for other in others if other.endswith(".cl")]


@pytest.mark.parametrize("path", [path for path in FILES if path.suffix == ".h"], ids=lambda path: path.name)
def test_headers_are_guarded(path):
    guard = path.name.upper().replace(".", "_")
    text = re.sub(r"/\*.*?\*/", "", path.read_text(), flags=re.DOTALL).split()
    assert text[:4] in (["#ifndef", guard, "#define", guard], ["#ifndef", f"{guard}_INCLUDED", "#define", f"{guard}_INCLUDED"])
    assert text[-1] == "#endif"
