"""Draws anti-aliased lines, areas and text onto a displayed picture, of 8 or 16 bits, with or without alpha."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from clvol.overlay.fonts import font, line_height, text_mask, text_width

Ink = tuple[float, float, float]  # encoded, as on the screen, from 0 to 1
Point = tuple[float, float]  # x, y in pixels; (0, 0) is the picture's top left corner
WHITE: Ink = (1.0, 1.0, 1.0)
BLACK: Ink = (0.0, 0.0, 0.0)
_LIGHT = 0.55  # encoded brightness from which black is easier to read than white
_BAND = 32  # rows whose lines are drawn together
_HALO = 0.75  # opacity of what is around letters and lines
_LUMA = np.array([0.2126, 0.7152, 0.0722])


class Inks(NamedTuple):
    """The colour of text and lines, and that of what separates them from the picture."""

    ink: Ink
    halo: Ink


class Canvas:
    """``picture`` (uint8 or uint16 [height, width, 3 or 4], straight alpha), which is drawn on in place.

    ``color``: of all text and lines; None takes black or white, whichever can be read where it is drawn.
    """

    def __init__(self, picture: np.ndarray, color: Ink | None = None) -> None:
        self.picture, self._color = picture, color
        self.height, self.width = picture.shape[:2]
        self._top = float(np.iinfo(picture.dtype).max)

    @property
    def has_color(self) -> bool:
        """Whether all text and lines have one colour, which was requested."""
        return self._color is not None

    def inks(self, x: float, y: float, width: float, height: float) -> Inks:
        """What can be read in a rectangle, by the mean brightness of the picture there. What is transparent counts as
        middle grey, on which white is read."""
        ink = self._color
        if ink is None:
            rows, columns = _span(y, height, self.height), _span(x, width, self.width)
            ink = BLACK if self._brightness(rows, columns) > _LIGHT else WHITE
        return Inks(ink, BLACK if float(_LUMA @ np.array(ink)) > 0.5 else WHITE)

    def _brightness(self, rows: slice, columns: slice) -> float:
        few = (slice(rows.start, rows.stop, max(1, (rows.stop - rows.start) // 64)),
               slice(columns.start, columns.stop, max(1, (columns.stop - columns.start) // 64)))  # fmt: skip
        part = self.picture[few].astype(np.float64) / self._top
        light = part[..., :3] @ _LUMA
        if part.shape[-1] == 4:
            light = light * part[..., 3] + 0.45 * (1.0 - part[..., 3])
        return float(light.mean()) if light.size else 0.0

    def paint(self, x: int, y: int, cover: np.ndarray, color: Ink | np.ndarray) -> None:
        """Covers the picture with ``color`` ([3], or [h, w, 3]) to the extent of ``cover`` [h, w], 0 to 1, whose first
        element lies at the pixel (x, y); what is outside the picture is left out."""
        top, left = max(0, -y), max(0, -x)
        cover = cover[top : max(top, self.height - y), left : max(left, self.width - x)]
        if not cover.size:
            return
        inks = np.asarray(color, np.float32)
        rows, columns = np.nonzero(cover > 0)  # most of what lines and letters lie in is empty
        if inks.ndim == 3:
            inks = inks[top : top + cover.shape[0], left : left + cover.shape[1]][rows, columns]
        at = rows + (y + top), columns + (x + left)
        part = self.picture[at].astype(np.float32) / np.float32(self._top)
        over = cover[rows, columns].astype(np.float32)[:, None]
        if part.shape[-1] == 4:
            alpha = over + part[..., 3:] * (1.0 - over)
            mixed = inks * over + part[..., :3] * part[..., 3:] * (1.0 - over)
            part[..., :3] = np.divide(mixed, alpha, out=part[..., :3].copy(), where=alpha > 0.0)
            part[..., 3:] = alpha
        else:
            part = part * (1.0 - over) + inks * over
        self.picture[at] = np.rint(np.float32(self._top) * np.clip(part, 0.0, 1.0)).astype(self.picture.dtype)

    def rectangle(self, x: float, y: float, width: float, height: float, color: Ink, opacity: float = 1.0) -> None:
        """A filled rectangle; pixels that it covers in part are blended."""
        columns, rows = _covered(x, width, self.width), _covered(y, height, self.height)
        self.paint(columns[0], rows[0], opacity * rows[1][:, None] * columns[1], color)

    def bordered(self, x: float, y: float, width: float, height: float, inks: Inks, border: float) -> None:
        """A rectangle with a border in the colour of the halo."""
        self.rectangle(x - border, y - border, width + 2 * border, height + 2 * border, inks.halo, _HALO)
        self.rectangle(x, y, width, height, inks.ink)

    def text(self, text: str, x: float, y: float, size: float, inks: Inks, *, anchor: float = 0.0, bold: bool = False,
             ) -> None:  # fmt: skip
        """One line of text, whose top is at ``y``. ``anchor``: the share of its width that is to the left of ``x``."""
        face = font(size, bold)
        stroke = max(1, round(size / 9))
        letters, around, left = text_mask(text, face, stroke)
        column = round(x - anchor * text_width(text, face)) + left
        self.paint(column, round(y) - stroke, _HALO * around, inks.halo)
        self.paint(column, round(y) - stroke, letters, inks.ink)

    def lines_of_text(
        self, lines: Sequence[str], x: float, y: float, size: float, *, anchor: float = 0.0, bold: bool = False
    ) -> None:
        """Lines of text below one another, the first with its top at ``y``."""
        face = font(size, bold)
        width = max((text_width(line, face) for line in lines), default=0.0)
        inks = self.inks(x - anchor * width, y, width, len(lines) * line_height(face))
        for number, line in enumerate(lines):
            self.text(line, x, y + number * line_height(face), size, inks, anchor=anchor, bold=bold)

    def strokes(
        self, strokes: Sequence[tuple[Point, Point]], width: float, color: Ink, opacity: float = 1.0,
        behind: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Straight lines with round ends, as one shape. ``behind``: opacity [height, width] of what covers them."""
        if not strokes:
            return
        ends = np.array(strokes, np.float64)  # [n, 2, 2]
        reach = 0.5 * width + 1.0
        first = max(0, math.floor(ends[..., 1].min() - reach))
        last = min(self.height, math.ceil(ends[..., 1].max() + reach) + 1)
        for row in range(first, last, _BAND):
            stop = min(row + _BAND, last)
            pieces = [piece for piece in (_within(end, row - reach, stop + reach) for end in ends) if piece is not None]
            if not pieces:
                continue
            some = np.array(pieces)
            left = max(0, math.floor(some[..., 0].min() - reach))
            right = min(self.width, math.ceil(some[..., 0].max() + reach) + 1)
            if left >= right:
                continue
            cover = np.zeros((stop - row, right - left), np.float32)
            for piece in pieces:
                _add_stroke(cover, piece - np.array([left, row]), width)
            cover *= opacity
            if behind is not None:
                rows, columns = np.nonzero(cover)
                covering = np.nan_to_num(behind[rows + row, columns + left])
                cover[rows, columns] *= 1.0 - np.clip(covering, 0.0, 1.0)
            self.paint(left, row, cover, color)

    def outlined(self, strokes: Sequence[tuple[Point, Point]], width: float, inks: Inks) -> None:
        """Lines with a halo around them."""
        self.strokes(strokes, width + max(1.5, width), inks.halo, _HALO)
        self.strokes(strokes, width, inks.ink)


