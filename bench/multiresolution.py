"""Volumes as blocks of different resolution within a memory budget (Ljung 2006; scenes and goals in
multiresolution_scenes.py and multiresolution_tables.py).

Parts: steps along the ray as the paper's table has them (full, limited, naive, bounded), once as in the paper
(levels by the transfer function alone, no empty space leapt over, steps of half a voxel) and once as clvol is used;
interpolation between blocks; tiles of the picture; pictures within a budget; everything resident beside the plain ray
caster; the selection of levels; with ``--large`` a volume of 8 GiB. Pictures are 1024^2.

"full" is the same blocks with even steps; "of full resolution" is the plain ray caster with every voxel.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from time import perf_counter
from typing import Any

from bench import multiresolution_paper as paper
from bench import multiresolution_parts as parts
from bench.multiresolution_large import large, measured_child
from bench.multiresolution_scenes import BLOCK_SCENES, BlockScene, placed_as_in_bench
from bench.multiresolution_tables import show
from bench.options import Options
from bench.report import load_average, opening, say

__all__ = ["SUMMARY", "draw", "run", "show"]

SUMMARY = "blocks of different resolution in a memory budget: steps, tiles, error, selection"
SIZE, QUICK_SIZE, MOST_ROUNDS, QUICK_ROUNDS = 1024, 96, 5, 3
MEMORY = 16 * parts.MiB  # of the chest's 138 MiB
# (scene, voxels' bytes over those allowed, what "limited" has to gain over "full")
RATIOS = (("female", 11.0, 2.8), ("female", 30.0, 3.3), ("crab", 9.0, 2.1), ("chest", 11.0, None))
RESIDENT = ("engine-smooth", "aneurism", "female")
_HERE = Path(__file__).resolve().parent


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    begin = perf_counter()
    result = opening(device, options.quick, QUICK_SIZE if options.quick else SIZE)
    scenes = {scene.name: scene for scene in there(BLOCK_SCENES, options, result["missing"])}
    others = there(map(placed_as_in_bench, RESIDENT[:2]), options, result["missing"])
    with tempfile.TemporaryDirectory(prefix="clvol-bench-") as folder:
        rounds = QUICK_ROUNDS if options.quick else min(options.frames, MOST_ROUNDS)
        bench = parts.Bench(device, result["size"], rounds, Path(folder))
        for name, cases in _cases(bench, scenes, others).items():
            found = [attempt(name, case, result["failed"]) for case in cases]
            result[name] = [row for row in found if row is not None]
        if options.large:
            picture = options.folder / "pictures" / "multiresolution-large.png"
            picture.parent.mkdir(parents=True, exist_ok=True)
            result["large"] = large(options.device, options.quick, picture)
    result["seconds"], result["load_after"] = perf_counter() - begin, load_average()
    return result if any(result[name] for name in PARTS) or result.get("large") else None


PARTS = (
    "stepping", "literal", "octree", "interblock", "tiles", "budget", "resident", "selection", "change", "host"
)  # fmt: skip


def there(
    scenes: Iterable[BlockScene], options: Options, missing: list[str]
) -> list[BlockScene]:
    """Those that were asked for and whose volume is there."""
    from bench.scenes import available

    found = {scene.name: scene for scene in scenes}
    bare = [scene.scene for scene in found.values()]
    return [found[scene.name] for scene in available(bare, options.scenes, missing)]


def _cases(
    bench: parts.Bench, scenes: dict[str, BlockScene], others: list[BlockScene]
) -> dict[str, list[Callable[[], Any]]]:
    """What each part measures, in order, by the part's name."""
    ratios = [(scenes[name], ratio, goal) for name, ratio, goal in RATIOS if name in scenes]
    once = {scene.name: (scene, ratio) for scene, ratio, _ in reversed(ratios)}.values()
    chests = [scene for name, scene in scenes.items() if name in ("female", "chest")]
    resident = [*others, *(s for name, s in scenes.items() if name in RESIDENT)]
    cases: dict[str, list[Callable[[], Any]]] = {
        "stepping": [
            lambda s=scene, r=ratio, g=goal, p=as_in_paper: parts.stepping(bench, s, r, p, g)
            for as_in_paper in (True, False) for scene, ratio, goal in ratios
        ],
        "literal": [
            lambda s=scene, r=ratio: paper.literal(bench, s, r) for scene, ratio in once if scene.name != "chest"
        ],
        "octree": [
            lambda s=scene, r=ratio: paper.octree(bench, s, r) for scene, ratio, _ in ratios if scene.name != "chest"
        ],
        "interblock": [
            lambda s=scene, r=ratio: parts.interblock(bench, s, r)
            for scene, ratio in once if scene.name != "chest"
        ],
        "tiles": [
            lambda s=scene, r=ratio: parts.tiles(bench, s, r)
            for scene, ratio in once if scene.name != "chest"
        ],
        "budget": [lambda s=scene: parts.budget(bench, s, MEMORY) for scene in chests],
        "resident": [lambda s=scene: parts.resident(bench, s) for scene in resident],
        "selection": [
            lambda s=scene, r=ratio, how=how: parts.selection(
                bench, s, int(bench.volume(s).nbytes / r), **how)
            for scene, ratio, _ in ratios for how in (parts.AS_IN_PAPER, {})
        ],
        "change": [], "host": [],
    }  # fmt: skip
    if len(chests) == 2:
        cases["change"] = [lambda: _change(bench, *chests)]
    if chests:
        cases["host"] = [lambda: host_memory(bench, chests[0])]
    return cases


