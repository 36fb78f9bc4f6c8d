"""What pyramid.py prints: tables, and every goal beside what was reached."""

from __future__ import annotations

from typing import Any

from bench.curves import Reach
from bench.multiresolution_tables import Verdict
from bench.pyramid_claims import RMSE_GOAL, WAYS
from bench.pyramid_parts import CUBIC, DELTA_E_GOAL, SSIM_GOAL, crossing_text
from bench.pyramid_scenes import LEVELS
from bench.report import closing, table

OVERHEAD_GOAL = 1.3
# Kraus et al. 2007, tables 2 and 3: data, way, M fragments, M samples, seconds.
PAPER = (
    ("aneurysm 512^3", "texture", 49, 99, 0.87),
    ("aneurysm 512^3", "min", 162, 56, 0.79),
    ("aneurysm 512^3", "adaptive", 61, 1, 0.23),
    ("abdomen 512^3", "texture", 37, 74, 0.76),
    ("abdomen 512^3", "min", 122, 42, 0.68),
    ("abdomen 512^3", "adaptive", 61, 9, 0.38),
)
_WAYS = {"plain": "plain", "unskipped": "plain, no skipping", "texture": "texture slices"}


def verdicts(result: dict[str, Any]) -> list[Verdict]:
    """The goals of the scenes that have any."""
    found: list[Verdict] = []
    for row in result["paper"]:
        if row["goals"] is None:
            continue
        name, best = f"{row['scene']}, {row['best']}", row["ways"][row["best"]]
        goals = row["goals"]
        found += [
            Verdict(f"{name}: times fewer samples than minimum", best["fewer"], goals["fewer"]),
            Verdict(f"{name}: times as fast as minimum", best["faster"], goals["faster"]),
            Verdict(f"{name}: SSIM", best["ssim"], SSIM_GOAL),
            Verdict(f"{name}: CIEDE2000, mean", best["delta_e"], DELTA_E_GOAL, True),
            Verdict(
                f"{row['scene']}, minimum: times the plain time without skipping",
                row["overhead"]["ratio"], OVERHEAD_GOAL, True,
            ),
        ]  # fmt: skip
    found += [
        Verdict(f"{row['scene']}, lit, RMSE {RMSE_GOAL:g}: times as fast as by rays", row["faster"]["ratio"], 1.0)
        for row in result.get("light", ()) if row["faster"]
    ]  # fmt: skip
    return found


def show(result: dict[str, Any]) -> str:
    size = result["size"]
    lines = [
        f"{size} x {size} pixels where nothing else is said, pre-integrated, levels {LEVELS}",
        *_paper(result["paper"]), *_crossover(result["crossover"]), *_oracles(result["oracles"]),
        *_sizes(result["sizes"]), *_blocks(result["blocks"]), *_light(result.get("light", [])),
        *_power(result.get("power", [])), *_synthesis(result.get("synthesis", [])),
        *map(str, verdicts(result)), "", *closing(result),
    ]  # fmt: skip
    return "\n".join(lines)


def _time(time: dict[str, Any]) -> list[str]:
    return [f"{time['median']:.4f}", f"{time['spread']:.0%}"]


def _millions(count: float) -> str:
    return f"{count / 1e6:.2f}"


def _counted(counters: dict[str, int]) -> list[str]:
    names = ("oracle_samples", "syntheses", "accumulations")
    return [_millions(counters[name]) if name in counters else "" for name in names]


def _paper(rows: list[dict[str, Any]]) -> list[str]:
    cells = []
    for row in rows:
        for way, r in row["ways"].items():
            first = way == "plain"
            cells.append([
                row["scene"] if first else "", f"{row['step']:.3f}" if first else "",
                _WAYS.get(way, way), *_time(r["time"]), f"{r['of_plain']:.2f}",
                f"{r['faster']:.2f}", _millions(r["samples"]), f"{r['fewer']:.1f}",
                f"{r['fewer_than_p1']:.1f}", *_counted(r["counters"]),
                f"{r['rmse']:.2e}", f"{r['ssim']:.4f}", f"{r['delta_e']:.3f}",
            ])  # fmt: skip
    if not cells:
        return []
    head = ["scene", "step", "method or oracle", "s", "spread", "x plain", "faster", "M samples",
            "fewer", "than the paper's", "M of the oracle", "M syntheses", "M accumulations", "RMSE", "SSIM",
            "CIEDE2000"]  # fmt: skip
    theirs = [[data, way, fragments, samples, f"{seconds:.2f}"]
              for data, way, fragments, samples, seconds in PAPER]  # fmt: skip
    return [
        "As in the paper: slices as far apart as rays in the middle of the volume (step, in"
        " smallest voxel edges), or half as far.",
        "texture slices: planes, both ends of each slab sampled for it, nothing leapt over.",
        "faster, fewer: seconds and samples of \"minimum\" over the row's; than the paper's: that oracle's"
        " over the row's, as the paper takes a sample wherever it asks. Errors: against the exact integral.",
        table(head, cells, left=3), "", "Kraus et al. 2007, tables 2 and 3 (512 x 512 pixels):",
        table(["data", "", "M fragments", "M samples", "s"], theirs, left=2), "",
    ]  # fmt: skip


