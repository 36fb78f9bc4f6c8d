"""PNG files hold the image as displayed, over its background: 8 bits, sRGB-encoded, without alpha or dithering.

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

_ROWS = 256  # rows that are encoded together, so that double precision takes little memory
_LARGEST_TEXT = 1 << 20
_DEPTH_AT = 24  # offset of the byte that holds the number of bits per channel
_KEYWORDS = {"scene": "Scene"}  # texts that have another name in a PNG


def display(rgba: np.ndarray, background: Any) -> np.ndarray:
    """The image over ``background`` [3] (linear) as a viewer shows it, uint8 [height, width, 3].

    ``rgba`` is [height, width, 4], linear, premultiplied. Light brighter than white is clipped. A pixel with NaN in
    any channel shows the background, and an infinite channel becomes 0 or 255.
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
    """Writes the frame to ``path``. Raises OSError when that fails."""
    from PIL import Image

    background = getattr(frame, "background", None)
    shown = display(rgba, (0.0, 0.0, 0.0) if background is None else background)
    with open(path, "wb") as file:
        Image.fromarray(shown).save(file, format="PNG", pnginfo=text_chunks(frame, [shown]))


def text_chunks(frame: Any, shown: Iterable[np.ndarray]) -> Any:
    """The metadata of a PNG, for Pillow. ``shown`` are the pixels that the file holds."""
    from PIL import PngImagePlugin

    chunks = PngImagePlugin.PngInfo()
    chunks.add(b"sRGB", b"\0")  # rendering intent: perceptual
    texts = facts(frame, shown)
    chunks.add_text("Software", texts["software"])
    for name in ("background", MADE_FROM, "scene"):
        # Readers ignore larger texts, and Pillow then refuses the whole picture.
        if name in texts and len(texts[name].encode()) < _LARGEST_TEXT:
            chunks.add_itxt(_KEYWORDS.get(name, name), texts[name], zip=True)
    return chunks


def held(rgba: np.ndarray, depth: np.ndarray | None) -> list[np.ndarray]:
    """The arrays that the file stores of a picture that was read from it."""
    return [display(rgba, (0.0, 0.0, 0.0))]


def read(path: str, memory_cap: int | None = None) -> tuple[np.ndarray, None, dict[str, Any]]:
    """The picture decoded from sRGB to linear light and premultiplied (PNG stores straight alpha), no depth, and the
    texts of the file, to which ``has_alpha`` and ``bits`` (per channel) are added."""
    from PIL import PngImagePlugin

    # Image.open would apply a limit on the number of pixels, regardless of their size.
    with open(path, "rb") as file, PngImagePlugin.PngImageFile(file) as image:
        width, height = image.size
        # Pillow's pixels (twice, if they are converted), and the float32 RGBA made of them.
        check_picture(path, width, height, width * height * (8 + RGBA_BYTES), memory_cap)
        image.load()
        header = {k: v for k, v in image.info.items() if isinstance(v, (str, int, float))}
        is_grey16 = image.mode.startswith("I")
        header["bits"] = 16 if is_grey16 else 8
        file.seek(_DEPTH_AT)
        if file.read(1) == b"\x10" and not is_grey16:  # Pillow reads 16-bit colour as 8 bits
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
    """``pixels`` (uint8 [..., 4], sRGB-encoded, straight alpha) as linear, premultiplied light."""
    levels = srgb_to_linear(np.arange(256) / 255.0)
    alpha = pixels[..., 3:] / 255.0
    return np.concatenate([levels[pixels[..., :3]] * alpha, alpha], axis=-1)


def _linear_grey(pixels: np.ndarray) -> np.ndarray:
    grey = srgb_to_linear(pixels.astype(np.float64) / 65535.0)
    return np.stack([grey, grey, grey, np.ones_like(grey)], axis=-1)
