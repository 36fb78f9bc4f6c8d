"""Measures the difference between two pictures, in linear light and as displayed.

Pictures are float arrays [height, width, 4], linear light, premultiplied. "As displayed" means over a background,
clipped to 0...1 and sRGB-encoded, but not rounded to 8 bits, so that differences too small for a screen still count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from clvol.errors import UsageError
from clvol.transfer.color import linear_to_srgb

BLACK = (0.0, 0.0, 0.0)
_WINDOW = 11  # pixels, the width of SSIM's Gaussian window of sigma 1.5 (Wang et al. 2004)
_ROWS = 128  # rows that are processed together


def rmse(a: ArrayLike, b: ArrayLike) -> float:
    """Root mean square of the difference over all pixels and channels, in linear light."""
    a, b = _pair(a, b)
    total = sum(float(np.sum(np.square(x - y))) for x, y in _parts(a, b))
    return math.sqrt(total / a.size)


def max_abs(a: ArrayLike, b: ArrayLike) -> float:
    """Largest absolute difference over all pixels and channels, in linear light; NaN if any is NaN."""
    a, b = _pair(a, b)
    return float(np.max([np.abs(x - y).max() for x, y in _parts(a, b)]))


def psnr(a: ArrayLike, b: ArrayLike, background: ArrayLike = BLACK) -> float:
    """Peak signal-to-noise ratio of the displayed pictures in dB (white = 1); inf if they are equal."""
    a, b = _pair(a, b)
    shown = (_displayed(x, y, background) for x, y in _parts(a, b))
    total = sum(float(np.sum(np.square(x - y))) for x, y in shown)
    return math.inf if total == 0.0 else -10.0 * math.log10(total / (a.size // a.shape[2] * 3))


def ssim(a: ArrayLike, b: ArrayLike, background: ArrayLike = BLACK) -> float:
    """Mean structural similarity of the displayed pictures, at most 1 (Wang et al. 2004).

    The window is a Gaussian of 11 x 11 pixels. Smaller pictures are extended by repeating their edges.
    """
    from skimage.metrics import structural_similarity

    a, b = _pair(a, b)
    wider = [(0, max(0, _WINDOW - n)) for n in a.shape[:2]] + [(0, 0)]
    if any(after for _, after in wider):
        a, b = np.pad(a, wider, mode="edge"), np.pad(b, wider, mode="edge")
    height, width, margin = *a.shape[:2], _WINDOW // 2
    total = 0.0
    for row in range(margin, height - margin, _ROWS):  # only pixels whose window lies inside the picture
        part = slice(row - margin, min(row + _ROWS, height - margin) + margin)
        _, similar = structural_similarity(
            *_displayed(a[part].astype(float), b[part].astype(float), background),
            data_range=1.0, channel_axis=-1, full=True,
            gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        )  # fmt: skip
        total += float(similar[margin:-margin, margin:-margin].sum())
    return total / (3 * (height - 2 * margin) * (width - 2 * margin))


def delta_e(a: ArrayLike, b: ArrayLike, background: ArrayLike = BLACK) -> np.ndarray:
    """CIEDE2000 colour difference of the displayed pictures (D65 white point), float64 [height, width]."""
    from skimage.color import deltaE_ciede2000, rgb2lab

    a, b = _pair(a, b)
    return np.concatenate(
        [
            deltaE_ciede2000(*map(rgb2lab, _displayed(x, y, background)))
            for x, y in _parts(a, b)
        ]
    )


def compare(a: ArrayLike, b: ArrayLike, background: ArrayLike = BLACK) -> dict[str, float]:
    """All measures of ``a`` against ``b``: "rmse" and "max_abs" of linear premultiplied RGBA;
    "psnr" (dB), "ssim", "delta_e_mean" and "delta_e_max" (CIEDE2000) of the displayed pictures.

    ``a`` and ``b`` are [height, width, 4], linear, premultiplied; ``background`` [3] is linear.
    Raises UsageError unless both have this shape and the same size.
    """
    difference = delta_e(a, b, background)
    return {
        "rmse": rmse(a, b),
        "max_abs": max_abs(a, b),
        "psnr": psnr(a, b, background),
        "ssim": ssim(a, b, background),
        "delta_e_mean": float(difference.mean()),
        "delta_e_max": float(difference.max()),
    }


def as_pair(a: ArrayLike, b: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Both pictures as float64. Raises UsageError unless they are [height, width, 4] and of the same size."""
    a, b = _pair(a, b)
    return a.astype(np.float64, copy=False), b.astype(np.float64, copy=False)


def _parts(a: np.ndarray, b: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields some rows of both at a time as float64, so that large pictures are never converted as a whole."""
    for row in range(0, a.shape[0], _ROWS):
        part = slice(row, row + _ROWS)
        yield a[part].astype(np.float64), b[part].astype(np.float64)


def _pair(a: ArrayLike, b: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    a, b = np.asarray(a), np.asarray(b)
    for name, array in (("first picture", a), ("second picture", b)):
        if array.ndim != 3 or array.shape[2] != 4 or array.size == 0:
            raise UsageError(name, f"an array of shape {array.shape}", "[height, width, 4]")
    if a.shape != b.shape:
        (height, width), (other_height, other_width) = a.shape[:2], b.shape[:2]
        raise UsageError(
            "second picture",
            f"got {other_width} x {other_height} pixels",
            f"{width} x {height} pixels, as the first",
        )
    return a, b


def _displayed(
    a: np.ndarray, b: np.ndarray, background: ArrayLike
) -> tuple[np.ndarray, np.ndarray]:
    """Both as sRGB-encoded float64 [height, width, 3] in 0...1. Pixels that are not finite show the background."""
    behind = np.asarray(background, dtype=np.float64).reshape(3)

    def show(rgba: np.ndarray) -> np.ndarray:
        rgba = np.where(np.isfinite(rgba).all(axis=-1, keepdims=True), rgba, 0.0)
        light = rgba[..., :3] + (1.0 - rgba[..., 3:]) * behind
        return linear_to_srgb(np.clip(light, 0.0, 1.0))

    return show(a), show(b)
