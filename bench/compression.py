"""Vector-quantised volumes beside zfp and SZ3 (scenes and targets in compression_scenes.py).

Parts: rate against distortion, of voxels and of pictures; how long encoding and decoding take; frames from codes beside
frames from voxels; the pyramid beside the plain ray caster, on both; blocks within a budget. zfp and SZ3 work on the
same voxels in a child process.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from time import perf_counter
from typing import Any

from bench import compression_frames as frames
from bench.compression_peers import Peers, peers
from bench.compression_rates import Subject, rates
from bench.compression_scenes import CODED_SCENES, CodedScene
from bench.compression_speed import speed
from bench.compression_tables import markdown, show
from bench.multiresolution import attempt
from bench.options import Options
from bench.report import load_average, opening, say

__all__ = ["SUMMARY", "draw", "run", "show"]

SUMMARY = "rate against distortion, encoding and decoding, frames from codes; beside zfp and SZ3"
SIZE, QUICK_SIZE, QUICK_ROUNDS = 512, 96, 3
PARTS = ("rates", "speed", "frames", "crossover", "budget")
_HERE = Path(__file__).resolve().parent


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    begin = perf_counter()
    result = opening(device, options.quick, QUICK_SIZE if options.quick else SIZE) | {part: [] for part in PARTS}
    with peers(say) as found:
        result["peers"] = {} if found is None else found.versions
        for scene in coded_scenes(options, result["missing"]):
            _volume(scene, device, found, result, options)
    rounds = QUICK_ROUNDS if options.quick else options.frames
    with tempfile.TemporaryDirectory(prefix="clvol-bench-") as folder:
        about = device, result["size"], rounds, Path(folder), options, result["missing"]
        for part, cases in frames.cases(*about).items():
            rows = [attempt(part, case, result["failed"]) for case in cases]
            result[part] = [row for row in rows if row is not None]
    result["seconds"], result["load_after"] = perf_counter() - begin, load_average()
    return result if any(result[part] for part in PARTS) else None


def coded_scenes(options: Options, missing: list[str]) -> Iterable[CodedScene]:
    """Those that were asked for by the name of their scene, and whose volume is there."""
    from bench.scenes import available

    known = {scene.scene.name: scene for scene in CODED_SCENES}
    for scene in available([scene.scene for scene in CODED_SCENES], options.scenes, missing):
        yield known[scene.name]


def _volume(scene: CodedScene, device: Any, found: Peers | None, result: dict[str, Any], options: Options) -> None:
    subject = Subject(scene, device, result["size"], found, options.quick)
    result["rates"] += rates(subject, options.quick, result["failed"], picture_folder(options))
    rounds = QUICK_ROUNDS if options.quick else options.frames
    row = attempt("speed", lambda: speed(subject, rounds, options.quick), result["failed"])
    if row is not None:
        result["speed"].append(row)


def picture_folder(options: Options) -> Path:
    return options.folder / "pictures" / "compression"


def draw(result: dict[str, Any], options: Options) -> list:
    from bench.compression_chart import rate_chart
    from bench.compression_crossover import crossover_chart
    from bench.compression_pictures import codec_strip

    committed = not (options.quick or options.scenes or result["missing"])
    folder = _HERE if committed else options.folder
    tables = options.folder / "compression.md"
    tables.write_text(markdown(result), encoding="utf-8")
    drawn = [tables]
    if result["rates"]:
        drawn.append(rate_chart(result, folder / "compression.png"))
    if result["crossover"]:
        drawn.append(crossover_chart(result, folder / "compression-crossover.png"))
    for name in ("engine", "chest"):
        rows = [row for row in result["rates"] if row["volume"] == name]
        if rows:
            drawn.append(codec_strip(name, rows, picture_folder(options), folder / f"compression-{name}.png"))
    return drawn
