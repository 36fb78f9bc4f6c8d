"""Whole processes: how long ``clvol --help`` and a warm ``clvol render`` take, and peak memory.

Each command runs as a user would run it, in a process of its own; a small process that loads
nothing else starts it and asks the system for its wall time and the largest resident size (a
child's size includes its parent's at the fork, so the parent has to be small). One run
before is not counted.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from bench.options import Options
from bench.report import load_average, machine, say, table
from bench.scenes import VOLUMES
from clvol.accuracy.timing import summary

SUMMARY = "whole-process times of clvol --help and clvol render, and peak memory"
HELP_GOAL, RENDER_GOAL, MEMORY_GOAL = 0.4, 2.0, 350e6  # seconds, seconds, bytes beyond the volume
_ROOT = Path(__file__).resolve().parent.parent
_CHILD = Path(__file__).resolve().parent / "child.py"


def run(options: Options) -> dict[str, Any] | None:
    runs = 3 if options.quick else max(options.frames, 7)
    program = Path(sys.executable).parent / "clvol"
    clvol = [str(program)] if program.exists() else [sys.executable, "-m", "clvol"]
    chosen = ["--device", options.device] if options.device else []
    with tempfile.TemporaryDirectory() as folder:
        output = ["-o", str(Path(folder) / "picture.exr"), *chosen]
        picture = ["--set", "image.width=512", "--set", "image.height=512"]
        demo = [str(_ROOT / "data" / "demo.toml"), *picture]
        cases = [
            ("clvol --help", [*clvol, "--help"], None, HELP_GOAL, runs),
            ("clvol render, demo, 512²", [*clvol, "render", *demo, *output],
             _ROOT / "data" / "brainsmall.nrrd", RENDER_GOAL, runs),
        ]
        chest = VOLUMES / "chest.nrrd"
        if chest.is_file():
            case = [*clvol, "render", str(chest), *output]
            cases.append(("clvol render, chest, 512²", case, chest, None, min(runs, 3)))
        else:
            say("startup: left out, there is no volume chest.nrrd in ../shared/volumes")
        result: dict[str, Any] = {
            "machine": machine(), "load_before": load_average(), "quick": options.quick,
            "cases": [],
        }  # fmt: skip
        for name, command, volume, goal, count in cases:
            measured = _measure(name, command, volume, goal, count)
            if measured is None:
                return None
            result["cases"].append(measured)
    result["load_after"] = load_average()
    return result


def _measure(name, command, volume: Path | None, goal, count: int) -> dict[str, Any] | None:
    taken = []
    for _ in range(count + 1):
        done = subprocess.run(
            [sys.executable, "-S", "-E", str(_CHILD), *command], capture_output=True, text=True
        )
        measured = json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else None
        if measured is None or measured["status"] != 0:
            say(f"startup: {name} failed: {done.stderr.strip()[-500:]}")
            return None
        taken.append(measured)
    warm = taken[1:]
    return {
        "name": name,
        "time": summary([t["seconds"] for t in warm]),
        "first": taken[0]["seconds"],
        "goal": goal,
        "peak_bytes": max(t["peak_bytes"] for t in warm),
        "volume_bytes": _bytes(volume) if volume is not None else None,
    }


def _bytes(path: Path) -> int:
    """What the voxels take in memory; asked of another process, to keep this one small."""
    code = "import sys, clvol; print(clvol.load_volume(sys.argv[1]).nbytes)"
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
    )
    return int(done.stdout)


def show(result: dict[str, Any]) -> str:
    rows = []
    for c in result["cases"]:
        t, volume = c["time"], c["volume_bytes"]
        least = c["peak_bytes"] - volume if volume is not None else None
        rows.append([
            c["name"],
            f"{t['median']:.3f}",
            f"{t['min']:.3f} - {t['max']:.3f}",
            f"< {c['goal']:g}" if c["goal"] else "",
            f"{c['first']:.3f}",
            f"{c['peak_bytes'] / 1e6:.0f}",
            "" if volume is None else f"{volume / 1e6:.0f}",
            "" if least is None else f"{least / 1e6:.0f}",
            "" if least is None else f"< {MEMORY_GOAL / 1e6:.0f}",
        ])
    head = ["process", "median s", "range", "goal", "first s", "peak MB", "volume MB", "beyond",
            "goal"]
    frames = ", ".join(str(c["time"]["frames"]) for c in result["cases"])
    return "\n".join([
        table(head, rows),
        f"medians of {frames} runs; load average {result['load_before']} to {result['load_after']}",
    ])


def draw(result: dict[str, Any], options: Options) -> list:
    return []
