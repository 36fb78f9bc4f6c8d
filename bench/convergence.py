"""Verification by convergence: the order of accuracy that each quadrature shows, against theory.

Unlike the other measurements this one claims no time: every row of bench/convergence_rows.py is an
error under refinement, and holds if the observed order is the expected one within its band (what
``Convergence.departure`` says). The tests assert the same rows on every device.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.options import Options
from bench.report import machine, say, table

SUMMARY = "observed order of accuracy of each quadrature, of grid and of pixels, against theory"
PICTURE = Path(__file__).resolve().parent / "convergence.png"
QUICK_ROWS = ("post", "preintegrated-falling", "no-self-attenuation", "grid-reference")


def run(options: Options) -> dict[str, Any] | None:
    from bench.convergence_rows import ROWS
    from clvol.opencl.context import DeviceContext
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    context = DeviceContext(device)
    rows = []
    for row in ROWS:
        if options.quick and row.name not in QUICK_ROWS:
            continue
        measured = row.measure(context)
        departure = measured.departure(row.expected, row.band)
        if departure:
            say(f"{row.name}: {departure}")
        rows.append({
            "name": row.name, "refined": row.refined, "title": row.title,
            "expected": row.expected, "band": row.band, "reason": row.reason,
            "observed": measured.order, "local_orders": measured.local_orders,
            "h": measured.h, "errors": measured.errors, "floor": measured.floor,
            "departure": departure,
        })  # fmt: skip
    context.release()
    return {"machine": machine(device), "quick": options.quick, "rows": rows}


def show(result: dict[str, Any]) -> str:
    rows = [
        [
            r["refined"], r["title"], f"{r['expected']:g}", f"{r['observed']:.2f}",
            f"{r['h'][0]:.3g} to {r['h'][-1]:.2g}", f"{r['errors'][-1]:.1e}", f"{r['floor']:.1e}",
            "DEPARTS" if r["departure"] else "holds",
        ]
        for r in result["rows"]
    ]  # fmt: skip
    head = ["refined", "row", "expected", "observed", "h", "finest error", "floor", ""]
    held = sum(not r["departure"] for r in result["rows"])
    width = max(len(r["title"]) for r in result["rows"])
    return "\n".join([
        table(head, rows, left=2),
        "",
        *(f"{r['title']:{width}}  {r['expected']:g}: {r['reason']}" for r in result["rows"]),
        "",
        f"{held} of {len(rows)} rows hold; bands are "
        + ", ".join(f"{band:g}" for band in sorted({r["band"] for r in result["rows"]})),
    ])


def draw(result: dict[str, Any], options: Options) -> list:
    """The picture in bench/ is drawn anew by a whole run, never by a quick one."""
    from bench.charts import convergence_chart

    path = options.folder / "convergence.png" if options.quick else PICTURE
    return [convergence_chart(result, path)]
