"""Ljung's rules (Volume Graphics 2006) to the letter beside those of the method "multiresolution", and an octree within
the same bytes; parts of the suite "multiresolution".

To the letter: samples inside blocks, without interpolation between them (as his own figures have),
values classified one by one, steps of min(1 + floor(l), 1 / kappa) or 1 / kappa. Ours: values blended
over faces, and segments pre-integrated, of which none crosses a face but a single step.

Octree (as before flat blocking): a node is as many samples as a full block, of 2^k blocks along each axis,
so that all of its blocks have one resolution, where flat blocking chooses for each.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from bench.effects import ratio_of
from bench.multiresolution_parts import AS_IN_PAPER, PAPER_STEP, Bench, Blocks, alike
from bench.multiresolution_scenes import BlockScene
from bench.report import say
from clvol.store.source import DROPPED

TILE_SIZES = (4, 8, 12, 16, 24, 32)
# name: classification, interpolation between blocks, steps
RULES = {
    "as in the paper, full": ("post", False, "full"),
    "as in the paper, limited": ("post", False, "limited"),
    "as in the paper, naive": ("post", False, "naive"),
    "ours, full": ("preintegrated", True, "full"),
    "ours, limited": ("preintegrated", True, "limited"),
    "ours, bounded": ("preintegrated", True, "bounded"),
}


def literal(bench: Bench, scene: BlockScene, ratio: float) -> dict[str, Any]:
    """Time and likeness, to all voxels at the same step, of both sets of rules at the same blocks; and of
    tiles of all sizes with the paper's "limited"."""
    from clvol.integrators.raycast.caster import Raycaster
    from clvol.integrators.tiles.tiled import TiledRenderer

    volume = bench.volume(scene)
    asked = scene.asked(volume, bench.size, int(volume.nbytes / ratio), **AS_IN_PAPER).resolve()
    whole = scene.plain(volume, bench.size).resolve()
    plain = Raycaster(bench.context, _stepped(whole, "preintegrated"))
    exact = plain.render(asked.camera, bench.size, bench.size, depth=False).rgba
    with bench.blocks(asked) as blocks:
        casters: dict[Any, Any] = {}
        for name, (classification, between, steps) in RULES.items():
            held = _held(blocks, _stepped(asked, classification))
            casters[name] = held.caster(skip=False, stepping=steps, interblock=between)
        limited = casters["as in the paper, limited"]
        table = asked.multiresolution
        for size in TILE_SIZES:
            tiled = table.model_copy(update={"tiles": size, "tile_priority": "max", "tile_high": 0.9})
            casters[size] = TiledRenderer(limited, tiled)
        casters[TILE_SIZES[0]].warm_up(depth=False)
        frames = {key: blocks.picture(made) for key, made in casters.items()}
        times = bench.times({key: blocks.turn(made) for key, made in casters.items()})
    rows = [
        {
            "rule": name, "time": times[name], "samples": frames[name].samples,
            "faster": ratio_of(times[name.split(",")[0] + ", full"], times[name])["ratio"],
            **alike(frames[name].rgba, exact),
        }
        for name in RULES
    ]  # fmt: skip
    every = frames["as in the paper, limited"].rgba
    sizes = [
        {
            "tiles": size, "time": times[size], "share": frames[size].share,
            "faster": ratio_of(times["as in the paper, limited"], times[size])["ratio"],
            **alike(frames[size].rgba, every),
        }
        for size in TILE_SIZES
    ]  # fmt: skip
    say(f"{scene.name} {ratio:g} : 1, to the letter: limited {rows[1]['faster']:.2f}, ours {rows[4]['faster']:.2f}")
    return {"scene": scene.name, "ratio": ratio, "step": PAPER_STEP, "rows": rows, "sizes": sizes}


def _stepped(asked: Any, classification: str) -> Any:
    changed = {"step": PAPER_STEP, "classification": classification}
    return replace(asked, integration=asked.integration.model_copy(update=changed))


def _held(blocks: Blocks, asked: Any) -> Blocks:
    """The same blocks for another scene of them."""
    other = object.__new__(Blocks)
    other.context, other.resolved, other.residency = blocks.context, asked, blocks.residency
    return other