def attempt(name: str, case: Callable[[], Any], failed: list[str]) -> Any:
    from clvol.errors import ClvolError

    try:
        return case()
    except ClvolError as error:
        say(f"{name}: {error}")
        failed.append(f"{name}: {error}")
        return None


def stored(bench: parts.Bench, scene: BlockScene) -> dict[str, Any]:
    """A store of the scene's volume in the bench's folder, made at the first call."""
    from clvol.store.build import build_store

    path = bench.folder / f"{Path(scene.scene.file).stem}.zarr"
    start = perf_counter()
    if not path.exists():
        build_store(bench.volume(scene), path)
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    return {"path": path, "seconds": perf_counter() - start, "bytes": size}


def _change(bench: parts.Bench, scene: BlockScene, other: BlockScene) -> dict[str, Any]:
    return parts.changed_function(bench, scene, other, MEMORY, stored(bench, scene)["path"])


def host_memory(bench: parts.Bench, scene: BlockScene) -> dict[str, Any]:
    """Peak memory of whole processes: the scene from a store within MEMORY, and from its file with
    all voxels resident."""
    volume = bench.volume(scene)
    store = stored(bench, scene)["path"]
    found: dict[str, Any] = {"scene": scene.name, "volume_bytes": volume.nbytes, "memory": MEMORY}
    for name, file, method in (("blocks", store, "multiresolution"),
                               ("whole", scene.scene.path(), "raycast")):  # fmt: skip
        path = bench.folder / f"{name}.toml"
        path.write_text(scene_text(scene, file, method, bench.size), encoding="utf-8")
        device = ["--device", bench.context.name]
        found[name] = measured_child([
            sys.executable, "-m", "clvol", "render", str(path), "-o",
            str(bench.folder / f"{name}.npy"), *device,
        ])  # fmt: skip
    return found


def scene_text(scene: BlockScene, file: Path, method: str, size: int) -> str:
    """A scene file of ``scene`` with its volume in ``file``, seen as by default."""
    points = ", ".join(
        f"{{ value = {float(value)}, opacity = {float(opacity)}, color = {list(map(float, color))} }}"
        for value, opacity, color in scene.scene.points
    )
    return (
        f"version = 1\n[volume]\nfile = {json.dumps(str(file.resolve()))}\n"
        f"[image]\nwidth = {size}\nheight = {size}\n"
        f'[transfer_function]\ncolor_space = "linear"\npoints = [{points}]\n'
        f'[integration]\nmethod = "{method}"\nclassification = "{scene.scene.classification}"\n'
        f"[multiresolution]\nmemory = {MEMORY}\n"
    )


def draw(result: dict[str, Any], options: Options) -> list:
    from bench.multiresolution_pictures import level_sheet, shrunk_picture

    committed = not (options.quick or options.scenes or result["missing"])
    folder = _HERE if committed else options.folder
    scenes = there(BLOCK_SCENES[:2], options, [])
    ratios = {name: ratio for name, ratio, _ in reversed(RATIOS)}
    drawn = []
    if scenes:
        sheet = [(scene, ratios[scene.name]) for scene in scenes]
        size = QUICK_SIZE if options.quick else None
        drawn.append(level_sheet(sheet, options, folder / "multiresolution.png", size))
    if result.get("large"):
        source = Path(result["large"]["picture"])
        drawn.append(shrunk_picture(source, folder / "multiresolution-large.png"))
    return drawn
