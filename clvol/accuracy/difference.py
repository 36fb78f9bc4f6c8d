"""The difference of two pictures, as numbers and as a picture with its scale.

The difference of a pixel is the largest absolute difference of its four channels in linear, premultiplied light, so
the brightest pixel shows :func:`clvol.accuracy.metrics.max_abs`. Colours are matplotlib's "magma", whose lightness
rises evenly (van der Walt and Smith 2015), from black (no difference). Pixels that are not finite are shown in cyan,
which "magma" does not contain.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.accuracy.metrics import as_pair

COLOR_MAP = "magma"
NOT_FINITE = (0, 255, 255)
_LEVELS = 255  # entries of the palette for differences; the 256th is NOT_FINITE
_QUANTILE = 0.999  # share of pixels within a linear scale, so that a few outliers do not darken the rest
_MOST_DECADES = 8  # in a logarithmic scale, about as many as float32 resolves
_LEAST_WIDTH = 480  # pixels, for the scale's text
_FOOTER = 84  # pixels


def signed_difference(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """``a`` - ``b`` in linear light, float32 [height, width, 4]; both are [height, width, 4].

    Raises UsageError unless both have this shape and the same size.
    """
    a, b = as_pair(a, b)
    with np.errstate(invalid="ignore", over="ignore"):  # inf - inf is NaN, and is shown as such
        return (a - b).astype(np.float32)


def magnitude(difference: np.ndarray) -> np.ndarray:
    """The largest absolute difference of each pixel's channels, [height, width]; NaN if any is NaN."""
    return np.abs(difference).max(axis=-1)


@dataclass(frozen=True)
class Scale:
    """Maps differences to colours; ``full`` and above have the last colour.

    The scale is linear from 0 if ``low`` is None, and otherwise logarithmic from ``low``, below which all is black.
    """

    full: float
    low: float | None = None

    @property
    def gain(self) -> float:
        """The factor that maps differences to 0...1."""
        return 1.0 / self.full

    def share(self, values: ArrayLike) -> np.ndarray:
        """The positions of ``values`` on the scale, float64 in 0...1; NaN for NaN and infinity."""
        values = np.asarray(values, dtype=np.float64)
        values = np.where(np.isfinite(values), values, np.nan)
        if self.low is None:
            return np.clip(values / self.full, 0.0, 1.0)
        decades = math.log10(self.full / self.low)
        return np.clip(np.log10(np.maximum(values, self.low) / self.low) / decades, 0.0, 1.0)

    def indices(self, values: ArrayLike) -> np.ndarray:
        """The entry of :func:`palette` for each of ``values`` (any shape, not negative), uint8."""
        share = self.share(values)
        finite = np.isfinite(share)
        levels = np.round(np.where(finite, share, 0.0) * (_LEVELS - 1)).astype(np.uint8)
        return np.where(finite, levels, np.uint8(_LEVELS))

    def ticks(self) -> list[float]:
        """The differences that are labelled beside the scale, ascending."""
        if self.low is None:
            return [0.0, self.full / 2, self.full]
        first, last = round(math.log10(self.low)), round(math.log10(self.full))
        return [10.0**n for n in range(first, last + 1)]


def palette() -> np.ndarray:
    """The colours of :meth:`Scale.indices`, uint8 [256, 3], sRGB-encoded."""
    from matplotlib import colormaps

    colors = colormaps[COLOR_MAP](np.linspace(0.0, 1.0, _LEVELS))[:, :3]
    return np.vstack([np.round(255.0 * colors), NOT_FINITE]).astype(np.uint8)


def linear_scale(values: np.ndarray) -> Scale:
    """A scale from 0 to a round number (1, 2, 3 or 5 times a power of ten) that 99.9 % of ``values`` do not exceed;
    to 1 if there is no difference."""
    finite = values[np.isfinite(values)]
    if finite.size == 0 or not finite.max() > 0.0:
        return Scale(1.0)
    high = float(np.quantile(finite, _QUANTILE))
    return Scale(_round_up(high if high > 0.0 else float(finite.max())))


