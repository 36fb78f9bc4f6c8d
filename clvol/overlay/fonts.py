"""The typeface of overlays, DejaVu Sans, which comes with matplotlib and has the letters of most alphabets."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from clvol.text import printable

_FILES = {False: "DejaVuSans.ttf", True: "DejaVuSans-Bold.ttf"}


@lru_cache(maxsize=64)
def font(size: float, bold: bool = False) -> Any:
    """A Pillow font of ``size`` pixels. matplotlib itself is not imported; Pillow's own typeface is taken where it does
    not have the file."""
    from PIL import ImageFont

    found = find_spec("matplotlib")
    for folder in (found.submodule_search_locations or ()) if found is not None else ():
        path = Path(folder) / "mpl-data" / "fonts" / "ttf" / _FILES[bold]
        if path.is_file():
            return ImageFont.truetype(str(path), size, layout_engine=ImageFont.Layout.BASIC)
    return ImageFont.load_default(size)


def text_width(text: str, face: Any) -> float:
    return float(face.getlength(text))


def line_height(face: Any) -> float:
    """Pixels from one base line to the next."""
    ascent, descent = face.getmetrics()
    return float(ascent + descent)


def text_mask(text: str, face: Any, stroke: int) -> tuple[np.ndarray, np.ndarray, int]:
    """(letters, letters with a stroke around them, left edge): float32 [h, w] from 0 to 1, of one line of ``text``.

    The first row is ``stroke`` pixels above the font's ascent, the first column ``left edge`` pixels from the origin.
    """
    from PIL import Image, ImageDraw

    left, _, right, _ = face.getbbox(text, stroke_width=stroke)
    size = max(1, int(right - left) + 2), int(line_height(face)) + 2 * stroke + 2
    masks = []
    for width in (0, stroke):
        image = Image.new("L", size)
        ImageDraw.Draw(image).text((-left, stroke), text, 255, face, stroke_width=width)
        masks.append(np.asarray(image, np.float32) / 255.0)
    return masks[0], masks[1], int(left)


def wrapped(text: str, face: Any, width: float) -> list[str]:
    """The lines of ``text``, broken between words, and within words that are wider than ``width`` pixels."""
    lines: list[str] = []
    for paragraph in text.split("\n"):
        line = ""
        for word in printable(paragraph).split(" "):
            longer = f"{line} {word}" if line else word
            if text_width(longer, face) <= width:
                line = longer
                continue
            if line:
                lines.append(line)
            while len(word) > 1 and text_width(word, face) > width:
                end = max(1, _fitting(word, face, width))
                lines.append(word[:end])
                word = word[end:]
            line = word
        lines.append(line)
    return lines


def _fitting(word: str, face: Any, width: float) -> int:
    """The number of letters of ``word`` that fit, by bisection."""
    low, high = 0, len(word)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if text_width(word[:middle], face) <= width else (low, middle - 1)
    return low
