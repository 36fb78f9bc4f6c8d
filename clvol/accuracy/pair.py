"""Makes two pictures of different formats comparable: what one of them lacks is left out of both, and reported.

EXR and NPY store light without the background, and opacity. PNG stores the picture over its background without
opacity, clipped to 0...1 and rounded to 8 bits of sRGB.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clvol.accuracy.metrics import BLACK, compare
from clvol.transfer.color import linear_to_srgb, srgb_to_linear

_ROWS = 256  # rows that are processed together


@dataclass
class Pair:
    """``first`` and ``second``: float32 [height, width, 4], linear, premultiplied, to be compared.

    ``colors_only``: both are opaque, and only R, G, B over ``background`` ([3], linear) are compared. ``left_out``:
    one sentence for each part of the pictures that is not compared, with the reason. ``rounding``: if only one of
    the pictures is rounded, its "bits" per channel, and the "rmse" and "max_abs" in linear light that this rounding
    alone would cause in the other.
    """

    first: np.ndarray
    second: np.ndarray
    colors_only: bool = False
    background: np.ndarray | None = None
    left_out: list[str] = field(default_factory=list)
    rounding: dict[str, Any] | None = None

    def measures(self) -> dict[str, Any]:
        """The measures of ``clvol.accuracy.metrics.compare``, and what they refer to under "compared", "background",
        "left_out" and "rounding"."""
        measured: dict[str, Any] = compare(self.first, self.second)
        if self.colors_only:
            measured["rmse"] *= math.sqrt(4 / 3)  # the mean is over three channels, because the fourth is equal
        return measured | {
            "compared": "R, G, B over the background" if self.colors_only else "R, G, B, A",
            "background": None if self.background is None else self.background.tolist(),
            "left_out": self.left_out,
            "rounding": self.rounding,
        }


def comparable(
    a: Mapping[str, Any], b: Mapping[str, Any], names: tuple[str, str] = ("A", "B")
) -> Pair:
    """The pair of ``a`` and ``b``, two results of ``clvol.image.load_image`` with pictures of the same size."""
    pictures = [a, b]
    pair = Pair(a["rgba"], b["rgba"])
    for picture, name in zip(pictures, names):
        _report_unread(pair, picture, name)
    rounded = [picture["header"].get("bits") for picture in pictures]
    if a["has_alpha"] != b["has_alpha"]:
        layered = 0 if a["has_alpha"] else 1
        background, whose = _background(pictures[1 - layered], pictures[layered])
        _leave_alpha_out(pair, layered, background, whose, names)
        if rounded[1 - layered]:
            _show(pair, layered, names)
    if (rounded[0] is None) != (rounded[1] is None):
        _report_rounding(pair, 0 if rounded[0] is None else 1, max(filter(None, rounded)))
    return pair


def _report_unread(pair: Pair, picture: Mapping[str, Any], name: str) -> None:
    if picture["depth"] is not None:
        pair.left_out.append(f"the depth of {name}: colours and opacity are compared")
    header = picture["header"]
    if header.get("unread_bits"):
        what = f"the lower {header['unread_bits']} bits of each channel of {name}"
        pair.left_out.append(f"{what}: 16-bit colour is read as 8 bits")
    if header.get("unread_profile"):
        pair.left_out.append(f"the colour profile of {name}: it is taken for sRGB")


def _background(flat: Mapping, layered: Mapping) -> tuple[np.ndarray, str]:
    """The background of the flat picture, and which of the two files states it."""
    own, other = flat["background"], layered["background"]
    if own is not None:
        return own, "flat" if other is None or np.allclose(own, other, atol=1e-6) else "both"
    if other is not None:
        return other, "layered"
    return np.array(BLACK), "nobody"


def _leave_alpha_out(
    pair: Pair, layered: int, background: np.ndarray, whose: str, names: tuple[str, str]
) -> None:
    with_alpha, flat = names[layered], names[1 - layered]
    source = {
        "flat": f"as {flat} states it",
        "layered": f"as {with_alpha} states it",
        "both": f"as {flat} states it; {with_alpha} states another",
        "nobody": "taken as black, since neither file states it",
    }[whose]
    pair.left_out.append(
        f"the opacity: {flat} has none; {with_alpha} is compared over the background, {source}"
    )
    pair.colors_only, pair.background = True, background
    over = np.array(pair.first if layered == 0 else pair.second)
    for row in range(0, over.shape[0], _ROWS):
        part = over[row : row + _ROWS]
        part[..., :3] += (1.0 - part[..., 3:].astype(np.float64)) * background
        part[..., 3] = 1.0
    _set(pair, layered, over)
    opaque = np.array(pair.second if layered == 0 else pair.first)
    opaque[..., 3] = 1.0
    _set(pair, 1 - layered, opaque)


def _show(pair: Pair, which: int, names: tuple[str, str]) -> None:
    """Changes a picture to what a file for displays can hold: the background for NaN, and light clipped to 0...1."""
    rgba = pair.first if which == 0 else pair.second
    unknown = np.isnan(rgba).any(axis=-1)
    if unknown.any():
        rgba[unknown, :3] = pair.background
        pair.left_out.append(
            f"{int(unknown.sum())} pixels of {names[which]} that are not a number: the other picture "
            "shows the background there"
        )
    beyond = ((rgba[..., :3] > 1.0) | (rgba[..., :3] < 0.0)).any(axis=-1)
    if beyond.any():
        np.clip(rgba[..., :3], 0.0, 1.0, out=rgba[..., :3])
        pair.left_out.append(
            f"light beyond 0 to 1 in {int(beyond.sum())} pixels of {names[which]}: the other picture "
            "is clipped"
        )


def _report_rounding(pair: Pair, exact: int, bits: int) -> None:
    pair.rounding = {"bits": bits}
    if not pair.colors_only:
        return
    rgba, steps = (pair.first if exact == 0 else pair.second), 2**bits - 1
    total, largest = 0.0, 0.0
    for row in range(0, rgba.shape[0], _ROWS):
        light = np.clip(rgba[row : row + _ROWS, :, :3].astype(np.float64), 0.0, 1.0)
        rounded = srgb_to_linear(np.floor(steps * linear_to_srgb(light) + 0.5) / steps)
        error = np.abs(rounded - light)
        total, largest = total + float(np.square(error).sum()), max(largest, float(error.max()))
    pair.rounding |= {"rmse": math.sqrt(total / (rgba.size // 4 * 3)), "max_abs": largest}


def _set(pair: Pair, which: int, rgba: np.ndarray) -> None:
    if which == 0:
        pair.first = rgba
    else:
        pair.second = rgba
