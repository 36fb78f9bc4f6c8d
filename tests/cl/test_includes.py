"""Headers of cl/: what includes what."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from clvol.opencl.kernels_path import kernel_folder

FILES = sorted(path for path in kernel_folder().iterdir() if path.suffix in (".h", ".cl"))
_INCLUDED = re.compile(r'^\s*#\s*include\s*"([^"]+)"', re.MULTILINE)


def includes(folder: Path) -> dict[str, list[str]]:
    """The files of ``folder`` that each of its files includes, whatever the switches."""
    names = {path.name: path for path in folder.iterdir() if path.suffix in (".h", ".cl")}
    found = {name: _INCLUDED.findall(path.read_text()) for name, path in names.items()}
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
    assert text[:4] == ["#ifndef", guard, "#define", guard] and text[-1] == "#endif"


_NAMES = re.compile(r"^#define (\w+)|^typedef (?:\w+ )+(\w+)(?: __attribute__.*)?;|^\} (\w+);", re.MULTILINE)
_FUNCTIONS = re.compile(r"^(?:INLINE|inline|RARE|LOOKED_UP|void|int|static)\b[^;{=(]*?\b(\w+)\(", re.MULTILINE)


def code_of(path: Path) -> str:
    """Without comments, strings, includes, and names of members."""
    code = re.sub(r'/\*.*?\*/|#include.*?\n|"[^"\n]*"', " ", path.read_text(), flags=re.DOTALL)
    return re.sub(r"(?:\.|->)[A-Za-z_]\w*", " ", code)


def defined_in(code: str) -> set[str]:
    """Macros and types as they are, functions with a "(" behind."""
    names = {name for match in _NAMES.finditer(code) for name in match.groups() if name}
    return names | {f"{match[1]}(" for match in _FUNCTIONS.finditer(code)}


def used_in(code: str) -> set[str]:
    return set(re.findall(r"\b[A-Za-z_]\w*\b", code)) | set(re.findall(r"\b[A-Za-z_]\w*\(", code))


def reached(graph: dict[str, list[str]], name: str) -> set[str]:
    """``name``, the files that it includes, and those that these include."""
    found, waiting = set(), [name]
    while waiting:
        if (file := waiting.pop()) not in found:
            found.add(file)
            waiting += graph[file]
    return found


def test_files_include_what_they_use():
    """Whatever a file uses that a header defines, it includes, itself or by way of others."""
    graph = includes(kernel_folder())
    codes = {path.name: code_of(path) for path in FILES}
    definers: dict[str, set[str]] = {}
    for name, code in codes.items():
        if name.endswith(".h"):
            for word in defined_in(code):
                definers.setdefault(word, set()).add(name)
    missing = []
    for name, code in codes.items():
        held, own = reached(graph, name), defined_in(code)
        own |= {word.removesuffix("(") for word in own}
        for word in used_in(code) - own:
            if word in definers and not definers[word] & held:
                missing.append(f"{name} uses {word} of {', '.join(sorted(definers[word]))}")
    assert sorted(missing) == []
