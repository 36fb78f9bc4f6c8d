"""Kernel sources with every ``#include`` replaced by the included file.

Compilers get one text and no ``-I``: OpenCL implementations differ in how they parse an option with a blank, a quote
or another special character in it, and an installation may lie in any folder.
``#line`` keeps the files and the line numbers of a compiler's messages.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path

from clvol.errors import RenderError

_NOT_CODE = re.compile(r"""//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*'""", re.DOTALL)
_DIRECTIVE = re.compile(r"^[ \t]*#[ \t]*(\w+)[ \t]*(.*?)[ \t]*$", re.MULTILINE)
_QUOTED = re.compile(r'"([^"\n]+)"')
_DEEPEST = 64


@dataclass(frozen=True)
class _File:
    lines: tuple[str, ...]
    directives: tuple[tuple[int, str, str], ...]  # line, name, the rest without comments
    guarded: bool  # all of it between #ifndef NAME, #define NAME and the last #endif
    once: bool  # #pragma once

    @cached_property
    def _joined(self) -> dict[tuple[int, int], str]:
        return {}

    def part(self, start: int, end: int) -> list[str]:
        """The text of the lines from ``start`` to before ``end``, if there are any. Many files are expanded often."""
        if start == end:
            return []
        if (start, end) not in self._joined:
            self._joined[start, end] = "\n".join(self.lines[start:end])
        return [self._joined[start, end]]


def whole_source(path: Path, folders: Sequence[Path]) -> str:
    """The text of ``path`` with what it includes, from the including file's folder or from ``folders``.

    A guarded file that is there already is not repeated. One that cannot be found becomes an
    ``#error``, which counts only where the preprocessor gets there. Raises
    :class:`clvol.errors.RenderError` for a file that cannot be read, or that includes itself.
    """
    out: list[str] = []
    _expand(os.fspath(path), _Files([os.fspath(folder) for folder in folders]), frozenset(), (), out)
    return "\n".join(out) + "\n"


class _Files:
    """Files as they are during one call, each looked for and read once: many are included from many places. They go by
    their paths as texts, which are compared many times as fast as ``Path`` objects."""

    def __init__(self, folders: Sequence[str]) -> None:
        self._folders = folders
        self._found: dict[tuple[str, str], str | None] = {}
        self._read: dict[str, _File] = {}

    def find(self, name: str, includer: str) -> str | None:
        key = name, os.path.dirname(includer)
        if key not in self._found:
            self._found[key] = _find(name, (key[1], *self._folders))
        return self._found[key]

    def read(self, path: str) -> _File:
        if path not in self._read:
            self._read[path] = _read(path)
        return self._read[path]


def _expand(path: str, files: _Files, held: frozenset, within: tuple[str, ...], out: list[str]) -> frozenset:
    """Appends the lines of ``path`` to ``out``. ``held``: guarded files that are certainly above this
    place, whatever the conditions; returned with those that this file adds."""
    file = files.read(path)
    within = (*within, path)
    name = _shown(path)
    if len(within) > _DEEPEST:
        raise RenderError(name, "includes itself", "an include guard")
    once = f"CLVOL_ONCE_{_identity(path)}"
    if file.once:
        out += [f"#ifndef {once}", f"#define {once}"]
    out.append(f'#line 1 "{name}"')
    before: list[frozenset] = []  # held, at each #if that is open
    depth = 0
    done = 0
    for number, directive, rest in file.directives:
        if directive in ("if", "ifdef", "ifndef"):
            depth += 1
            if not (file.guarded and depth == 1):
                before.append(held)
        elif directive in ("elif", "else", "endif") and before:
            # What one branch includes is there only if its condition holds.
            held = before[-1]
            if directive == "endif":
                before.pop()
        if directive == "endif":
            depth -= 1
        is_once = directive == "pragma" and rest == "once"
        if directive != "include" and not is_once:
            continue
        quoted = _QUOTED.match(rest)
        if not (quoted or is_once):  # <...>, or a macro: left to the compiler
            continue
        out += file.part(done, number)
        done = number + 1
        if quoted is None or is_once:
            out.append("")
            continue
        found = files.find(quoted[1], path)
        if found is None:
            out.append(f'#error "{_shown(quoted[1])} is not found"')
        elif found in held or (found in within and files.read(found).guarded):
            out.append("")
        else:
            held = _expand(found, files, held, within, out)
            out.append(f'#line {number + 2} "{name}"')
    out += file.part(done, len(file.lines))
    if file.once:
        out.append("#endif")
    return held | {path} if file.guarded or file.once else held


def _find(name: str, folders: Sequence[str]) -> str | None:
    for folder in folders:
        path = os.path.normpath(os.path.join(folder, name))
        if os.path.isfile(path):
            return path
    return None


@cache
def _shown(path: str) -> str:
    """A file's name in a form that ``#line`` accepts."""
    return re.sub(r"[^\w.+-]", "_", os.path.basename(path), flags=re.ASCII)


def _identity(path: str) -> str:
    return re.sub(r"\W", "_", os.path.basename(path), flags=re.ASCII)


def _read(path: str) -> _File:
    try:
        status = os.stat(path)
        return _parsed(path, status.st_mtime_ns, status.st_size, status.st_ino)
    except OSError as error:
        raise RenderError(path, f"cannot be read ({error.strerror})", "a kernel source") from None
    except UnicodeDecodeError:
        raise RenderError(path, "is not text in UTF-8", "a kernel source") from None


@lru_cache(maxsize=256)
def _parsed(path: str, *_version: int) -> _File:
    with open(path, encoding="utf-8") as file:
        text = file.read()
    # Comments go, but not their lines: nothing in them shall look like a directive, and the text is
    # half as long.
    code = _NOT_CODE.sub(lambda m: m[0] if m[0][0] in "\"'" else " " + "\n" * m[0].count("\n"), text)
    directives = []
    at = line = 0
    for match in _DIRECTIVE.finditer(code):
        line += code.count("\n", at, match.start())
        at = match.start()
        directives.append((line, match[1], match[2]))
    once = any(name == "pragma" and rest == "once" for _, name, rest in directives)
    lines = tuple([line.rstrip() for line in code.split("\n")])
    return _File(lines, tuple(directives), _is_guarded(code, directives), once)


def _is_guarded(code: str, directives: list[tuple[int, str, str]]) -> bool:
    if len(directives) < 3 or directives[-1][1] != "endif":
        return False
    (first, opens, guard), (_, defines, defined) = directives[:2]
    if opens != "ifndef" or defines != "define" or defined.split()[:1] != [guard]:
        return False
    depth = 0
    for number, (_, name, _rest) in enumerate(directives):
        depth += name in ("if", "ifdef", "ifndef")
        depth -= name == "endif"
        is_last = number == len(directives) - 1
        if (depth == 0 and not is_last) or (depth == 1 and name in ("else", "elif")):
            return False
    lines = code.split("\n")
    outside = lines[:first] + lines[directives[-1][0] + 1 :]
    return depth == 0 and not any(line.strip() for line in outside)