def logarithmic_scale(pictures: Iterable[np.ndarray]) -> Scale:
    """A scale of whole decades for all of ``pictures`` ([height, width] each): up to the largest value, and down to a
    tenth of the smallest root mean square of a picture; 2 to 8 decades."""
    largest, least = 0.0, math.inf
    for values in pictures:
        finite = values[np.isfinite(values)].astype(np.float64)
        if finite.size and finite.max() > 0.0:
            largest = max(largest, float(finite.max()))
            least = min(least, math.sqrt(float(np.mean(np.square(finite)))))
    if largest == 0.0:
        return Scale(1.0, 1e-2)
    top = math.ceil(math.log10(largest) - 1e-9)
    bottom = math.floor(math.log10(max(least, 1e-300)) - 1.0)
    bottom = max(min(bottom, top - 2), top - _MOST_DECADES)
    return Scale(10.0**top, 10.0**bottom)


def difference_picture(a: ArrayLike, b: ArrayLike, names: Sequence[str] = ("A", "B")) -> np.ndarray:
    """|a - b| in colours, above a bar that shows their scale, uint8 [height, width, 3].

    The scale is that of :func:`linear_scale`. Small pictures are enlarged by a whole factor. ``names``: the names of
    the two in the caption. Raises UsageError as :func:`signed_difference` does.
    """
    difference = signed_difference(a, b)
    values = magnitude(difference)
    scale = linear_scale(values)
    colors = palette()
    factor = max(1, 256 // max(values.shape))
    shown = np.kron(scale.indices(values), np.ones((factor, factor), dtype=np.uint8))
    picture = colors[shown]
    missing = _LEAST_WIDTH - picture.shape[1]
    if missing > 0:
        sides = (missing // 2, missing - missing // 2)
        picture = np.pad(picture, ((0, 0), sides, (0, 0)), constant_values=_MARGIN)
    footer = _footer(picture.shape[1], scale, colors, _caption(difference, values, names, factor))
    return np.vstack([picture, footer])


_MARGIN = 28  # the grey level beside and below the picture


def _caption(
    difference: np.ndarray, values: np.ndarray, names: Sequence[str], factor: int
) -> tuple[str, str]:
    finite = np.isfinite(values)
    largest = float(values[finite].max()) if finite.any() else math.nan
    first = f"|{names[0]} \N{MINUS SIGN} {names[1]}|, largest of R, G, B, A, linear light"
    parts = [f"largest {largest:.3g}"]
    if finite.all():
        rmse = math.sqrt(np.mean(np.square(difference.astype(np.float64))))
        parts.insert(0, f"RMSE {rmse:.3g}")
    else:
        parts.append(f"cyan: {int((~finite).sum())} pixels not finite")
    if factor > 1:
        parts.append(f"pixels {factor} times as large")
    return first, ", ".join(parts)


def _footer(width: int, scale: Scale, colors: np.ndarray, texts: tuple[str, str]) -> np.ndarray:
    """The bar with its numbers and the two texts, uint8 [_FOOTER, width, 3]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    dots = 100
    grey = f"#{_MARGIN:02x}{_MARGIN:02x}{_MARGIN:02x}"
    figure = Figure(figsize=(width / dots, _FOOTER / dots), dpi=dots, facecolor=grey)
    canvas = FigureCanvasAgg(figure)
    style: dict[str, Any] = {"color": "#e8e8e8", "fontsize": 7.5, "parse_math": False}
    edge = 14 / width
    figure.text(edge, 1 - 10 / _FOOTER, texts[0], va="top", **style)
    figure.text(edge, 1 - 27 / _FOOTER, texts[1], va="top", **style)
    bar = figure.add_axes((edge, 21 / _FOOTER, 1 - 2 * edge, 12 / _FOOTER))
    bar.imshow(colors[None, :_LEVELS], aspect="auto", extent=(0, 1, 0, 1), interpolation="nearest")
    bar.set_axis_off()
    ticks = scale.ticks()
    for value, at in zip(ticks, scale.share(ticks)):
        text = f"{value:g}"
        if value == scale.full:
            text = f"{text} and above (gain {scale.gain:.3g})"
        align = "left" if at == 0 else "right" if at == 1 else "center"
        figure.text(edge + at * (1 - 2 * edge), 18 / _FOOTER, text, va="top", ha=align, **style)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _round_up(value: float) -> float:
    """The least of 1, 2, 3, 5 times a power of ten that is not below ``value``."""
    power = math.floor(math.log10(value))
    for n in (power, power + 1):
        for digit in (1, 2, 3, 5):
            # Parsed from text, because 10.0**-5 * 2 is not the float nearest to 2e-5.
            rounded = float(f"{digit}e{n}")
            if rounded >= value * (1 - 1e-12):
                return rounded
    raise AssertionError(f"no round number above {value}")
