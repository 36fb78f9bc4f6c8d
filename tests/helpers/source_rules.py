"""What the source of clvol/ and cl/ says about its own structure, read with ``ast``: imports, includes, comparisons.

    python tests/helpers/source_rules.py     # writes what breaks the rules today to tests/house_exceptions.json

That file may only shrink: tests/test_house.py fails where something breaks a rule that is not in it, and where it
lists something that no longer does.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# From the bottom up: a module imports its own room and rooms that are listed before it.
ORDER = (
    ("errors", "text", "interrupts", "limits", "json_values", "quietly", "cache_folder", "lazily",
     "temporaries"),
    ("volume",), ("inputs",), ("transfer",), ("store",), ("readers",), ("choice",), ("image",), ("scene",),
    ("features",), ("overlay",), ("schedule",), ("opencl",), ("device",), ("encoding",), ("integrators",),
    ("render", "explanation"), ("accuracy",), ("bricks",), ("batch",), ("cluster",), ("cli",),
)  # fmt: skip
LEVEL = {room: level for level, rooms in enumerate(ORDER) for room in rooms}
EXCEPTIONS = ROOT / "tests" / "house_exceptions.json"
README_LINES = 200
_INTEGRATORS = {"raycast", "multiresolution", "pyramid", "reference", "slicing"}


@dataclass(frozen=True)
class Import:
    source: str  # "clvol.render.engines"
    target: str  # likewise, a module of clvol
    name: str  # what is imported of it; "" for the module itself
    hidden: bool  # inside a function

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


@cache
def modules() -> dict[str, Path]:
    """Each module of clvol by its name: "clvol.cli" for clvol/cli/__init__.py."""
    found = {}
    for path in sorted((ROOT / "clvol").rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(modules()[module].read_text(encoding="utf-8"))


def room(module: str) -> str:
    """"render" of "clvol.render.engines"; "" of clvol itself and of clvol.__main__."""
    name = module.split(".")[1] if "." in module else ""
    return "" if name == "__main__" else name


@cache
def imports() -> tuple[Import, ...]:
    """All of clvol from clvol, but for those that only type checkers see."""
    return tuple(found for module in modules() for found in _imports_of(module))


def _imports_of(module: str) -> Iterator[Import]:
    def visit(node: ast.AST, hidden: bool) -> Iterator[Import]:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            for other in node.orelse:
                yield from visit(other, hidden)
            return
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "clvol":
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield Import(module, whole if whole in modules() else str(node.module), alias.name, hidden)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "clvol":
                    yield Import(module, alias.name, "", hidden)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "lazily":
            target = node.args[0].value if isinstance(node.args[0], ast.Constant) else ""
            if target in modules():
                yield Import(module, target, "", hidden)
        inside = hidden or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        for child in ast.iter_child_nodes(node):
            yield from visit(child, inside)

    yield from visit(tree(module), False)


def imported_names(path: Path) -> set[str]:
    """The first words of all that a file imports: "numpy" of numpy.linalg."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.split(".")[0])
        elif isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
    return found


def _compares_method(node: ast.AST) -> bool:
    """Whether an attribute ``method`` is compared with an integrator's name."""
    if not isinstance(node, ast.Compare):
        return False
    sides = (node.left, *node.comparators)
    words = {part.value for side in sides for part in ast.walk(side) if isinstance(part, ast.Constant)}
    return bool(words & _INTEGRATORS) and any(isinstance(s, ast.Attribute) and s.attr == "method" for s in sides)


@cache
def includes() -> dict[str, tuple[str, ...]]:
    """By file of cl/: the files of cl/ that it includes."""
    files = {path.name: path for path in (ROOT / "cl").iterdir() if path.suffix in (".cl", ".h")}
    return {
        name: tuple(i for i in re.findall(r'^\s*#\s*include\s+"([^"]+)"', path.read_text(), re.M) if i in files)
        for name, path in sorted(files.items())
    }


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """The sets of nodes that reach one another (strongly connected components of two nodes or more), sorted."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def connect(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(edges.get(node, ())):
            if other not in index:
                connect(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            at = stack.index(node)
            part, stack[at:] = stack[at:], []
            if len(part) > 1:
                found.append(sorted(part))

    for node in sorted(edges):
        if node not in index:
            connect(node)
    return sorted(found)


# --- the rules: each gives {where: how many times it is broken there} -----------------------------


def _counted(places: Iterator[str]) -> dict[str, int]:
    found: dict[str, int] = {}
    for place in places:
        found[place] = found.get(place, 0) + 1
    return found


def upward_imports() -> dict[str, int]:
    """Imports of a room that is listed after the importing one in ORDER. clvol itself (its version and public names)
    is for cli/ alone, its version for all."""

    def is_upward(one: Import) -> bool:
        if not room(one.source):
            return False
        if not room(one.target):
            return room(one.source) != "cli" and one.name not in ("", "__version__")
        return LEVEL[room(one.target)] > LEVEL[room(one.source)]

    return _counted(str(one) for one in imports() if is_upward(one))


def hidden_imports() -> dict[str, int]:
    """Imports of clvol inside functions outside cli/ and the package's lazy top level."""
    return _counted(one.source for one in imports() if one.hidden and room(one.source) not in ("", "cli"))


def import_circles() -> dict[str, int]:
    """Modules from which a way of imports leads back to themselves."""
    edges: dict[str, set[str]] = {module: set() for module in modules()}
    for one in imports():
        if one.target != one.source and room(one.target):
            edges[one.source].add(one.target)
    return _counted(module for circle in circles(edges) for module in circle)


def include_circles() -> dict[str, int]:
    """Files of cl/ likewise."""
    return _counted(file for circle in circles({k: set(v) for k, v in includes().items()}) for file in circle)


def pyopencl_imports() -> dict[str, int]:
    """Modules outside opencl/ that import pyopencl."""
    return _counted(
        module for module, path in modules().items()
        if room(module) != "opencl" and "pyopencl" in imported_names(path)
    )  # fmt: skip


def comparisons_of_integrators() -> dict[str, int]:
    """Comparisons of ``method`` with an integrator's name outside the registry."""
    return _counted(
        module for module in modules() if module != "clvol.integrators.registry"
        for node in ast.walk(tree(module)) if _compares_method(node)
    )  # fmt: skip


def private_citations() -> dict[str, int]:
    """Papers cited as P1 to P4, which the repository does not explain."""
    files = [
        path for folder in ("clvol", "cl", "bench", "tests") for path in sorted((ROOT / folder).rglob("*"))
        if path.suffix in (".py", ".h", ".cl", ".md") and path.name != Path(__file__).name
    ]  # fmt: skip
    files += [ROOT / "README.md"]
    return _counted(
        path.relative_to(ROOT).as_posix()
        for path in files for _ in re.findall(r"\bP[1-4]\b", path.read_text(encoding="utf-8"))
    )  # fmt: skip


def long_readme() -> dict[str, int]:
    """Lines of README.md beyond README_LINES."""
    lines = len((ROOT / "README.md").read_text(encoding="utf-8").splitlines())
    return {"README.md": lines - README_LINES} if lines > README_LINES else {}


RULES = (
    upward_imports, hidden_imports, import_circles, include_circles, pyopencl_imports, comparisons_of_integrators,
    private_citations, long_readme,
)  # fmt: skip


def main() -> int:
    found = {rule.__name__: dict(sorted(rule().items())) for rule in RULES}
    EXCEPTIONS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    for name, places in found.items():
        print(f"{name}: {sum(places.values())} in {len(places)} places")
    return 0


if __name__ == "__main__":
    sys.exit(main())
