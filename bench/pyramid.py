"""Adaptive sampling along rays and across them (Kraus et al. 2007; scenes in pyramid_scenes.py, goals in
pyramid_tables.py).

Parts: the paper's tables of samples and seconds; from which cost of a sample on the pyramid is
faster than the plain ray caster, which leaps over empty space; every oracle; pictures of more and
more pixels; steps through blocks; lit scenes; what the paper claims without figures.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

from bench import pyramid_claims as claims
from bench import pyramid_parts as parts
from bench.multiresolution import attempt, there
from bench.multiresolution_scenes import BlockScene
from bench.options import Options
from bench.pyramid_scenes import ANEURISM, CHEST_BLOCKS, ENGINE, FEMALE, HEPTANE, PYRAMID_SCENES
from bench.pyramid_tables import show
from bench.report import load_average, opening

__all__ = ["SUMMARY", "draw", "run", "show"]

SUMMARY = "adaptive sampling in three dimensions: samples, error, what a sample has to cost"
SIZE, QUICK_SIZE, QUICK_ROUNDS = 512, 96, 3
EDGE, QUICK_EDGE = 512, 320  # voxels that the aneurism is resampled to
# What Kraus et al. (2007) gain over their "min".
ANEURISM_GOALS, CHEST_GOALS = {"fewer": 56.0, "faster": 3.4}, {"fewer": 4.7, "faster": 1.8}
HALF = 0.5  # the distance of rays between slices: what the paper's leaves wrong is then small
RATIO, QUICK_RATIO = 11.0, 4.0  # of voxels' bytes to those of blocks
PARTS = ("paper", "crossover", "oracles", "sizes", "blocks", "light", "power", "synthesis")
CLAIMED = (ANEURISM, ENGINE, HEPTANE, FEMALE)
CROSSOVER = (ANEURISM, ENGINE, HEPTANE, FEMALE)
ORACLES = (ENGINE, HEPTANE, ANEURISM)
PICTURES = (ANEURISM, FEMALE)
_HERE = Path(__file__).resolve().parent


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    begin = perf_counter()
    result = opening(device, options.quick, QUICK_SIZE if options.quick else SIZE)
    scenes = there(PYRAMID_SCENES, options, result["missing"])
    rounds = QUICK_ROUNDS if options.quick else options.frames
    bench = parts.Bench(device, result["size"], rounds, options.references)
    for name, cases in _cases(bench, scenes, options.quick).items():
        found = [attempt(name, case, result["failed"]) for case in cases]
        result[name] = [row for row in found if row is not None]
    result["seconds"], result["load_after"] = perf_counter() - begin, load_average()
    return result if any(result[name] for name in PARTS) else None


def _cases(
    bench: parts.Bench, scenes: list[BlockScene], quick: bool
) -> dict[str, list[Callable[[], Any]]]:
    """What each part measures, in order, by the part's name."""
    edge = QUICK_EDGE if quick else EDGE
    papers = ((ANEURISM, None, None), (ANEURISM, edge, ANEURISM_GOALS),
              (ANEURISM, edge, ANEURISM_GOALS, HALF), (FEMALE, None, CHEST_GOALS),
              (FEMALE, None, CHEST_GOALS, HALF), (CHEST_BLOCKS, None, None))  # fmt: skip
    repeats = parts.QUICK_REPEATS if quick else parts.REPEATS
    epsilons = parts.QUICK_EPSILONS if quick else parts.EPSILONS
    sizes = parts.QUICK_SIZES if quick else parts.SIZES
    return {
        "paper": [
            lambda paper=paper: parts.paper(bench, *paper) for paper in papers if paper[0] in scenes
        ],
        "crossover": [
            lambda s=scene: parts.crossover(bench, s, repeats)
            for scene in CROSSOVER if scene in scenes
        ],
        "oracles": [
            lambda s=scene: parts.oracles(bench, s, epsilons)
            for scene in ORACLES if scene in scenes
        ],
        "blocks": [
            lambda s=scene: parts.blocks(bench, s, QUICK_RATIO if quick else RATIO)
            for scene in (HEPTANE, FEMALE) if scene in scenes
        ],
        "light": [lambda s=scene: claims.light(bench, s) for scene in (HEPTANE,) if scene in scenes],
        "power": [
            lambda s=scene, e=epsilon: claims.power(bench, s, e)
            for scene in CLAIMED if scene in scenes for epsilon in (0.3, 0.01)
        ],
        "synthesis": [
            lambda s=scene: claims.synthesis(bench, s, (1, 2, 3)) for scene in CLAIMED if scene in scenes
        ],
        "sizes": [lambda: parts.sizes(bench, HEPTANE, sizes) for _ in range(HEPTANE in scenes)],
    }  # fmt: skip


def draw(result: dict[str, Any], options: Options) -> list:
    from bench.charts import crossover_chart
    from bench.pyramid_pictures import difference_sheet

    committed = not (options.quick or options.scenes or result["missing"])
    folder = _HERE if committed else options.folder
    drawn = []
    if result["crossover"]:
        drawn.append(crossover_chart(result, folder / "pyramid-crossover.png"))
    rows = {row["scene"]: row for row in result["paper"]}
    shown = [(scene, rows[scene.name]) for scene in PICTURES if scene.name in rows]
    if shown:
        drawn.append(difference_sheet(shown, options, folder / "pyramid.png"))
    return drawn