def octree(bench: Bench, scene: BlockScene, ratio: float) -> dict[str, Any]:
    """Levels of flat blocks and of an octree's nodes within the same bytes, by the same errors: their
    sums, and likeness to all voxels."""
    from clvol.integrators.multiresolution.sample_allocator import overhead_bytes, sample_dtype
    from clvol.integrators.multiresolution.selection import level_costs, source_errors, total_error
    from clvol.integrators.raycast.caster import Raycaster

    volume = bench.volume(scene)
    memory = int(volume.nbytes / ratio)
    asked = scene.asked(volume, bench.size, memory, **AS_IN_PAPER).resolve()
    source = volume.blocks_source
    known = source_errors(source, asked.transfer_function, asked.background)
    cost = level_costs(source.blocks, sample_dtype(volume))
    spare = memory - overhead_bytes(source.blocks, memory)
    plain = Raycaster(bench.context, scene.plain(volume, bench.size).resolve())
    exact = plain.render(asked.camera, bench.size, bench.size, depth=False).rgba
    nodes, spent = octree_levels(known.errors, known.dropped, cost, source.blocks.counts, spare)
    found = {}
    with bench.blocks(asked) as blocks:
        flat = np.array(blocks.residency.blocks.levels)
        for name, levels in (("flat blocks", flat), ("octree", nodes)):
            blocks.hold(levels)
            frame = blocks.picture(blocks.caster(stepping="full"))
            counts = np.bincount(levels[~known.dropped], minlength=len(cost))[: len(cost)]
            found[name] = {
                "error": total_error(known.errors, levels), "levels": counts.tolist(), **alike(frame.rgba, exact),
                "bytes": spent if name == "octree" else int(cost[flat[flat != DROPPED]].sum()),
            }  # fmt: skip
    say(f"{scene.name} {ratio:g} : 1: CIEDE2000 {found['flat blocks']['delta_e']:.2f} by flat blocks,"
        f" {found['octree']['delta_e']:.2f} by an octree")
    return {"scene": scene.name, "ratio": ratio, "spare": spare, "ways": found}


def octree_levels(
    errors: np.ndarray, dropped: np.ndarray, cost: np.ndarray, counts: tuple[int, int, int], spare: int
) -> tuple[np.ndarray, int]:
    """(levels uint8 [n], bytes) of the blocks [z, y, x] of a tree that is cut within ``spare`` bytes.
    ``errors`` [levels, n], ``cost`` bytes of a block by level. The node that saves most error per byte, at
    whatever depth it is cut then, is parted next. Nodes of which nothing shows take no bytes; others take
    those of all their blocks."""
    last = len(cost) - 1
    errors = errors.reshape(len(cost), *counts)
    shown = ~dropped.reshape(counts)
    levels = np.full(counts, DROPPED, np.uint8)
    queue: list[tuple[float, int, int, tuple[int, int, int]]] = []
    number, spent = 0, 0

    def part(level: int, at: tuple[int, int, int]) -> tuple[slice, ...]:
        return tuple(slice(k << level, (k + 1) << level) for k in at)

    def bytes_at(level: int, own: tuple[slice, ...], to: int) -> int:
        """Of the node's blocks, if all are nodes of level ``to``."""
        mask = shown[own]
        if not mask.any():
            return 0
        size = 1 << to
        padded = np.pad(mask, [(0, -n % size) for n in mask.shape])
        z, y, x = (n // size for n in padded.shape)
        held = padded.reshape(z, size, y, size, x, size).any(axis=(1, 3, 5))
        whole = np.repeat(np.repeat(np.repeat(held, size, 0), size, 1), size, 2)[tuple(map(slice, mask.shape))]
        return int(whole.sum()) * int(cost[to])

    def push(level: int, at: tuple[int, int, int]) -> None:
        nonlocal number
        own = part(level, at)
        if level == 0 or not shown[own].any():
            return
        here, taken = float(errors[level][own].sum()), bytes_at(level, own, level)
        saves = max(
            (here - float(errors[to][own].sum())) / max(bytes_at(level, own, to) - taken, 1) for to in range(level)
        )
        heapq.heappush(queue, (-saves, number, level, at))
        number += 1

    def children(level: int, at: tuple[int, int, int]) -> Iterator[tuple[int, int, int]]:
        for k in np.ndindex(2, 2, 2):
            child = tuple(2 * a + b for a, b in zip(at, k))
            if all(c << (level - 1) < n for c, n in zip(child, counts)):
                yield child  # type: ignore[misc]

    for at in np.ndindex(*(-(-n // (1 << last)) for n in counts)):
        own = part(last, at)
        if shown[own].any():
            levels[own] = last
            spent += bytes_at(last, own, last)
            push(last, at)
    while queue:
        _, _, level, at = heapq.heappop(queue)
        more = sum(bytes_at(level - 1, part(level - 1, c), level - 1) for c in children(level, at))
        more -= bytes_at(level, part(level, at), level)
        if spent + more > spare:
            continue
        spent += more
        for child in children(level, at):
            own = part(level - 1, child)
            levels[own] = level - 1 if shown[own].any() else DROPPED
            push(level - 1, child)
    return levels.ravel(), spent
