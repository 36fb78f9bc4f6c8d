"""How results look: tables on the terminal, JSON, and what they were measured on."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).resolve().parent.parent


def say(text: str) -> None:
    print(text, flush=True)


def table(head: Sequence[str], rows: Sequence[Sequence[Any]], left: int = 1) -> str:
    """Aligned columns: the first ``left`` to the left, the rest to the right."""
    cells = [list(map(str, row)) for row in (head, *rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    lines = [
        "  ".join(c.ljust(w) if i < left else c.rjust(w) for i, (c, w) in enumerate(pairs))
        for pairs in ([*zip(row, widths)] for row in cells)
    ]
    return "\n".join(line.rstrip() for line in (lines[0], "-" * len(lines[0]), *lines[1:]))


def opening(device: Any, quick: bool, size: int) -> dict[str, Any]:
    """What the result of a run of several parts has before the first of them. ``size``: of pictures."""
    return {
        "machine": machine(device), "quick": quick, "load_before": load_average(), "size": size,
        "missing": [], "failed": [],
    }  # fmt: skip


def closing(result: dict[str, Any]) -> list[str]:
    """The last lines of what a run of several parts tells: how long it took, and what is not in it."""
    lines = [
        f"{result['seconds']:.0f} s in all; load average {result['load_before']} to"
        f" {result['load_after']}"
    ]
    if result["failed"]:
        lines.append("failed: " + "; ".join(result["failed"]))
    if result["missing"]:
        lines.append(f"left out, no volume: {', '.join(sorted(set(result['missing'])))}")
    if result["quick"]:
        lines.append("This was a quick run at a small size: no figure of it is a result.")
    return lines


def load_average() -> list[float] | None:
    return [round(x, 2) for x in os.getloadavg()] if hasattr(os, "getloadavg") else None


def machine(device: Any = None) -> dict[str, Any]:
    """The processor, the versions, the commit, and the OpenCL device that was measured."""
    from importlib.metadata import PackageNotFoundError, version

    def installed(name: str) -> str | None:
        try:
            return version(name)
        except PackageNotFoundError:
            return None

    found = {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "packages": {name: installed(name) for name in ("clvol", "numpy", "pyopencl", "vtk")},
        "commit": _commit(),
    }
    if device is not None:
        found["device"] = {
            "name": device.name.strip(),
            "platform": device.platform.name.strip(),
            "driver": device.driver_version.strip(),
            "compute_units": device.max_compute_units,
        }
    return found


def save(folder: Path, name: str, result: dict[str, Any]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    os.replace(temporary, path)
    return path


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _commit() -> str | None:
    """The commit, with a plus where files differ from it; None outside a checkout."""
    try:
        commit, changes = (
            subprocess.run(
                ["git", *arguments], cwd=_ROOT, capture_output=True, text=True, check=True
            ).stdout.strip()
            for arguments in (
                ("rev-parse", "--short", "HEAD"),
                ("status", "--porcelain", "--untracked-files=no"),
            )
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return commit + ("+" if changes else "")
