"""PNG: the image over its background, as displayed: 8 bits, sRGB-encoded, no alpha, no dithering.

The pixels are encoded by the exact piecewise curve of IEC 61966-2-1 and rounded to nearest.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError
from clvol.image.about import facts
from clvol.transfer.color import linear_to_srgb, srgb_to_linear

_ROWS = 256  # rows encoded at a time, so that double precision needs little memory


def display(rgba: np.ndarray, background: Any) -> np.ndarray:
    """What a viewer shows: uint8 [height, width, 3], the image over ``background`` [3] (linear).

    ``rgba`` is [height, width, 4], linear, premultiplied. Light brighter than white is clipped. A
    pixel with a NaN in any channel shows the background, an infinite channel its end (0 or 255).
    """
    behind = np.nan_to_num(np.asarray(background, dtype=np.float64).reshape(3), posinf=1.0)
    shown = np.empty((*rgba.shape[:2], 3), dtype=np.uint8)
    for row in range(0, rgba.shape[0], _ROWS):
        part = np.array(rgba[row : row + _ROWS], dtype=np.float64)
        part[np.isnan(part).any(axis=-1)] = 0.0
        transparency = np.clip(1.0 - part[..., 3:], 0.0, 1.0)
        light = np.clip(part[..., :3] + transparency * behind, 0.0, 1.0)
        shown[row : row + _ROWS] = np.floor(255.0 * linear_to_srgb(light) + 0.5)
    return shown


def write(frame: Any, rgba: np.ndarray, path: Path) -> None:
    """Write the frame to ``path``; OSError when that fails."""
    from PIL import Image, PngImagePlugin

    background = getattr(frame, "background", None)
    shown = display(rgba, (0.0, 0.0, 0.0) if background is None else background)
    chunks = PngImagePlugin.PngInfo()
    chunks.add(b"sRGB", b"\0")  # rendering intent: perceptual
    texts = facts(frame)
    chunks.add_text("Software", texts["software"])
    if "scene" in texts:
        chunks.add_itxt("Scene", texts["scene"], zip=True)
    with open(path, "wb") as file:
        Image.fromarray(shown).save(file, format="PNG", pnginfo=chunks)


def read(path: str) -> tuple[np.ndarray, None, dict[str, Any]]:
    """Decoded from sRGB to linear light and premultiplied (an alpha in a PNG is not associated)."""
    from PIL import Image

    with Image.open(path, formats=["PNG"]) as image:
        image.load()
        header = {k: v for k, v in image.info.items() if isinstance(v, (str, int, float))}
        if image.mode.startswith("I"):  # 16-bit grey
            grey = srgb_to_linear(np.asarray(image, dtype=np.float64) / 65535.0)
            rgba = np.dstack([grey, grey, grey, np.ones_like(grey)])
        else:
            pixels = np.asarray(image.convert("RGBA"))
            levels = srgb_to_linear(np.arange(256) / 255.0)
            alpha = pixels[..., 3:] / 255.0
            rgba = np.concatenate([levels[pixels[..., :3]] * alpha, alpha], axis=-1)
    if rgba.size == 0:
        raise UsageError(path, "the picture has no pixels", "at least one")
    return rgba.astype(np.float32), None, header
