"""A picture of who rendered what of a frame, and when: the tiles in the colours of their devices, and a Gantt chart."""

from __future__ import annotations

import os

import numpy as np

from clvol.render.frame_schedule import Schedule
from clvol.schedule.tiles import tiling

_UNKNOWN = (0.85, 0.85, 0.85)


def save_schedule(schedule: Schedule, size: tuple[int, int], path: str | os.PathLike[str]) -> None:
    """Writes a PNG of ``schedule``, of a picture of ``size`` (width, height)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    colors = _colors(len(schedule.names))
    rows = len(schedule.names)
    figure = Figure(figsize=(11, max(3.2, 1.4 + 0.32 * rows)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=[1, 1.6])
    left.imshow(_tiles(schedule, size, colors), interpolation="nearest", extent=(0, size[0], size[1], 0))
    left.set(title="tiles by device", xlabel="pixels", ylabel="pixels")
    for k in range(rows):
        own = [span for span in schedule.spans if span.device == k]
        right.barh(
            [k] * len(own),
            [1e3 * (span.end - span.begin) for span in own],
            left=[1e3 * span.begin for span in own],
            color=[colors[k] if span.counts else "white" for span in own],
            edgecolor="black", linewidth=0.6, height=0.7,
        )  # fmt: skip
    described = schedule.describe()
    labels = [f"{each['name']}  {100 * each['share']:.0f} %" for each in described["devices"]]
    right.set_yticks(range(rows), labels)
    right.set_ylim(rows - 0.4, -0.6)
    right.set_xlim(0, 1e3 * schedule.seconds)
    right.set(title=f"packages over time, efficiency {described['efficiency']:.2f}", xlabel="ms since the frame began")
    figure.savefig(os.fspath(path), format="png", metadata={"Software": "clvol"})


def _colors(count: int) -> list[tuple[float, ...]]:
    from matplotlib import colormaps

    names = colormaps["tab10"] if count <= 10 else colormaps["turbo"]
    return [tuple(names(k if count <= 10 else k / (count - 1))[:3]) for k in range(count)]


def _tiles(schedule: Schedule, size: tuple[int, int], colors: list[tuple[float, ...]]) -> np.ndarray:
    """float [rows, columns, 3]: colours of the tiles of the last stage."""
    last = max((span.stage for span in schedule.spans), default=0)
    grid = tiling(*size, *schedule.tile)
    found = np.tile(np.array(_UNKNOWN), (grid.count, 1))
    for span in schedule.spans:
        if span.stage == last and span.counts:
            found[span.tiles] = colors[span.device]
    return found.reshape(grid.rows, grid.columns, 3)
