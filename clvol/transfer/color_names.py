"""Colours as text: CSS names, "#rgb" and "#rrggbb", and the names of matplotlib's palettes ("tab:blue", "xkcd:sky")."""

from __future__ import annotations

import re
from difflib import get_close_matches
from typing import Any

import numpy as np

from clvol.transfer.color import srgb_to_linear

EXPECTED = "three numbers [r, g, b] from 0 to 1, a colour name or '#rrggbb'"
_HEX = re.compile(r"#(?:[0-9a-f]{3}|[0-9a-f]{6})")
_PALETTES = ("tab:", "xkcd:")
_LONGEST = 100  # characters; longer texts get no "did you mean"

Triple = tuple[float, float, float]


class NamedColor(tuple):  # type: ignore[type-arg]  # three floats
    """Three components from 0 to 1 that were stated as the text ``text``, whose meaning is an sRGB colour.

    The components are sRGB-encoded, or linear light where the key is (``linear``).
    """

    text: str
    is_linear: bool

    def __new__(cls, text: str, linear: bool = False) -> NamedColor:
        """ValueError, whose message is what was expected, for a text that names no colour."""
        components = parse_color(text)
        if linear:
            components = tuple(srgb_to_linear(components).tolist())  # type: ignore[assignment]
        self = super().__new__(cls, components)
        self.text, self.is_linear = text, linear
        return self

    def __getnewargs__(self) -> tuple[str, bool]:  # type: ignore[override]  # copies and pickles keep the text
        return self.text, self.is_linear


def in_linear_light(color: Any, is_linear: bool) -> np.ndarray:
    """Colours [..., 3] in linear light. ``is_linear``: numbers are, while names are sRGB colours all the same."""
    if isinstance(color, NamedColor):
        is_linear = color.is_linear
    elif is_linear and isinstance(color, (list, tuple)) and any(isinstance(row, NamedColor) for row in color):
        return np.array([in_linear_light(row, is_linear) for row in color])
    return np.array(color, dtype=np.float64) if is_linear else srgb_to_linear(color)


def parse_color(text: str) -> Triple:
    """The sRGB-encoded components of a colour's name; ValueError, whose message is what was expected."""
    from PIL import ImageColor

    folded = text.strip().lower()
    if _HEX.fullmatch(folded) or folded in ImageColor.colormap:
        levels = ImageColor.getrgb(folded)
        return levels[0] / 255, levels[1] / 255, levels[2] / 255
    if folded.startswith(_PALETTES):
        from matplotlib.colors import to_rgb

        try:
            red, green, blue = to_rgb(folded)
            return float(red), float(green), float(blue)
        except ValueError:
            pass
    near = get_close_matches(folded, ImageColor.colormap, n=1) if len(folded) <= _LONGEST else []
    raise ValueError(EXPECTED + (f" (did you mean {near[0]!r}?)" if near else ""))
