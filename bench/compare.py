"""Two results of one suite beside each other: what became slower or less exact beyond the spread.

``python -m bench compare OLD.json NEW.json``. Times are compared where a result holds a summary of frames (median and
interquartile range): slower means that the medians lie further apart than half of each one's range. Errors, counts of
samples and memory do not vary from frame to frame; they have tolerances of their own below. Rows are matched by what
names them (scene, size, setting, ...), never by their place.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

LEAST_TIME = 0.02  # share of a time below which a change counts as none, however small the spread
LEAST_ERROR, LEAST_COUNT, LEAST_BYTES = 0.01, 0.001, 0.05
DEFAULT_SPREAD = 0.1  # of seconds that a result states without a spread

_ERRORS = ("rmse", "true", "bound", "error", "max_abs", "delta_e_mean", "delta_e_max", "delta_e", "finest", "ciede2000")
_LIKENESS = ("ssim", "psnr")  # more is better
_COUNTS = ("samples", "rays")
_BYTES = ("peak_bytes", "bytes_on_device", "device_bytes")
_NOT_MEASURED = {"machine", "load_before", "load_after", "goal", "min", "max", "frames", "times"}


@dataclass(frozen=True)
class Figure:
    """One measured number. ``spread``: half of what it may be off by chance, in the same unit."""

    kind: str  # "time", "error", "likeness", "count", "memory", "claim"
    value: float
    spread: float = 0.0


@dataclass(frozen=True)
class Change:
    where: str
    kind: str
    old: float
    new: float
    verdict: str  # "slower", "faster", "less exact", "more exact", "more work", "less work", ...

    @property
    def is_worse(self) -> bool:
        return self.verdict in _WORSE.values()

    def __str__(self) -> str:
        factor = f" ({self.new / self.old:.3g} times)" if self.old else ""
        return f"{self.verdict:<11} {self.where}: {self.old:.4g} -> {self.new:.4g}{factor}"


_WORSE = {"time": "slower", "error": "less exact", "likeness": "less exact", "count": "more work",
          "memory": "more memory", "claim": "fails"}  # fmt: skip
_BETTER = {"time": "faster", "error": "more exact", "likeness": "more exact", "count": "less work",
           "memory": "less memory", "claim": "holds"}  # fmt: skip


def figures(result: Any, where: tuple[str, ...] = ()) -> Iterator[tuple[str, Figure]]:
    """Every measured number of a result, with a name that does not depend on its place in the file."""
    if isinstance(result, dict):
        if isinstance(result.get("median"), (int, float)):
            half = 0.5 * float(result.get("spread", DEFAULT_SPREAD)) * result["median"]
            yield "/".join(where), Figure("time", float(result["median"]), half)
            return
        summarised = any(isinstance(item, dict) and "median" in item for item in result.values())
        for key, item in result.items():
            if key in _NOT_MEASURED:
                continue
            if isinstance(item, (dict, list)):
                yield from figures(item, (*where, key))
            elif (figure := _figure(key, item, result, summarised)) is not None:
                yield "/".join((*where, key)), figure
    elif isinstance(result, list):
        if where and where[-1] == "errors" and all(isinstance(item, (int, float)) for item in result):
            for index, item in enumerate(result):
                yield f"{'/'.join(where)}/{index}", Figure("error", float(item))
            return
        named = [(_name(item), item) for item in result if isinstance(item, dict)]
        names = [name for name, _ in named]
        for index, (name, item) in enumerate(named):
            alike = names.count(name) > 1
            yield from figures(item, (*where, f"{name}#{names[:index].count(name)}" if alike else name))


def compare(old: dict[str, Any], new: dict[str, Any]) -> list[Change]:
    """What changed beyond the spread, the worst first; what only one of the two holds is left out."""
    before, changes = dict(figures(old)), []
    for where, figure in figures(new):
        if where in before and before[where].kind == figure.kind:
            verdict = _verdict(before[where], figure)
            if verdict is not None:
                changes.append(Change(where, figure.kind, before[where].value, figure.value, verdict))
    return sorted(changes, key=lambda change: (not change.is_worse, change.kind, -_factor(change)))


def report(old: dict[str, Any], new: dict[str, Any]) -> tuple[str, bool]:
    """What to print, and whether nothing became worse."""
    changes = compare(old, new)
    shared = dict(figures(old)).keys() & dict(figures(new)).keys()
    worse = [change for change in changes if change.is_worse]
    lines = [*_cautions(old, new), *map(str, changes)]
    if not shared:
        lines.append("The two results have no figure in common.")
    lines.append(
        f"{len(shared)} figures compared: {len(worse)} worse, {len(changes) - len(worse)} better,"
        f" {len(shared) - len(changes)} within the spread"
    )
    return "\n".join(lines), bool(shared) and not worse


def main(paths: list[str]) -> int:
    """Compares two files; 0: nothing is worse, 1: something is, 2: they cannot be compared."""
    if len(paths) != 2:
        print(f"bench compare: got {len(paths)} files, expected OLD.json NEW.json")
        return 2
    results = []
    for path in paths:
        try:
            result = json.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            print(f"{path}: {error}, expected a result of 'python -m bench'")
            return 2
        if not isinstance(result, dict) or "machine" not in result:
            print(f"{path}: no machine is named in it, expected a result of 'python -m bench'")
            return 2
        results.append(result)
    text, fine = report(*results)
    print(text)
    return 0 if fine else 1


def _figure(key: str, item: Any, row: dict[str, Any], summarised: bool) -> Figure | None:
    if isinstance(item, bool):
        return Figure("claim", float(item)) if key in ("holds", "held", "same") else None
    if not isinstance(item, (int, float)):
        return None
    if key == "seconds" and not summarised:
        spread = row.get("spread", DEFAULT_SPREAD)
        return Figure("time", float(item), 0.5 * float(spread) * item)
    for kind, keys in (("error", _ERRORS), ("likeness", _LIKENESS), ("count", _COUNTS), ("memory", _BYTES)):
        if key in keys:
            return Figure(kind, float(item))
    return None


def _verdict(old: Figure, new: Figure) -> str | None:
    change = new.value - old.value
    least = {"time": LEAST_TIME, "error": LEAST_ERROR, "likeness": 1e-4, "count": LEAST_COUNT, "memory": LEAST_BYTES}
    if abs(change) <= max(old.spread + new.spread, least.get(old.kind, 0.0) * abs(old.value)):
        return None
    if old.kind == "error" and max(old.value, new.value) < 1e-9:  # double precision has no more
        return None
    grows = change < 0 if old.kind in ("likeness", "claim") else change > 0
    return (_WORSE if grows else _BETTER)[old.kind]


def _factor(change: Change) -> float:
    return max(change.new, 1e-30) / max(change.old, 1e-30)


def _name(row: dict[str, Any]) -> str:
    """What tells a row from its neighbours: its texts, and the numbers that were set and not measured."""
    parts = []
    for key, item in row.items():
        if isinstance(item, str) and len(item) <= 40 and key not in _TOLD:
            parts.append(item)
        elif key in _SET and isinstance(item, (int, float)) and not isinstance(item, bool):
            parts.append(f"{key} {item:g}")
    return ", ".join(parts) or "row"


_TOLD = ("title", "reason", "kernel", "kernel_hash", "settings")
_SET = ("edge", "size", "max_error", "step", "epsilon", "levels", "value", "cost", "ratio_asked", "tiles", "asked")


def _cautions(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    lines = []
    for what in ("processor", "cores", "device"):
        a, b = (result["machine"].get(what) for result in (old, new))
        if a != b:
            lines.append(f"caution: the {what} differs: {_told(a)} and {_told(b)}")
    if old.get("quick") or new.get("quick"):
        lines.append("caution: a quick run at a small size: its times are no results")
    return lines


def _told(value: Any) -> str:
    return str(value.get("name", value)) if isinstance(value, dict) else str(value)
