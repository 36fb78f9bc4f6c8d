"""Histograms for clvol info: as text, and as a picture."""

from __future__ import annotations

import io
import sys
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clvol.choice.histogram import Histogram

_WIDTH = 44  # characters of the longest bar
_EIGHTHS = " ▏▎▍▌▋▊▉█"


def histogram_rows(histogram: Histogram) -> list[str]:
    """One line per bin: from, to, a bar whose length is logarithmic, and the share of voxels."""
    counts = histogram.counts
    total, largest = max(int(counts.sum()), 1), np.log1p(max(int(counts.max()), 1))
    starts = [f"{edge:.6g}" for edge in histogram.edges]
    wide = max(len(start) for start in starts)
    fine = _has_blocks()
    rows = []
    for k, count in enumerate(counts.tolist()):
        eighths = round(8 * _WIDTH * float(np.log1p(count)) / float(largest))
        if count and not eighths:
            eighths = 1
        bar = "█" * (eighths // 8) + _EIGHTHS[eighths % 8].strip() if fine else "#" * -(-eighths // 8)
        share = f"{100 * count / total:.3g} %" if count else ""
        rows.append(f"{starts[k]:>{wide}} to {starts[k + 1]:>{wide}}  {bar:<{_WIDTH}}  {share}".rstrip())
    return rows


def _has_blocks() -> bool:
    try:
        "█▏".encode(getattr(sys.stdout, "encoding", None) or "utf-8")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def drawn(histogram: Histogram, name: str) -> bytes:
    """A PNG of the histogram, with a logarithmic axis of counts."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.stairs(histogram.counts, histogram.edges, fill=True, color="#4a7ba8")
    if histogram.counts.max() > 0:
        axes.set_yscale("log")
        axes.set_ylim(bottom=0.7)
    axes.set_xlim(histogram.edges[0], histogram.edges[-1])
    part = "" if histogram.voxels == histogram.all_voxels else f" of {histogram.voxels} of {histogram.all_voxels}"
    axes.set_xlabel("value")
    axes.set_ylabel(f"voxels{part}")
    axes.set_title(name, parse_math=False)
    axes.grid(axis="y", alpha=0.3)
    file = io.BytesIO()
    figure.savefig(file, format="png", metadata={"Software": "clvol"})
    return file.getvalue()