def _crossover(parts: list[dict[str, Any]]) -> list[str]:
    cells = []
    for part in parts:
        for r in part["rows"]:
            first = r is part["rows"][0]
            with_error = first or r["level"] == CUBIC
            errors = [f"{r['rmse'][way]:.2e}" if with_error else "" for way in ("plain", "pyramid")]
            samples = [
                _millions(r["samples"][way]) if with_error else "" for way in ("plain", "pyramid")
            ]
            cells.append([
                part["scene"] if first else "", r["level"], f"{r['cost']:.2f}", *_time(r["plain"]),
                *_time(r["pyramid"]), f"{r['faster']['ratio']:.2f}", f"{r['faster']['low']:.2f}",
                f"{r['faster']['high']:.2f}", *samples, *errors,
            ])  # fmt: skip
    if not cells:
        return []
    head = ["scene", "repeats", "cost", "plain s", "spread", "pyramid s", "spread", "faster",
            "from", "to", "plain M samples", "pyramid M", "plain RMSE", "pyramid RMSE"]  # fmt: skip
    return [
        "Dearer samples, step 1: every look-up repeated, and the cubic filter. Cost of a sample:"
        " over a plain one. Errors: against steps of 1/8.",
        table(head, cells, left=1),
        *(f"{part['scene']}: the pyramid is faster {crossing_text(Reach(**part['crossing']))}"
          for part in parts), "",
    ]  # fmt: skip


def _oracles(parts: list[dict[str, Any]]) -> list[str]:
    cells = []
    for part in parts:
        plain = part["plain"]
        cells.append([part["scene"], "(plain)", "", *_time(plain["time"]),
                      _millions(plain["samples"]), "", "", "", "", f"{plain['from_fine']:.2e}", ""])
        for r in part["rows"]:
            epsilon = "" if r["epsilon"] is None else f"{r['epsilon']:g}"
            cells.append([
                "", r["oracle"], epsilon, *_time(r["time"]), _millions(r["samples"]),
                *_counted(r["counters"]), f"{r['from_minimum']:.2e}", f"{r['from_fine']:.2e}",
                f"{r['prepare']:.2f}",
            ])  # fmt: skip
    if not cells:
        return []
    head = ["scene", "oracle", "epsilon", "s", "spread", "M samples", "M of the oracle",
            "M syntheses", "M accumulations", "from minimum", "from 1/8", "prepare s"]  # fmt: skip
    return [
        "Oracles, step 1. RMSE from the same scene with \"minimum\", and from steps of 1/8."
        " Prepare: tables and map, the volume being there.",
        table(head, cells, left=3), "",
    ]  # fmt: skip


def _blocks(parts: list[dict[str, Any]]) -> list[str]:
    cells = [
        [part["scene"] if name == "full" else "", f"{part['blocks']['reduction']:.1f} : 1", name,
         *_time(r["time"]), f"{r['faster']:.2f}", _millions(r["samples"]), f"{r['ssim']:.4f}",
         f"{r['delta_e']:.2f}"]
        for part in parts for name, r in part["rows"].items()
    ]  # fmt: skip
    if not cells:
        return []
    head = ["scene", "bytes", "steps", "s", "spread", "faster", "M samples", "SSIM", "CIEDE2000"]
    return [
        "Through blocks, step 1: faster and alike beside \"full\" at the same blocks.",
        table(head, cells, left=3), "",
    ]


def _sizes(parts: list[list[dict[str, Any]]]) -> list[str]:
    cells = [
        [r["scene"], r["size"], r["oversampling"], *_time(r["plain"]["time"]),
         _millions(r["plain"]["samples"]), *_time(r["pyramid"]["time"]),
         _millions(r["pyramid"]["samples"]), f"{r['faster']['ratio']:.2f}", f"{r['rmse']:.2e}"]
        for part in parts for r in part
    ]  # fmt: skip
    if not cells:
        return []
    head = ["scene", "pixels", "oversampling", "plain s", "spread", "M samples", "pyramid s",
            "spread", "M samples", "faster", "RMSE of both"]  # fmt: skip
    return [
        "Pictures of more pixels, step 1. Oversampling: levels by which rays lie nearer than"
        " slices.",
        table(head, cells), "",
    ]  # fmt: skip


def _light(parts: list[dict[str, Any]]) -> list[str]:
    cells = [[
        part["scene"] if r is part["rows"][0] else "", r["method"], " ".join(f"{k:g}" for k in r["settings"]),
        *_time(r["time"]), f"{r['rmse']:.2e}", _millions(r["samples"]), _millions(r["gradients"]),
    ] for part in parts for r in part["rows"]]  # fmt: skip
    if not cells:
        return []
    head = ["scene", "method", "step, epsilon, levels", "s", "spread", "RMSE", "M samples", "M gradients"]
    return ["Lit, beside the lit ray caster with short steps.", table(head, cells, left=3), ""]


def _power(rows: list[dict[str, Any]]) -> list[str]:
    cells = [[
        r["scene"], f"{r['epsilon']:g}", _millions(r["samples"]["minimum"]),
        *(f"{r['fewer'][way]:.2f}" for way in WAYS), f"{r['exponent']:.2f}", *(f"{r['rmse'][way]:.1e}" for way in WAYS),
    ] for r in rows]  # fmt: skip
    if not cells:
        return []
    head = ["scene", "epsilon", "M of minimum", "fewer along", "across", "both", "exponent", "RMSE along", "across",
            "both"]  # fmt: skip
    return ["Samples with levels along rays alone, across alone, both; exponent: of what both gain over along.",
            table(head, cells), ""]  # fmt: skip


def _synthesis(parts: list[list[dict[str, Any]]]) -> list[str]:
    cells = [
        [r["scene"], r["level"], name, f"{way['rmse']:.2e}", f"{way['sharpness']:.2f}", f"{way['kinks']:.2f}"]
        for part in parts for r in part for name, way in r["ways"].items()
    ]  # fmt: skip
    if not cells:
        return []
    return ["Pixels synthesised from each 2^level-th ray of a row, beside all rays. Sharpness: mean"
            " differences of neighbours over theirs; kinks: second differences where bilinear pieces meet"
            " over those elsewhere.",
            table(["scene", "level", "synthesis of", "RMSE", "sharpness", "kinks"], cells, left=3), ""]  # fmt: skip
