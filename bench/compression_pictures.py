"""Strips of pictures: the original and what codecs make of it, and the differences below."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.compression_rates import psnr_text
from bench.compression_scenes import CODED_SCENES
from bench.gallery import save_small
from bench.multiresolution_pictures import sheet_of
from bench.pyramid_pictures import TIMES, difference

CURVES = ("vq", "vq-mean", "hvq", "rvq, rate", "zfp, accuracy", "sz3, bound")
_NAMES = {"rvq, rate": "rvq", "zfp, accuracy": "zfp", "sz3, bound": "SZ3"}
_TILE, _BYTES = 200, 480_000
_SHOWN = (0.305, 0.695)  # of the picture's edges: a tile of as many pixels, where the picture has 512


def codec_strip(name: str, rows: Sequence[dict[str, Any]], folder: Path, path: Path) -> Path:
    """``rows``: of one volume. Codecs with a free rate are shown at about that of the goal."""
    from clvol.image.png import display

    original = np.load(folder / f"{name}.npy", allow_pickle=False)
    black = (0.0, 0.0, 0.0)
    above = [(_cut(display(original, black)), f"{name}")]
    below = [(np.full_like(above[0][0], 255), f"differences times {TIMES}")]
    for row in chosen(rows, shown_rate(name)):
        picture = np.load(folder / row["picture"], allow_pickle=False)
        told = f"{_NAMES.get(row['curve'], row['curve'])}: {row['bits']:.2f} bits, {psnr_text(row)}"
        above.append((_cut(display(picture, black)), told))
        below.append((_cut(difference(original, picture)), f"CIEDE2000 {row['delta_e']:.2f}"))
    sheet, *_ = sheet_of([above, below], tile=_TILE)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_small(sheet, path, _BYTES)
    return path


def shown_rate(name: str) -> float:
    """Bits per voxel of the volume's goal, or else the lowest of "rvq"."""
    scene = next(scene for scene in CODED_SCENES if scene.name == name)
    return scene.rates[0] if scene.goal is None else scene.goal[0]


def chosen(rows: Sequence[dict[str, Any]], bits: float) -> list[dict[str, Any]]:
    """Of each curve there is, the row that comes nearest to so many bits per voxel."""
    found = []
    for curve in CURVES:
        there = [row for row in rows if row["curve"] == curve]
        if there:
            found.append(min(there, key=lambda row: abs(np.log(row["bits"] / bits))))
    return found


def _cut(picture: np.ndarray) -> np.ndarray:
    """The middle of ``picture``, so that its pixels can be seen."""
    height, width = picture.shape[:2]
    first, last = _SHOWN
    return np.ascontiguousarray(
        picture[int(first * height) : int(last * height), int(first * width) : int(last * width)]
    )
