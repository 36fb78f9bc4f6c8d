"""Directions: letters at the edges of the picture, or arrows in a corner."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.overlay.canvas import BLACK, Canvas, Ink, Inks
from clvol.overlay.fonts import font, line_height, text_width

if TYPE_CHECKING:
    from clvol.overlay.description import Description

_LEAST = 0.3  # component of a direction, of a unit vector, that is named
_MOST_LETTERS = 2
_COLORS: tuple[Ink, ...] = ((1.0, 0.42, 0.38), (0.36, 0.85, 0.40), (0.45, 0.66, 1.0))


def edge_names(description: Description) -> dict[str, str]:
    """What lies towards the "right", "left", "top" and "bottom" of the picture's centre: the names of the axes, the
    closest first, as in "L" or "LA"."""
    _, right, up = description.camera.basis()
    sides = {"right": right, "left": -right, "top": up, "bottom": -up}
    return {side: direction_name(description, direction) for side, direction in sides.items()}


def direction_name(description: Description, direction: np.ndarray) -> str:
    parts = np.array(description.axes) @ direction
    order = [int(k) for k in np.argsort(-np.abs(parts), kind="stable") if abs(parts[k]) >= _LEAST][:_MOST_LETTERS]
    return "".join(description.names[k] if parts[k] > 0 else description.opposites[k] for k in order)


def draw_letters(
    canvas: Canvas, description: Description, size: float, top: float, bottom: float, panel: float
) -> None:
    """The names at the middle of the four edges, between the rows ``top`` and ``bottom``; at the right above the row
    ``panel``."""
    large = 1.2 * size
    face = font(large, True)
    margin, high = 0.8 * size, line_height(face)
    names = edge_names(description)
    middle = 0.5 * (canvas.height - high)
    places = {
        "left": (margin, middle, 0.0), "right": (canvas.width - margin, min(middle, panel - high), 1.0),
        "top": (0.5 * canvas.width, top, 0.5), "bottom": (0.5 * canvas.width, bottom - high, 0.5),
    }  # fmt: skip
    for side, (x, y, anchor) in places.items():
        width = text_width(names[side], face)
        inks = canvas.inks(x - anchor * width, y, width, high)
        canvas.text(names[side], x, y, large, inks, anchor=anchor, bold=True)


def draw_axes(canvas: Canvas, description: Description, size: float, top: float) -> None:
    """Three arrows at the top right, the farthest drawn first; each is named at its end."""
    forward, right, up = description.camera.basis()
    axes = np.array(description.axes)
    radius = 2.6 * size
    face = font(size, True)
    room = radius + 1.5 * size
    x0, y0 = canvas.width - room - 0.4 * size, top + room
    readable = canvas.inks(x0 - room, y0 - room, 2 * room, 2 * room)
    own = canvas.has_color
    shade = 1.0 if readable.halo == BLACK else 0.68
    for k in np.argsort(-(axes @ forward), kind="stable"):
        x, y, away = float(axes[k] @ right), -float(axes[k] @ up), float(axes[k] @ forward)
        red, green, blue = _COLORS[k]
        color = readable.ink if own else (shade * red, shade * green, shade * blue)
        inks = Inks(color, readable.halo)
        end = (x0 + radius * x, y0 + radius * y)
        width = max(1.5, 0.16 * size) * (1.0 - 0.25 * away)
        strokes = [((x0, y0), end)]
        if (length := float(np.hypot(x, y))) > 0.25:  # a head, where the arrow does not point at the eye
            for turn in (2.6, -2.6):
                c, s = np.cos(turn), np.sin(turn)
                tip = 0.45 * size * np.array([c * x - s * y, s * x + c * y]) / length
                strokes.append((end, (end[0] + float(tip[0]), end[1] + float(tip[1]))))
        canvas.outlined(strokes, width, inks)
        out = (x / length, y / length) if length > 0.25 else (-0.7, 0.7)  # beside an arrow that points at the eye
        centre = (end[0] + 0.85 * size * out[0], end[1] + 0.85 * size * out[1])
        top_of_text = centre[1] - 0.5 * line_height(face)
        canvas.text(description.names[k], centre[0], top_of_text, size, inks, anchor=0.5, bold=True)
