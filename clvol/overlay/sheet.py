"""A contact sheet: pictures in rows, each with its caption under it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clvol.errors import UsageError
from clvol.overlay.canvas import Canvas, Ink
from clvol.overlay.fonts import font, line_height, wrapped

LARGEST_PIXELS = 2**28
_TEXT = 0.05  # height of letters, as a share of a picture's width
_SMALLEST = 10.0  # pixels of letters
_MOST_LINES = 3


@dataclass(frozen=True, eq=False)
class Cell:
    """One picture (uint8 [height, width, 3]; None: there is none), its name and a second line; or why it is missing."""

    picture: np.ndarray | None
    name: str
    told: str = ""
    error: str | None = None


class SheetLayout:
    """Where the cells are: ``count`` pictures of ``width`` x ``height`` pixels in ``columns``, and a title above."""

    def __init__(self, count: int, width: int, height: int, columns: int, title: str = "") -> None:
        self.width, self.height, self.columns = width, height, min(columns, count)
        self.size = max(_SMALLEST, _TEXT * width)
        self.gap = round(0.7 * self.size)
        self.caption = round(line_height(font(self.size, True)) + line_height(font(0.85 * self.size)))
        page = self.columns * (width + self.gap) + self.gap
        self.title = wrapped(title, font(1.5 * self.size, True), page - 2 * self.gap)[:_MOST_LINES] if title else []
        self.top = self.gap + (round(len(self.title) * line_height(font(1.5 * self.size, True))) if title else 0)
        rows = math.ceil(count / self.columns)
        self.page = page, self.top + rows * (height + self.caption + self.gap)
        if self.page[0] * self.page[1] > LARGEST_PIXELS:
            what = f"a sheet of {self.page[0]} x {self.page[1]} pixels"
            raise UsageError("--size", what, f"at most {LARGEST_PIXELS} pixels in all")

    def place(self, number: int) -> tuple[int, int]:
        """The pixel (x, y) at the top left of a picture."""
        row, column = divmod(number, self.columns)
        return self.gap + column * (self.width + self.gap), self.top + row * (self.height + self.caption + self.gap)


def compose(cells: Sequence[Cell], layout: SheetLayout, page: Ink) -> np.ndarray:
    """The sheet, uint8 [height, width, 3], on a ground of the colour ``page``."""
    width, height = layout.page
    sheet = np.empty((height, width, 3), np.uint8)
    sheet[:] = np.rint(255 * np.array(page)).astype(np.uint8)
    canvas = Canvas(sheet)
    if layout.title:
        canvas.lines_of_text(layout.title, width / 2, layout.gap, 1.5 * layout.size, anchor=0.5, bold=True)
    for number, cell in enumerate(cells):
        x, y = layout.place(number)
        if cell.picture is not None:
            sheet[y : y + layout.height, x : x + layout.width] = cell.picture
        _caption(canvas, layout, cell, x, y)
    return sheet


def _caption(canvas: Canvas, layout: SheetLayout, cell: Cell, x: int, y: int) -> None:
    size, small = layout.size, 0.85 * layout.size
    if cell.error is not None:
        canvas.rectangle(x, y, layout.width, layout.height, (0.35, 0.12, 0.12))
        lines = wrapped(cell.error, font(small), layout.width - 2 * layout.gap)
        most = max(1, int((layout.height - 2 * layout.gap) / line_height(font(small))))
        canvas.lines_of_text(lines[:most], x + layout.gap, y + layout.gap, small)
    below = y + layout.height
    canvas.lines_of_text(wrapped(cell.name, font(size, True), layout.width)[:1], x, below, size, bold=True)
    lines = wrapped(cell.told, font(small), layout.width)[:1]
    canvas.lines_of_text(lines, x, below + line_height(font(size, True)), small)
