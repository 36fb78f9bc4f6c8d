"""The picture as it is displayed: exposure, tone curve, background or transparency, sRGB encoding, overlay.

What is developed is linear light; nothing is rendered. The pixels are encoded by the exact piecewise curve of
IEC 61966-2-1 and rounded to nearest, without dithering.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clvol.transfer.color import linear_to_srgb, srgb_levels

_ROWS = 256  # rows that are encoded together, so that double precision takes little memory
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB
BLACK = (0.0, 0.0, 0.0)


def shown_picture(frame: Any, rgba: np.ndarray, bits: int = 8, may_be_transparent: bool = True) -> np.ndarray:
    """``rgba`` of ``frame`` as it is displayed, uint8 or uint16 [height, width, 3], or 4 where ``frame.display`` is
    transparent: over ``frame.background``, by ``frame.display`` and with ``frame.overlay``, where it has them."""
    background = getattr(frame, "background", None)
    how = getattr(frame, "display", None)
    shown = developed(rgba, BLACK if background is None else background, how, bits, may_be_transparent)
    overlay = getattr(frame, "overlay", None)
    return shown if overlay is None else overlay.drawn_over(shown, rgba[..., 3])


def developed(
    rgba: np.ndarray, background: Any, how: Any = None, bits: int = 8, may_be_transparent: bool = True
) -> np.ndarray:
    """``rgba`` (float32 [height, width, 4], linear, premultiplied) over ``background`` [3] (linear), encoded in
    ``bits`` (8 or 16): uint8 or uint16 [height, width, 3]; [height, width, 4] with straight alpha where ``how`` is
    transparent.

    ``how`` has ``exposure`` (in stops), ``tone_curve`` ("clip", "reinhard", "filmic"), ``white`` (the light that these
    curves make white) and ``transparent``; None: none of it. Exposure and curve apply to the volume's own colour, so
    the background keeps its colour. Light brighter than white is clipped. A pixel with NaN in any channel shows the
    background, and an infinite channel becomes 0 or the largest level. A transparent pixel without opacity is black.
    """
    behind = np.nan_to_num(np.asarray(background, dtype=np.float64).reshape(3), posinf=1.0)
    transparent = how is not None and how.transparent and may_be_transparent
    largest = float((1 << bits) - 1)
    shown = np.empty((*rgba.shape[:2], 4 if transparent else 3), np.uint8 if bits == 8 else np.uint16)
    for row in range(0, rgba.shape[0], _ROWS):
        rows = slice(row, row + _ROWS)
        pixels = rgba[rows].reshape(-1, 4)
        drawn = np.flatnonzero(_drawn(pixels))
        # Pixels without anything are all alike: the last one of ``part`` stands for them.
        part = np.zeros((len(drawn) + 1, 4))
        part[:-1] = pixels.take(drawn, axis=0)
        with np.errstate(invalid="ignore"):
            may_be_nan = np.isnan(part.sum())  # also where infinities cancel
        if may_be_nan:
            part[np.isnan(part).any(axis=-1)] = 0.0
        if how is not None:
            _map_tones(part, how)
        if transparent:
            _put(shown[rows], drawn, _straight(part, largest).T)
            continue
        see_through = np.clip(1.0 - part[:, 3], 0.0, 1.0)
        light = behind[:, None] * see_through  # a channel at a time: numpy is slow with short last axes
        for channel in range(3):
            light[channel] += part[:, channel]
        np.clip(light, 0.0, 1.0, out=light)
        levels = srgb_levels(light) if bits == 8 else np.floor(largest * linear_to_srgb(light) + 0.5)
        _put(shown[rows], drawn, levels)
    return shown


def _drawn(pixels: np.ndarray) -> np.ndarray:
    """bool [n]: which of ``pixels`` [n, 4] have a bit that is set."""
    words = np.ascontiguousarray(pixels, np.float32).view(np.uint64)
    return np.asarray((words[:, 0] | words[:, 1]) != 0)


def _put(shown: np.ndarray, drawn: np.ndarray, levels: np.ndarray) -> None:
    """Writes ``levels`` [channels, n + 1] to ``shown`` [rows, columns, channels]: the last to all pixels but those with
    the numbers ``drawn`` [n], which get the others in order."""
    flat = shown.reshape(-1, shown.shape[2])  # a view, since rows are contiguous
    for channel, level in enumerate(levels):
        plane = np.full(len(flat), level[-1], shown.dtype)
        plane[drawn] = level[:-1]
        flat[:, channel] = plane


def display(rgba: np.ndarray, background: Any) -> np.ndarray:
    """The image over ``background`` [3] (linear) without tone mapping, uint8 [height, width, 3]; see ``developed``."""
    return developed(rgba, background)


def straight(rgba: np.ndarray, bits: int = 8) -> np.ndarray:
    """As ``developed`` with transparency and no tone mapping: uint8 or uint16 [height, width, 4]."""
    largest = (1 << bits) - 1
    return _straight(np.asarray(rgba, np.float64), float(largest)).astype(np.uint8 if bits == 8 else np.uint16)


def _straight(part: np.ndarray, largest: float) -> np.ndarray:
    """Encoded levels with straight alpha, of premultiplied light; black where the level of alpha is 0."""
    alpha = np.clip(part[..., 3:], 0.0, 1.0)
    color = np.divide(part[..., :3], alpha, out=np.zeros_like(part[..., :3]), where=alpha > 0.0)
    levels = np.concatenate([linear_to_srgb(np.clip(color, 0.0, 1.0)), alpha], axis=-1)
    levels = np.floor(largest * levels + 0.5)
    levels[levels[..., 3] == 0.0] = 0.0
    return levels


def _map_tones(part: np.ndarray, how: Any) -> None:
    """Exposure and tone curve of premultiplied light [..., 4], in place.

    The curve is applied to colour that is divided by its opacity, since a pixel that is half covered by a bright
    colour is that colour, half covered.
    """
    if how.exposure:
        with np.errstate(over="ignore"):
            part[..., :3] *= 2.0**how.exposure
    curve = _CURVES.get(how.tone_curve)
    if curve is None:
        return
    finite = np.nan_to_num(part[..., :3], posinf=1e30, neginf=0.0)
    alpha = np.clip(part[..., 3:], 0.0, 1.0)
    cover = np.where(alpha > 0.0, alpha, 1.0)
    part[..., :3] = curve(np.maximum(finite / cover, 0.0), float(how.white)) * cover


def _reinhard(color: np.ndarray, white: float) -> np.ndarray:
    """Reinhard, Stark, Shirley and Ferwerda, "Photographic tone reproduction for digital images", SIGGRAPH 2002,
    equation 4, of the luminance; the ratios of the channels stay."""
    light = (color @ _LUMINANCE)[..., None]
    light = np.minimum(light, 1e30)
    return color * ((1.0 + light / (white * white)) / (1.0 + light))


def _filmic(color: np.ndarray, white: float) -> np.ndarray:
    """The curve of Hable, "Uncharted 2: HDR lighting", Game Developers Conference 2010, of each channel; scaled so that
    ``white`` becomes 1 and middle grey (0.18) stays."""

    def curve(x: np.ndarray | float) -> Any:
        a, b, c, d, e, f = 0.15, 0.50, 0.10, 0.20, 0.02, 0.30
        return (x * (a * x + c * b) + d * e) / (x * (a * x + b) + d * f) - e / f

    color = np.minimum(color, 1e6)
    # The gain before the curve that keeps middle grey, found by bisection: the curve is monotonous in it.
    low, high = 1e-3, 1e3
    for _ in range(60):
        gain = (low * high) ** 0.5
        low, high = (gain, high) if curve(0.18 * gain) / curve(white * gain) < 0.18 else (low, gain)
    return np.asarray(curve(color * gain) / curve(white * gain))


_CURVES: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {"reinhard": _reinhard, "filmic": _filmic}
TONE_CURVES = ("clip", *_CURVES)
