"""Whole processes: ``clvol --help``, ``clvol render`` warm and from empty caches, peak memory, and pictures of a job.

Each command runs as a user would run it, in a process of its own; a small process that loads
nothing else starts it and asks the system for its wall and processor time and the largest resident size (a
child's size includes its parent's at the fork, so the parent has to be small). Commands take turns. One round
before is not counted, and fills the caches. Processor time is what counts where a machine is shared.

A picture of a job is compared with its frame alone, both in one process (``bench/startup_job.py``).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.options import Options
from bench.report import load_average, machine, say, table
from bench.scenes import VOLUMES
from clvol.accuracy.timing import summary

SUMMARY = "whole-process times of clvol --help and clvol render, warm and cold, peak memory, and jobs"
# Seconds of a processor, bytes beyond the volume, and processor time of a picture of a job beside its frame's.
HELP_GOAL, SMALL_GOAL, COLD_GOAL, MEMORY_GOAL, JOB_GOAL = 0.2, 0.6, 3.0, 350e6, 1.3
_ROOT = Path(__file__).resolve().parent.parent
_CHILD = Path(__file__).resolve().parent / "child.py"
_DEMO, _DEMO_VOLUME = _ROOT / "data" / "demo.toml", _ROOT / "data" / "brainsmall.nrrd"


@dataclass(frozen=True)
class _Case:
    name: str
    command: list[str]
    goal: float | None = None
    volume: Path | None = None
    cold: bool = False  # with caches that are empty each time


def run(options: Options) -> dict[str, Any] | None:
    runs = 2 if options.quick else max(options.frames, 7)
    result: dict[str, Any] = {"machine": machine(), "load_before": load_average(), "quick": options.quick}
    with tempfile.TemporaryDirectory() as folder:
        cases = _cases(options, Path(folder))
        taken: dict[str, list[dict[str, Any]]] = {case.name: [] for case in cases}
        for _ in range(runs + 1):
            for case in cases:
                measured = _measure(case, Path(folder))
                if measured is None:
                    return None
                taken[case.name].append(measured)
        result["cases"] = [_told(case, taken[case.name]) for case in cases]
        result["jobs"] = _jobs(options, Path(folder))
    result["load_after"] = load_average()
    return result


def _cases(options: Options, folder: Path) -> list[_Case]:
    program = Path(sys.executable).parent / "clvol"
    clvol = [str(program)] if program.exists() else [sys.executable, "-m", "clvol"]
    chosen = ["--device", options.device] if options.device else []

    def demo(size: int, picture: str) -> list[str]:
        size_of = ["--set", f"image.width={size}", "--set", f"image.height={size}"]
        return [*clvol, "render", str(_DEMO), *size_of, "-o", str(folder / picture), *chosen]

    cases = [
        _Case("clvol --help", [*clvol, "--help"], HELP_GOAL),
        _Case("clvol render, demo, 256²", demo(256, "small.png"), SMALL_GOAL, _DEMO_VOLUME),
        _Case("the same from empty caches", demo(256, "small.png"), COLD_GOAL, _DEMO_VOLUME, cold=True),
        _Case("clvol render, demo, 512²", demo(512, "picture.exr"), None, _DEMO_VOLUME),
    ]
    chest = VOLUMES / "chest.nrrd"
    if chest.is_file():
        command = [*clvol, "render", str(chest), "-o", str(folder / "chest.exr"), *chosen]
        cases.append(_Case("clvol render, chest, 512²", command, None, chest))
    else:
        say("startup: left out, there is no volume chest.nrrd in ../shared/volumes")
    return cases


def _measure(case: _Case, folder: Path) -> dict[str, Any] | None:
    environment = {k: v for k, v in os.environ.items() if not (case.cold and k == "POCL_CACHE_DIR")}
    with tempfile.TemporaryDirectory(dir=folder) as empty:
        if case.cold:
            environment["XDG_CACHE_HOME"] = empty
        done = subprocess.run(
            [sys.executable, "-S", "-E", str(_CHILD), *case.command], capture_output=True, text=True, env=environment
        )
    measured = json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else None
    if measured is None or measured["status"] != 0:
        say(f"startup: {case.name} failed: {done.stderr.strip()[-500:]}")
        return None
    return measured


def _told(case: _Case, taken: list[dict[str, Any]]) -> dict[str, Any]:
    warm = taken[1:]
    return {
        "name": case.name,
        "processor": summary([t["processor"] for t in warm]),
        "time": summary([t["seconds"] for t in warm]),
        "first": taken[0]["seconds"],
        "goal": case.goal,
        "peak_bytes": max(t["peak_bytes"] for t in warm),
        "volume_bytes": _bytes(case.volume) if case.volume is not None else None,
    }


def _jobs(options: Options, folder: Path) -> list[dict[str, Any]]:
    """Processor time per picture of jobs, and of their frames alone, in seconds (medians)."""
    found = []
    count, sizes = (12, (256,)) if options.quick else (200, (256, 512))
    for size in sizes:
        for varied in ("camera", "function"):
            command = [sys.executable, "-m", "bench.startup_job", str(folder), varied, str(size), str(count)]
            done = subprocess.run(
                [*command, options.device or ""], capture_output=True, text=True, cwd=_ROOT, check=False
            )
            if done.returncode:
                say(f"startup: the job over a {varied} failed: {done.stderr.strip()[-500:]}")
                continue
            found.append(json.loads(done.stdout.splitlines()[-1]))
    return found


def _bytes(path: Path) -> int:
    """What the voxels take in memory; asked of another process, to keep this one small."""
    code = "import sys, clvol; print(clvol.load_volume(sys.argv[1]).nbytes)"
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    return int(done.stdout)


def show(result: dict[str, Any]) -> str:
    rows = []
    for c in result["cases"]:
        processor, wall, volume = c["processor"], c["time"], c["volume_bytes"]
        rows.append([
            c["name"],
            f"{processor['median']:.3f}",
            f"{processor['min']:.3f} - {processor['max']:.3f}",
            f"< {c['goal']:g}" if c["goal"] else "",
            f"{wall['median']:.3f}",
            f"{wall['min']:.3f}",
            f"{c['peak_bytes'] / 1e6:.0f}",
            "" if volume is None else f"{(c['peak_bytes'] - volume) / 1e6:.0f}",
        ])  # fmt: skip
    head = ["process", "processor s", "range", "goal", "wall s", "least", "peak MB",
            f"beyond the volume (< {MEMORY_GOAL / 1e6:.0f})"]  # fmt: skip
    frames = ", ".join(str(c["time"]["frames"]) for c in result["cases"])
    jobs = [
        [f"{j['pictures']} pictures, {j['size']}², {j['varied']} varies", f"{1e3 * j['picture']:.1f}",
         f"{1e3 * j['frame']:.1f}", f"{j['picture'] / j['frame']:.2f}", f"< {JOB_GOAL:g}",
         f"{1e3 * j['wall']['picture']:.1f}", f"{j['wall']['picture'] / j['wall']['frame']:.2f}"]
        for j in result["jobs"]
    ]  # fmt: skip
    return "\n".join([
        table(head, rows),
        f"medians of {frames} runs; load average {result['load_before']} to {result['load_after']}",
        "",
        table(["job", "processor ms per picture", "per frame", "ratio", "goal", "wall ms per picture", "ratio"], jobs),
    ])  # fmt: skip


def draw(result: dict[str, Any], options: Options) -> list:
    return []
