"""Two pictures of different kinds made comparable: what one of them does not hold is left out of
both, and said.

EXR and NPY hold light without the background, and opacity; PNG holds the picture over its background
and no opacity, clipped to 0...1 and rounded to 8 bits of sRGB.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clvol.accuracy.metrics import BLACK, compare
from clvol.transfer.color import linear_to_srgb, srgb_to_linear

_ROWS = 256  # rows worked with at a time


@dataclass
class Pair:
    """``first`` and ``second``: float32 [height, width, 4], linear, premultiplied, to be compared.

    ``colors_only``: both are opaque, and what counts are R, G, B over ``background`` ([3], linear).
    ``left_out``: what of the pictures is not compared and why, a sentence each. ``rounding``: where
    only one is rounded to ``bits``, and what rounding alone would make of the other: "rmse" and
    "max_abs", linear light.
    """

    first: np.ndarray
    second: np.ndarray
    colors_only: bool = False
    background: np.ndarray | None = None
    left_out: list[str] = field(default_factory=list)
    rounding: dict[str, Any] | None = None

    def measures(self) -> dict[str, Any]:
        """``clvol.accuracy.metrics.compare``'s, and under "compared", "background", "left_out" and
        "rounding" of what."""
        measured: dict[str, Any] = compare(self.first, self.second)
        if self.colors_only:
            measured["rmse"] *= math.sqrt(4 / 3)  # over three channels: the fourth does not differ
        return measured | {
            "compared": "R, G, B over the background" if self.colors_only else "R, G, B, A",
            "background": None if self.background is None else self.background.tolist(),
            "left_out": self.left_out,
            "rounding": self.rounding,
        }


def comparable(
    a: Mapping[str, Any], b: Mapping[str, Any], names: tuple[str, str] = ("A", "B")
) -> Pair:
    """``a`` and ``b`` as ``clvol.image.load_image`` gives them, of one size."""
    pictures = [a, b]
    pair = Pair(a["rgba"], b["rgba"])
    for picture, name in zip(pictures, names):
        _say_what_is_unread(pair, picture, name)
    rounded = [picture["header"].get("bits") for picture in pictures]
    if a["has_alpha"] != b["has_alpha"]:
        layered = 0 if a["has_alpha"] else 1
        background, whose = _background(pictures[1 - layered], pictures[layered])
        _leave_alpha_out(pair, layered, background, whose, names)
        if rounded[1 - layered]:
            _show(pair, layered, names)
    if (rounded[0] is None) != (rounded[1] is None):
        _tell_rounding(pair, 0 if rounded[0] is None else 1, max(filter(None, rounded)))
    return pair


def _say_what_is_unread(pair: Pair, picture: Mapping[str, Any], name: str) -> None:
    if picture["depth"] is not None:
        pair.left_out.append(f"the depth of {name}: colours and opacity are compared")
    header = picture["header"]
    if header.get("unread_bits"):
        what = f"the lower {header['unread_bits']} bits of each channel of {name}"
        pair.left_out.append(f"{what}: 16-bit colour is read as 8 bits")
    if header.get("unread_profile"):
        pair.left_out.append(f"the colour profile of {name}: it is taken for sRGB")


def _background(flat: Mapping, layered: Mapping) -> tuple[np.ndarray, str]:
    """What the flat picture is over, and who says so."""
    told, other = flat["background"], layered["background"]
    if told is not None:
        return told, "flat" if other is None or np.allclose(told, other, atol=1e-6) else "both"
    if other is not None:
        return other, "layered"
    return np.array(BLACK), "nobody"


def _leave_alpha_out(
    pair: Pair, layered: int, background: np.ndarray, whose: str, names: tuple[str, str]
) -> None:
    with_alpha, flat = names[layered], names[1 - layered]
    said = {
        "flat": f"the one that {flat} tells",
        "layered": f"the one that {with_alpha} tells",
        "both": f"the one that {flat} tells, {with_alpha} tells another",
        "nobody": "black, since neither tells one",
    }[whose]
    pair.left_out.append(
        f"the opacity: {flat} has none; {with_alpha} is compared over the background, {said}"
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
    """As a picture for screens shows it: not a number as the background, and nothing beyond white."""
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


def _tell_rounding(pair: Pair, exact: int, bits: int) -> None:
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
