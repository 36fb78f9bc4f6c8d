"""PNG: the image over its background, as displayed: 8 bits, sRGB-encoded, no alpha, no dithering.

The pixels are encoded by the exact piecewise curve of IEC 61966-2-1 and rounded to nearest.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError
from clvol.image.about import MADE_FROM, facts
from clvol.image.limits import RGBA_BYTES, check_picture
from clvol.transfer.color import linear_to_srgb, srgb_to_linear

_ROWS = 256  # rows encoded at a time, so that double precision needs little memory
_LARGEST_TEXT = 1 << 20
_DEPTH_AT = 24  # byte of the file: bits a channel
_KEYWORDS = {"scene": "Scene"}  # of the texts that have another name in a PNG


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
    from PIL import Image

    background = getattr(frame, "background", None)
    shown = display(rgba, (0.0, 0.0, 0.0) if background is None else background)
    with open(path, "wb") as file:
        Image.fromarray(shown).save(file, format="PNG", pnginfo=text_chunks(frame, [shown]))


def text_chunks(frame: Any, shown: Iterable[np.ndarray]) -> Any:
    """What a PNG says about itself, for Pillow; ``shown`` are the pixels that it holds."""
    from PIL import PngImagePlugin

    chunks = PngImagePlugin.PngInfo()
    chunks.add(b"sRGB", b"\0")  # rendering intent: perceptual
    texts = facts(frame, shown)
    chunks.add_text("Software", texts["software"])
    for name in ("background", MADE_FROM, "scene"):
        # Readers refuse larger ones, Pillow the whole picture with them.
        if name in texts and len(texts[name].encode()) < _LARGEST_TEXT:
            chunks.add_itxt(_KEYWORDS.get(name, name), texts[name], zip=True)
    return chunks


def held(rgba: np.ndarray, depth: np.ndarray | None) -> list[np.ndarray]:
    """What the file holds of a picture that was read from it."""
    return [display(rgba, (0.0, 0.0, 0.0))]


def read(path: str, memory_cap: int | None = None) -> tuple[np.ndarray, None, dict[str, Any]]:
    """Decoded from sRGB to linear light and premultiplied (an alpha in a PNG is not associated);
    no depth; the texts of the file, ``has_alpha``, and of how many ``bits`` a channel is."""
    from PIL import PngImagePlugin

    # Not Image.open: its own limit is a number of pixels, whatever they take.
    with open(path, "rb") as file, PngImagePlugin.PngImageFile(file) as image:
        width, height = image.size
        # As Pillow holds them (twice, where they are converted), and as they are worked with.
        check_picture(path, width, height, width * height * (8 + RGBA_BYTES), memory_cap)
        image.load()
        header = {k: v for k, v in image.info.items() if isinstance(v, (str, int, float))}
        is_grey16 = image.mode.startswith("I")
        header["bits"] = 16 if is_grey16 else 8
        file.seek(_DEPTH_AT)
        if file.read(1) == b"\x10" and not is_grey16:  # Pillow takes such colour as 8 bits
            header["unread_bits"] = 8
        if "icc_profile" in image.info or {"gamma", "srgb"} & set(image.info) == {"gamma"}:
            header["unread_profile"] = True
        header["has_alpha"] = "A" in image.mode or "transparency" in image.info
        header |= {name: header[key] for name, key in _KEYWORDS.items() if key in header}
        pixels = np.asarray(image if is_grey16 else image.convert("RGBA"))
    if pixels.size == 0:
        raise UsageError(path, "the picture has no pixels", "at least one")
    rgba = np.ones((height, width, 4), dtype=np.float32)
    for row in range(0, height, _ROWS):
        part = slice(row, row + _ROWS)
        rgba[part] = _linear_grey(pixels[part]) if is_grey16 else _linear(pixels[part])
    return rgba, None, header


def _linear(pixels: np.ndarray) -> np.ndarray:
    """uint8 [..., 4], sRGB-encoded, as linear and premultiplied."""
    levels = srgb_to_linear(np.arange(256) / 255.0)
    alpha = pixels[..., 3:] / 255.0
    return np.concatenate([levels[pixels[..., :3]] * alpha, alpha], axis=-1)


def _linear_grey(pixels: np.ndarray) -> np.ndarray:
    grey = srgb_to_linear(pixels.astype(np.float64) / 65535.0)
    return np.stack([grey, grey, grey, np.ones_like(grey)], axis=-1)
