"""What multiresolution.py prints: tables, and every goal beside what was reached."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from bench.report import closing, table

MiB = 2**20
SSIM_GOAL, INTERBLOCK_GOAL, RESIDENT_GOAL = 0.98, 1.6, 1.5
TILES_GOAL, DELTA_E_GOAL, BUDGET_GOAL = 2.0, 1.0, 1.1


@dataclass(frozen=True)
class Verdict:
    """``reached`` of ``what``, at least or at most ``goal``."""

    what: str
    reached: float
    goal: float
    at_most: bool = False

    @property
    def is_met(self) -> bool:
        return self.reached <= self.goal if self.at_most else self.reached >= self.goal

    def __str__(self) -> str:
        side, met = ("at most" if self.at_most else "at least"), "met" if self.is_met else "NOT met"
        return f"{met:7}  {self.what}: {self.reached:.4g} (goal {side} {self.goal:g})"


def verdicts(result: dict[str, Any]) -> list[Verdict]:
    """Every goal, part by part."""
    found: list[Verdict] = []
    for row in result["stepping"]:
        if row["goal"] is not None:
            name = f"{row['scene']} {row['ratio']:g} : 1, {_how(row)}, limited"
            limited = row["steppings"]["limited"]
            found.append(Verdict(f"{name}: times as fast as full", limited["faster"], row["goal"]))
            found.append(Verdict(f"{name}: SSIM", limited["ssim"], SSIM_GOAL))
    for row in _flat(result["interblock"]):
        what = f"{row['scene']}, interpolation between blocks, {row['stepping']}"
        found.append(Verdict(f"{what}: times the time without", row["ratio"], INTERBLOCK_GOAL, True))
    for part in result["tiles"]:
        row = next(row for row in part["rows"] if row["is_goal"])
        name = f"{part['scene']}, tiles of {row['tiles']}, {row['share']:.0%} of the rays"
        found.append(Verdict(f"{name}: times as fast", row["faster"], TILES_GOAL))
        found.append(Verdict(f"{name}: SSIM", row["ssim"], SSIM_GOAL))
    for row in result["budget"]:
        name = f"{row['scene']} in {row['memory'] / MiB:g} MiB"
        found.append(Verdict(f"{name}: CIEDE2000, mean", row["delta_e"], DELTA_E_GOAL, True))
        share = row["on_device"] / row["memory"]
        found.append(Verdict(f"{name}: of the budget on the device", share, BUDGET_GOAL, True))
        share = (row["all_buffers"] - row["picture"]) / row["memory"]
        found.append(Verdict(f"{name}: and with tables of colours", share, BUDGET_GOAL, True))
    for row in result["resident"]:
        name, every, shown = row["scene"], row["rows"]["all"], row["rows"]["shown"]
        found.append(
            Verdict(f"{name}, all blocks: times the plain time", every["ratio"], RESIDENT_GOAL, True)
        )
        if name == "aneurism":
            what = f"{name}, transparent blocks dropped: times the plain time"
            found.append(Verdict(what, shown["ratio"], 1.0, True))
    if result.get("large"):
        for name in ("built", "rendered"):
            peak = result["large"][name]["peak_bytes"] / 2**30
            found.append(Verdict(f"{result['large']['edge']}^3 {name}: GiB of memory", peak, 2.0, True))
    return found


def show(result: dict[str, Any]) -> str:
    size = result["size"]
    parts = [
        f"{size} x {size} pixels, step 1; levels: blocks from full resolution to one sample, and"
        " those that nothing is seen of",
        *_stepping(result["stepping"]), *_literal(result.get("literal", [])), *_octree(result.get("octree", [])),
        *_interblock(_flat(result["interblock"])),
        *_tiles(result["tiles"]), *_budget(result["budget"], result["host"]),
        *_resident(result["resident"]), *_selection(result["selection"], result["change"]),
        *(_large(result["large"]) if result.get("large") else ()),
        *map(str, verdicts(result)), "", *closing(result),
    ]  # fmt: skip
    return "\n".join(parts)


def _flat(rows: Iterable[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    return [row for part in rows for row in part]


def _how(row: dict[str, Any]) -> str:
    how = "as in the paper" if row["as_in_paper"] else "as used"
    return f"{how}, step {row['step']:g}"


def _spread(time: dict[str, Any]) -> str:
    return f"{time['spread']:.0%}"


def _stepping(rows: list[dict[str, Any]]) -> list[str]:
    cells = []
    for row in rows:
        for name, r in row["steppings"].items():
            first = name == "full"
            blocks = row["blocks"]
            cells.append([
                row["scene"] if first else "", row["classification"] if first else "",
                _how(row) if first else "", f"{row['ratio']:g} : 1" if first else "", name,
                f"{r['time']['median']:.3f}", _spread(r["time"]), f"{r['faster']:.2f}",
                f"{row['ratio'] ** (1 / 3):.2f}" if first else "", f"{r['samples'] / 1e6:.1f}",
                f"{r['samples_ratio']:.2f}", f"{r['ssim']:.4f}", f"{r['delta_e']:.2f}",
                " ".join(map(str, [*blocks["levels"], blocks["dropped"]])) if first else "",
            ])  # fmt: skip
    head = ["scene", "classification", "levels and leaps", "bytes", "steps", "s", "spread", "faster", "g^(1/3)",
            "M samples", "fewer", "SSIM", "CIEDE2000", "levels"]
    bounded = any("bounded" in row["steppings"] for row in rows)
    lines = ["Steps along the ray, beside \"full\" at the same blocks. As in the paper: levels by the"
             " transfer function alone, no empty space leapt over. As used: by the view, too; leaps."
             " Slices: textures of all voxels, planes at the same step, nothing leapt over.",
             table(head, cells, left=5)]
    return [*lines, *([] if bounded else ["bounded: left out, no block has a bound here"]), ""]


def _literal(parts: list[dict[str, Any]]) -> list[str]:
    cells = [
        [part["scene"], f"{part['ratio']:g} : 1", r["rule"], f"{r['time']['median']:.3f}", _spread(r["time"]),
         f"{r['faster']:.2f}", f"{r['samples'] / 1e6:.1f}", f"{r['ssim']:.4f}", f"{r['delta_e']:.2f}"]
        for part in parts for r in part["rows"]
    ]  # fmt: skip
    sizes = [
        [part["scene"], r["tiles"], f"{r['time']['median']:.3f}", f"{r['share']:.1%}", f"{r['faster']:.2f}",
         f"{r['ssim']:.4f}", f"{r['delta_e']:.2f}"]
        for part in parts for r in part["sizes"]
    ]  # fmt: skip
    if not cells:
        return []
    return ["The paper's rules to the letter beside ours, at the same blocks; likeness to all voxels at the same step.",
            table(["scene", "bytes", "rules, steps", "s", "spread", "faster", "M samples", "SSIM", "CIEDE2000"],
                  cells, left=3), "",
            "Tiles over the paper's \"limited\" for every pixel, by \"max\", Q_H 0.9; likeness to that.",
            table(["scene", "tiles", "s", "rays", "faster", "SSIM", "CIEDE2000"], sizes), ""]  # fmt: skip


def _octree(parts: list[dict[str, Any]]) -> list[str]:
    cells = [
        [part["scene"], f"{part['ratio']:g} : 1", name, f"{r['bytes'] / MiB:.2f}", f"{r['error']:.4g}",
         f"{r['ssim']:.4f}", f"{r['delta_e']:.2f}", " ".join(map(str, r["levels"]))]
        for part in parts for name, r in part["ways"].items()
    ]  # fmt: skip
    if not cells:
        return []
    return ["Flat blocks beside an octree's nodes within the same bytes, levels by the transfer function alone.",
            table(["scene", "bytes", "held as", "MiB", "sum of errors", "SSIM", "CIEDE2000", "blocks by level"],
                  cells, left=3), ""]  # fmt: skip


def _interblock(rows: list[dict[str, Any]]) -> list[str]:
    cells = [[r["scene"], r["stepping"], f"{r['without']:.3f}", f"{r['seconds']:.3f}",
              f"{r['ratio']:.2f}", f"{r['low']:.2f}", f"{r['high']:.2f}"] for r in rows]  # fmt: skip
    return ["Interpolation between blocks, as used.",
            table(["scene", "steps", "without s", "with s", "ratio", "from", "to"], cells, left=2), ""]


def _tiles(parts: list[dict[str, Any]]) -> list[str]:
    cells = [[
        part["scene"], r["priority"], r["tiles"], f"{r['tile_high']:.2f}", f"{r['share']:.1%}",
        f"{r['time']['median']:.3f}", _spread(r["time"]), f"{r['faster']:.2f}", f"{r['ssim']:.4f}",
        "the goal's" if r["is_goal"] else "",
    ] for part in parts for r in part["rows"]]  # fmt: skip
    every = ", ".join(
        f"{part['scene']} {part['all']['median']:.3f} s, {part['covered']:.0%} of the pixels show"
        " something" for part in parts
    )
    return [f"Tiles over a ray for every pixel ({every}), \"limited\", as used.",
            table(["scene", "priority", "tiles", "tile_high", "rays", "s", "spread", "faster", "SSIM",
                   ""], cells, left=2), ""]  # fmt: skip


def _budget(rows: list[dict[str, Any]], host: list[dict[str, Any]]) -> list[str]:
    cells = [[
        r["scene"], f"{r['memory'] / MiB:g}", f"{r['ratio']:.1f} : 1", f"{r['delta_e']:.2f}",
        f"{r['ssim']:.4f}", f"{r['blocks']['bytes_of_samples'] / MiB:.2f}",
        f"{r['on_device'] / MiB:.2f}", f"{r['on_device'] / r['memory']:.1%}",
        f"{(r['all_buffers'] - r['picture']) / MiB:.2f}",
    ] for r in rows]  # fmt: skip
    lines = ["Within a budget, as used, beside all voxels at full resolution.",
             table(["scene", "MiB", "bytes", "CIEDE2000", "SSIM", "samples MiB", "on device MiB",
                    "of budget", "with tables MiB"], cells)]  # fmt: skip
    for row in host:
        told = [
            f"{name} {row[key]['peak_bytes'] / 1e6:.0f} MB, {row[key]['seconds']:.1f} s"
            for key, name in (("blocks", "from a store"), ("whole", "all voxels")) if row[key]
        ]  # fmt: skip
        lines.append(f"whole process of {row['scene']}, {row['volume_bytes'] / 1e6:.0f} MB of voxels: "
                     + "; ".join(told))
    return [*lines, ""]


def _resident(rows: list[dict[str, Any]]) -> list[str]:
    names = {"all": "all blocks, full", "shown": "transparent dropped, full",
             "selected": "as selected, limited"}
    cells = [
        [row["scene"] if key == "all" else "", names[key], f"{row['seconds']:.3f}",
         f"{r['seconds']:.3f}", f"{r['ratio']:.2f}", f"{r['low']:.2f}", f"{r['high']:.2f}",
         f"{r['samples'] / max(row['samples'], 1):.2f}", f"{r['bytes'] / MiB:.1f}",
         f"{r['ssim']:.4f}", f"{r['delta_e']:.2f}"]
        for row in rows for key, r in row["rows"].items()
    ]  # fmt: skip
    return ["Memory for all of it, beside the plain ray caster.",
            table(["scene", "blocks, steps", "plain s", "s", "ratio", "from", "to", "samples x",
                   "MiB", "SSIM", "CIEDE2000"], cells, left=2), ""]  # fmt: skip


def _selection(rows: list[dict[str, Any]], changes: list[dict[str, Any]]) -> list[str]:
    cells = [[
        r["scene"], "view" if r["by_view"] else "function", f"{r['memory'] / MiB:.2f}", r["blocks"],
        f"{r['error']:.5g}", f"{over_bound(r):.2e}", f"{r['errors_seconds']:.2f}",
        f"{r['seconds']:.2f}",
    ] for r in rows]  # fmt: skip
    lines = ["Selection. Over the best: error over its lower bound, less 1. Seconds: of the blocks'"
             " errors under a function, and of the levels for a view.",
             table(["scene", "by", "MiB", "blocks", "error", "over the best", "errors s", "levels s"],
                   cells, left=2)]  # fmt: skip
    for c in changes:
        meanwhile = c["frames"]
        frames = (f"{meanwhile['frames']} frames meanwhile, median {meanwhile['median']:.3f} s, longest"
                  f" {meanwhile['max']:.3f} s" if meanwhile else "no frame meanwhile")
        lines.append(
            f"Another function ({c['scene']} to {c['other']}, from a store, {c['memory'] / MiB:g} MiB, {c['size']}^2):"
            f" {c['asked_seconds']:.2f} s until frames have it, {c['seconds']:.2f} s until all blocks"
            f" are there; {c['changed']} of {c['blocks']} change, {c['read_blocks']} are read,"
            f" {c['read_bytes'] / MiB:.1f} of {c['all_bytes'] / MiB:.1f} MiB; {frames}, else"
            f" {c['idle']['median']:.3f} s")
    return [*lines, ""]


def over_bound(row: dict[str, Any]) -> float:
    """Error over the least possible, less 1; 0 where there is no error at all."""
    return 0.0 if row["error"] == 0 else row["error"] / max(row["bound"], 1e-300) - 1.0


def _large(row: dict[str, Any]) -> list[str]:
    told, blocks = row["stats"]["seconds"], row["stats"]["blocks"]
    built, rendered = row["built"], row["rendered"]
    speed = row["voxel_bytes"] / built["seconds"] / 1e6
    return [
        f"{row['edge']}^3 voxels of 8 bits, {row['voxel_bytes'] / 2**30:.2f} GiB, each step a process:",
        f"  stored in {built['seconds']:.0f} s ({speed:.0f} MB/s), {row['disk_bytes'] / 1e9:.2f} GB on"
        f" disk, at most {built['peak_bytes'] / 1e6:.0f} MB of memory",
        f"  rendered within {row['memory']} in {rendered['seconds']:.1f} s, of which the picture"
        f" {told['render']:.2f} s, at most {rendered['peak_bytes'] / 1e6:.0f} MB of memory",
        f"  levels {' '.join(map(str, [*blocks['levels'], blocks['dropped']]))}", "",
    ]  # fmt: skip
