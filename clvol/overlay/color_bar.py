"""The transfer function: its colours, and its opacity over the histogram of the volume."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.overlay.canvas import Canvas, Inks
from clvol.overlay.fonts import font, line_height, text_width, wrapped
from clvol.overlay.scale import number, ticks
from clvol.transfer.color import linear_to_srgb
from clvol.transfer.function import TransferFunction

if TYPE_CHECKING:
    from clvol.overlay.description import Description


_DECADES = 4.0  # of counts, from the bottom of the histogram to its top


def draw_color_bar(canvas: Canvas, description: Description, size: float, bottom: float) -> float:
    """At the bottom right: a panel with the histogram (logarithmic), the opacity over it from 0 to its largest, the
    colours below, and values below these. Returns the panel's top row, ``bottom`` where there is none."""
    width = round(min(0.36 * canvas.width, 15 * size))  # what is at the middle below stays free
    if width < 8 or not description.values:
        return bottom
    small = 0.85 * size
    face = font(small)
    high = line_height(face)
    label = wrapped(description.settings.value_label or "", face, width)[:1]
    graph, strip = round(4.0 * size), max(3, round(0.75 * size))
    pad = 0.5 * size
    below = high * (2 if label[0] else 1) + 0.1 * size
    right = canvas.width - 0.8 * size - pad
    x, y = round(right - width), round(bottom - pad - below - strip - graph)
    inks = canvas.inks(x - pad, y - pad, width + 2 * pad, graph + strip + below + 2 * pad)
    canvas.rectangle(x - pad, y - pad, width + 2 * pad, graph + strip + below + 2 * pad, inks.halo, 0.45)
    low, high_value = description.low, description.high
    if not low < high_value:
        low, high_value = low - 0.5, high_value + 0.5
    function = TransferFunction(description.values, description.opacities, description.colors)
    across = low + (np.arange(width) + 0.5) / width * (high_value - low)
    colors = linear_to_srgb(np.clip(function.color(across), 0.0, 1.0))
    _fill_opacity(canvas, function, across, colors, x, y, graph)
    _draw_histogram(canvas, description, x, y, width, graph, inks)
    _draw_opacity(canvas, function, across, x, y, graph, size, inks)
    canvas.bordered(x, y + graph, width, strip, Inks(inks.halo, inks.ink), max(1.0, 0.05 * size))
    canvas.paint(x, y + graph, np.ones((strip, width)), np.broadcast_to(colors, (strip, width, 3)))
    for surface in description.surfaces:
        if low <= surface.value <= high_value:
            column = x + (surface.value - low) / (high_value - low) * width
            shown = linear_to_srgb(np.clip(surface.color, 0.0, 1.0))
            ends = [((column, float(y)), (column, float(y + graph + strip)))]
            own = Inks((float(shown[0]), float(shown[1]), float(shown[2])), inks.ink)
            canvas.outlined(ends, max(1.5, 0.12 * size), own)
    _draw_ticks(canvas, low, high_value, x, y + graph + strip, width, small, inks)
    if label[0]:
        canvas.text(label[0], x + width / 2, y + graph + strip + 0.1 * size + high, small, inks, anchor=0.5)
    return y - pad


def _draw_histogram(
    canvas: Canvas, description: Description, x: int, y: int, width: int, height: int, inks: Inks
) -> None:
    counts = np.array(description.counts, np.float64)
    if not counts.size or not counts.max():
        return
    with np.errstate(divide="ignore"):
        filled = np.clip(1.0 + np.log10(counts / counts.max()) / _DECADES, 0.0, 1.0)
    bins = np.minimum((np.arange(width) + 0.5) / width * counts.size, counts.size - 1).astype(int)
    tops = height * (1.0 - filled[bins])
    cover = np.clip(np.arange(height)[:, None] + 1.0 - tops, 0.0, 1.0)
    canvas.paint(x, y, 0.38 * cover, inks.ink)


def _fill_opacity(
    canvas: Canvas, function: TransferFunction, across: np.ndarray, colors: np.ndarray, x: int, y: int, height: int
) -> None:
    """The area below the opacity, in the colours."""
    opacity = function.opacity(across)
    rows = height * (1.0 - 0.94 * opacity / max(float(opacity.max()), 1e-300))
    cover = np.clip(np.arange(height)[:, None] + 1.0 - rows, 0.0, 1.0)
    canvas.paint(x, y, 0.5 * cover, np.broadcast_to(colors, (*cover.shape, 3)))


def _draw_opacity(
    canvas: Canvas, function: TransferFunction, across: np.ndarray, x: int, y: int, height: int, size: float, inks: Inks
) -> None:
    """The opacity as a line, and its largest value."""
    opacity = function.opacity(across)
    largest = float(opacity.max())
    if largest <= 0.0:
        return
    rows = height * (1.0 - 0.94 * opacity / largest)
    first, last = float(across[0]), float(across[-1])
    inner = [(v, o) for v, o in zip(function.values.tolist(), function.opacities.tolist()) if first < v < last]
    corners = [(first, float(opacity[0])), *inner, (last, float(opacity[-1]))]  # it is linear between control points
    scale = (len(across) - 1) / (last - first)
    places = [(x + 0.5 + scale * (v - first), y + height * (1.0 - 0.94 * o / largest)) for v, o in corners]
    canvas.outlined(list(zip(places, places[1:])), max(1.0, 0.1 * size), inks)
    text = f"opacity to {largest:.3g}"
    small = max(0.75 * size, 8.0)
    if text_width(text, font(small)) < len(across):
        left = rows[: len(rows) // 2].mean() > rows[len(rows) // 2 :].mean()  # where the curve is lower
        canvas.text(text, x + (1 if left else len(across) - 1), y, small, inks, anchor=0.0 if left else 1.0)


def _draw_ticks(
    canvas: Canvas, low: float, high: float, x: int, y: float, width: int, size: float, inks: Inks
) -> None:
    """Values below the colours: as many as there is room for, none of them outside the panel."""
    face = font(size)
    for most in (5, 4, 3, 2):
        values = ticks(low, high, most)
        texts = [number(value) for value in values]
        places = [x + (value - low) / (high - low) * width for value in values]
        spans = []
        for text, place in zip(texts, places):
            half = 0.5 * text_width(text, face)
            centre = min(max(place, x + half), x + width - half)
            spans.append((centre - half, centre + half))
        if all(a[1] + 0.4 * size < b[0] for a, b in zip(spans, spans[1:])):
            break
    for text, place, span in zip(texts, places, spans):
        canvas.strokes([((place, y + 1.0), (place, y + 0.25 * size))], max(1.0, 0.08 * size), inks.ink)
        canvas.text(text, span[0], y + 0.2 * size, size, inks)