def _within(ends: np.ndarray, low: float, high: float) -> np.ndarray | None:
    """The part of a line [2, 2] whose y is from ``low`` to ``high``; None if there is none."""
    (x0, y0), (x1, y1) = ends
    if max(y0, y1) < low or min(y0, y1) > high:
        return None
    if y0 == y1:
        return ends
    parts = np.clip(np.array([(low - y0) / (y1 - y0), (high - y0) / (y1 - y0)]), 0.0, 1.0)
    return ends[0] + np.sort(parts)[:, None] * (ends[1] - ends[0])


def _add_stroke(cover: np.ndarray, ends: np.ndarray, width: float) -> None:
    """Raises ``cover`` [h, w] to the coverage of a line with the ends [2, 2], by the distance of pixel centres."""
    reach = 0.5 * width + 1.0
    left, right = max(0, int(ends[:, 0].min() - reach)), min(cover.shape[1], math.ceil(ends[:, 0].max() + reach) + 1)
    top, bottom = max(0, int(ends[:, 1].min() - reach)), min(cover.shape[0], math.ceil(ends[:, 1].max() + reach) + 1)
    if left >= right or top >= bottom:
        return
    along = ends[1] - ends[0]
    dx, dy = np.arange(left, right) + 0.5 - ends[0, 0], (np.arange(top, bottom) + 0.5 - ends[0, 1])[:, None]
    length = float(along @ along)
    t = np.clip((dx * along[0] + dy * along[1]) / length, 0.0, 1.0) if length else 0.0
    distance = np.hypot(dx - t * along[0], dy - t * along[1])
    part = cover[top:bottom, left:right]
    np.maximum(part, np.clip(0.5 * width + 0.5 - distance, 0.0, min(1.0, width)), out=part)


def _covered(start: float, length: float, limit: int) -> tuple[int, np.ndarray]:
    """(first pixel, share of each pixel that is covered) along one axis."""
    first, last = max(0, math.floor(start)), min(limit, math.ceil(start + length))
    edges = np.arange(first, max(first, last) + 1, dtype=np.float64)
    return first, np.clip(np.diff(np.clip(edges, start, start + length)), 0.0, 1.0)


def _span(start: float, length: float, limit: int) -> slice:
    low = min(max(0, math.floor(start)), limit - 1)
    return slice(low, min(limit, max(low + 1, math.ceil(start + length))))
