"""Draws an overlay over a displayed picture, and lays out its parts."""

from __future__ import annotations

import numpy as np

from clvol.overlay.box import draw_box
from clvol.overlay.canvas import Canvas
from clvol.overlay.color_bar import draw_color_bar
from clvol.overlay.description import Description
from clvol.overlay.fonts import font, line_height, text_width, wrapped
from clvol.overlay.orientation import draw_axes, draw_letters
from clvol.overlay.scale import bar_length, pixels_per_length

_TEXT = 0.027  # height of letters, as a share of the picture's shorter edge
_SMALLEST = 9.0  # pixels of letters that can be read
_MOST_LINES = 4


class DrawnOverlay:
    """The overlay of one picture, drawn from its ``description``."""

    def __init__(self, description: Description) -> None:
        self.description = description

    def to_json(self) -> str:
        return self.description.model_dump_json()

    @classmethod
    def from_json(cls, text: str) -> DrawnOverlay:
        """The inverse of ``to_json``. pydantic's ValidationError for anything else."""
        return cls(Description.model_validate_json(text))

    def drawn_over(self, shown: np.ndarray, opacity: np.ndarray) -> np.ndarray:
        """``shown`` (uint8 or uint16 [height, width, 3 or 4]) with the overlay; ``opacity`` [height, width] is that of
        the volume, which covers what lies behind it. ``shown`` itself is returned where nothing is drawn."""
        settings = self.description.settings
        if not settings.draws:
            return shown
        canvas = Canvas(shown.copy(), settings.color)
        size = settings.size * max(_SMALLEST, _TEXT * min(canvas.width, canvas.height))
        if settings.box:
            draw_box(canvas, self.description, opacity, size)
        top, bottom = self._texts(canvas, size)
        panel = draw_color_bar(canvas, self.description, size, bottom) if settings.color_bar else bottom
        if settings.orientation == "letters":
            draw_letters(canvas, self.description, size, top, bottom, panel)
        elif settings.orientation == "axes":
            draw_axes(canvas, self.description, size, top)
        if settings.scale_bar:
            self._scale_bar(canvas, size, bottom)
        return canvas.picture

    def _texts(self, canvas: Canvas, size: float) -> tuple[float, float]:
        """Draws title and caption; returns the rows between which there is room for the rest."""
        settings = self.description.settings
        margin = 0.8 * size
        top, bottom = margin, canvas.height - margin
        width = canvas.width - 2 * margin
        if settings.title:
            face = font(1.35 * size, True)
            lines = wrapped(settings.title, face, width)[:_MOST_LINES]
            canvas.lines_of_text(lines, canvas.width / 2, top, 1.35 * size, anchor=0.5, bold=True)
            top += len(lines) * line_height(face) + 0.4 * size
        if settings.caption:
            face = font(0.9 * size)
            lines = wrapped(settings.caption, face, width)[:_MOST_LINES]
            bottom -= len(lines) * line_height(face)
            canvas.lines_of_text(lines, canvas.width / 2, bottom, 0.9 * size, anchor=0.5)
            bottom -= 0.4 * size
        return top, bottom

    def _scale_bar(self, canvas: Canvas, size: float, bottom: float) -> None:
        """At the bottom left. Of a perspective view the length holds at the distance of the camera's target."""
        camera = self.description.camera
        scale = pixels_per_length(camera, canvas.height)
        length, name = bar_length(0.24 * canvas.width / scale, self.description.unit)
        lines, face = [name], font(size)
        if camera.projection == "perspective":
            whole = f"{name} at the target"
            lines = [whole] if text_width(whole, face) < 0.44 * canvas.width else [name, "at the target"]
        x, thickness = round(0.8 * size), max(2, round(0.28 * size))
        y = round(bottom - thickness)
        pixels, high = length * scale, len(lines) * line_height(face)
        inks = canvas.inks(x, y - high, max(pixels, size), thickness + high)
        canvas.bordered(x, y, pixels, thickness, inks, max(1.0, 0.08 * size))
        canvas.lines_of_text(lines, x, y - high - 0.15 * size, size)
