"""What compression.py prints, the goals beside what was reached, and the tables of bench/README.md."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from bench.compression_errors import bits_at_error, bits_at_psnr
from bench.compression_rates import psnr_text
from bench.compression_scenes import CODED_SCENES
from bench.compression_speed import rate
from bench.curves import Reach
from bench.multiresolution_tables import Verdict
from bench.report import closing, table

Rows = list[dict[str, Any]]
DECODE_GOAL, OVER_ZFP_GOAL, ENCODE_GOAL = 4000.0, 20.0, 30.0  # million voxels per second; times; as the first
RESIDENT_GOAL = 1.10
# scene: mean CIEDE2000 of blocks without codes at the same bytes, before there were codes; half of it is wanted
BUDGET_BEFORE, BUDGET_LARGEST = {"female": 2.01, "crab": 2.18}, 15.0
_RIVALS = ("sz3, bound", "zfp, accuracy", "zfp, rate")
_NAMES = {"sz3, bound": "SZ3", "zfp, accuracy": "zfp, fixed accuracy", "zfp, rate": "zfp, fixed rate"}


def verdicts(result: dict[str, Any]) -> list[Verdict]:
    """Every goal of which there is something to judge."""
    found: list[Verdict] = []
    rvq = [row for row in result["rates"] if row["codec"] == "rvq"]
    for scene in CODED_SCENES:
        own = [row for row in rvq if row["volume"] == scene.name]
        if scene.goal is None or not own:
            continue
        bits, psnr = scene.goal
        asked = [row for row in own if row["kind"] == "rate" and row["asked"] == bits]
        for row in asked:
            what = f"{scene.name}, asked for {bits:g} bits per voxel"
            found += [Verdict(f"{what}: PSNR", _decibels(row), psnr), Verdict(f"{what}: bits", row["bits"], bits, True)]
        for row in own:
            if row["kind"] == "psnr":
                what = f"{scene.name}, asked for {psnr:g} dB"
                found.append(Verdict(f"{what}: PSNR", _decibels(row), psnr))
                found.append(Verdict(f"{what}: bits", row["bits"], scene.held, True))
    for row in rvq:
        if row["kind"] == "bound":
            what = f"{row['volume']}, largest error asked for {row['asked']:.1%}"
            found.append(Verdict(what, row["largest"], row["asked"], True))
    for row in result["speed"]:
        found += _speed_verdicts(row)
    for row in result["frames"]:
        if "resident" in row["ways"]:
            what = f"{row['scene']}, resident: times the time of voxels"
            found.append(Verdict(what, row["ways"]["resident"]["ratio"], RESIDENT_GOAL, True))
    for row in result["budget"]:
        way = row["ways"].get("rvq")
        if way is None or row["scene"] not in BUDGET_BEFORE:
            continue
        what = f"{row['scene']} {row['ratio']:g} : 1 as codes"
        found.append(Verdict(f"{what}: mean CIEDE2000", way["delta_e"], BUDGET_BEFORE[row["scene"]] / 2, True))
        found.append(Verdict(f"{what}: largest CIEDE2000", way["delta_e_largest"], BUDGET_LARGEST, True))
    return found


def _decibels(row: dict[str, Any]) -> float:
    return math.inf if row["psnr"] is None else row["psnr"]


def _speed_verdicts(row: dict[str, Any]) -> list[Verdict]:
    found, name = [], row["volume"]
    zfp = [rate(row, "decoding", way) for way in row["decoding"] if way.startswith("zfp")]
    for way in row["decoding"]:
        if way.startswith("rvq") and way.endswith("pocl, codes resident"):
            decoded = rate(row, "decoding", way)
            found.append(Verdict(f"{name}, {way}: million voxels decoded per second", decoded, DECODE_GOAL))
            if zfp:
                what = f"{name}, {way}: times as fast as zfp decodes"
                found.append(Verdict(what, decoded / max(zfp), OVER_ZFP_GOAL))
    for way in row["encoding"]:
        if way.startswith("rvq"):
            what = f"{name}, {way}: million voxels encoded per second"
            found.append(Verdict(what, rate(row, "encoding", way), ENCODE_GOAL))
    return found


def equal_rows(rows: Rows) -> list[dict[str, Any]]:
    """Per volume: the bits per voxel that rivals take for the same error as "rvq" has at each of its targets."""
    found = []
    for row in rows:
        if row["codec"] != "rvq" or row["kind"] == "psnr" or row["psnr"] is None:
            continue
        by_error = row["kind"] == "bound"
        entry = {"volume": row["volume"], "row": row, "by": "largest error" if by_error else "PSNR", "rivals": {}}
        for curve in _RIVALS:
            own = [r for r in rows if r["volume"] == row["volume"] and r["curve"] == curve and r["psnr"] is not None]
            if own and by_error:
                entry["rivals"][curve] = vars(bits_at_error([(r["bits"], r["largest"]) for r in own], row["largest"]))
            elif own:
                entry["rivals"][curve] = vars(bits_at_psnr([(r["bits"], r["psnr"]) for r in own], row["psnr"]))
        found.append(entry)
    return found


def reach_text(found: dict[str, Any]) -> str:
    """A rate at which a rival reaches an error."""
    reached = Reach(**found)
    if reached.seconds is None:
        return "not reached"
    return f"{'≤ ' if reached.kind == 'at most' else ''}{reached.seconds:.2f}"


def _rate_cells(rows: Rows) -> tuple[list[str], list[list[str]]]:
    head = ["volume", "codec", "asked", "bits per voxel", "PSNR", "largest error", "CIEDE2000, mean", "largest"]
    return head, [[
        row["volume"], row["curve"], _asked(row), f"{row['bits']:.3f}", psnr_text(row), f"{row['largest']:.2%}",
        f"{row['delta_e']:.3f}", f"{row['delta_e_largest']:.1f}",
    ] for row in rows]  # fmt: skip


def _asked(row: dict[str, Any]) -> str:
    if row["asked"] is None:
        return ""
    return {"rate": "{:g} bits", "psnr": "{:g} dB"}.get(row["kind"], "{:.3g}").format(row["asked"])


def _equal_cells(rows: Rows) -> tuple[list[str], list[list[str]]]:
    entries = equal_rows(rows)
    curves = [curve for curve in _RIVALS if any(curve in entry["rivals"] for entry in entries)]
    head = ["volume", "rvq: bits per voxel", "PSNR, dB", "largest error", "the same", *(_NAMES[c] for c in curves)]
    return head, [[
        entry["volume"], f"{entry['row']['bits']:.2f}", f"{entry['row']['psnr']:.1f}", f"{entry['row']['largest']:.1%}",
        entry["by"], *(reach_text(entry["rivals"][c]) if c in entry["rivals"] else "" for c in curves),
    ] for entry in entries]  # fmt: skip


def _speed_cells(rows: Rows) -> tuple[list[str], list[list[str]]]:
    """Million voxels per second: of the median time, its spread, and in brackets of the shortest time."""
    cells = []
    for part in ("training", "encoding", "decoding"):
        for way in dict.fromkeys(way for row in rows for way in row[part]):
            cells.append([part, way, *(_speed_cell(row, part, way) for row in rows)])
    return ["", "codec", *(row["volume"] for row in rows)], cells


def _speed_cell(row: dict[str, Any], part: str, way: str) -> str:
    if way not in row[part]:
        return ""
    if part == "training":
        return f"{row[part][way]:.1f} s"
    return f"{rate(row, part, way):.0f} ± {row[part][way]['spread'] / 2:.0%} ({rate(row, part, way, 'min'):.0f})"


def _frame_cells(rows: Rows) -> tuple[list[str], list[list[str]]]:
    head = ["scene", "held as", "ms", "spread", "times the voxels'", "from", "to", "CIEDE2000, mean"]
    return head, [
        [row["scene"], way, f"{1e3 * r['time']['median']:.1f}", f"{r['time']['spread']:.0%}", f"{r['ratio']:.2f}",
         f"{r['low']:.2f}", f"{r['high']:.2f}", f"{r['delta_e']:.3f}"]
        for row in rows for way, r in row["ways"].items()
    ]  # fmt: skip


def _store_cells(rows: Rows) -> tuple[list[str], list[list[str]]]:
    head = ["store", "asked for", "bits per voxel on disk", "with all levels and statistics", "PSNR", "largest error"]
    return head, [
        [row["scene"], f"{row['bits']:g}", f"{row['store']['bits']:.3f}", f"{row['store']['bits_all']:.3f}",
         psnr_text(row["store"]), f"{row['store']['largest']:.2%}"]
        for row in rows
    ]  # fmt: skip


def _crossover_cells(rows: Rows) -> tuple[list[str], list[list[str]]]:
    head = ["scene", "held as", "ray caster, ms", "pyramid, ms", "pyramid faster by", "from", "to"]
    cells = []
    for row in rows:
        for held, faster in row["faster"].items():
            times = [f"{1e3 * row['times'][f'{held}, {method}']['median']:.1f}" for method in ("raycast", "pyramid")]
            cells.append([row["scene"], held, *times, *(f"{faster[key]:.2f}" for key in ("ratio", "low", "high"))])
    return head, cells


def _budget_cells(rows: Rows) -> tuple[list[str], list[list[str]]]:
    head = ["scene", "bytes", "held as", "ms", "CIEDE2000, mean", "largest"]
    return head, [
        [row["scene"], f"{row['ratio']:g} : 1", way, f"{1e3 * r['time']['median']:.1f}", f"{r['delta_e']:.2f}",
         f"{r['delta_e_largest']:.1f}"]
        for row in rows for way, r in row["ways"].items()
    ]  # fmt: skip


# Heading, what is measured, cells, columns to the left. The first is too long for a README; the chart shows it.
_TABLES = (
    ("Rate against distortion", "rates", _rate_cells, 3),
    ("Bits per voxel that others take for the same error as rvq", "rates", _equal_cells, 1),
    ("Training, and million voxels per second of encoding and decoding (median, half the spread; shortest)",
     "speed", _speed_cells, 2),
    ("Stores of codes (rvq)", "frames", _store_cells, 1),
    ("Frames of the ray caster", "frames", _frame_cells, 2),
    ("The pyramid beside the ray caster, pre-integrated", "crossover", _crossover_cells, 2),
    ("Blocks within a budget, beside all voxels", "budget", _budget_cells, 3),
)


def show(result: dict[str, Any]) -> str:
    lines = [f"{result['size']} x {result['size']} pixels, step 1; {_versions(result)}"]
    for title, part, cells, left in _TABLES:
        if result[part]:
            lines += [title, table(*cells(result[part]), left=left), ""]
    return "\n".join([*lines, *map(str, verdicts(result)), "", *closing(result)])


def markdown(result: dict[str, Any]) -> str:
    """The same tables for bench/README.md, each with the processor that it was measured on."""
    machine = result["machine"]
    where = f"{machine['processor']}, {machine['cores']} cores"
    where += f", {machine['device']['platform']}" if "device" in machine else ""
    parts = [f"{_versions(result)}; load average {result['load_before']} to {result['load_after']}."]
    for title, part, cells, _ in _TABLES[1:]:
        if result[part]:
            parts.append(f"{title} ({where}):\n\n{markdown_table(*cells(result[part]))}")
    goals = [
        [v.what, f"at {'most' if v.at_most else 'least'} {v.goal:g}", f"{v.reached:.4g}", "yes" if v.is_met else "no"]
        for v in verdicts(result)
    ]
    if goals:
        parts.append(f"Goals ({where}):\n\n{markdown_table(['', 'goal', 'reached', 'met'], goals)}")
    return "\n\n".join(parts) + "\n"


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def _versions(result: dict[str, Any]) -> str:
    if not result["peers"]:
        return "zfp and SZ3 are left out"
    return ", ".join(f"{package} {version}" for package, version in result["peers"].items())
