"""PNG files hold the image as displayed: 8 bits, sRGB-encoded, over its background, or with straight alpha where the
scene's display is transparent (``clvol.image.develop``)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError
from clvol.image import png_chunks
from clvol.image.about import MADE_FROM, SCENE_FOLDER, facts
from clvol.image.develop import display, shown_picture, straight
from clvol.image.limits import RGBA_BYTES, check_picture
from clvol.transfer.color import srgb_to_linear

__all__ = ["display", "held", "linear", "opaque", "read", "texts", "write"]

_ROWS = 256  # rows that are decoded together, so that double precision takes little memory
_LARGEST_TEXT = 1 << 20
_DEPTH_AT = 24  # offset of the byte that holds the number of bits per channel
_KEYWORDS = {"scene": "Scene"}  # texts that have another name in a PNG


def write(frame: Any, rgba: np.ndarray, path: Path) -> None:
    """Writes the frame to ``path``. Raises OSError when that fails."""
    shown = shown_picture(frame, rgba)
    with open(path, "wb") as file:
        file.writelines(png_chunks.encoded(shown, _chunks(frame, opaque(shown), path)))


def opaque(shown: np.ndarray) -> list[np.ndarray]:
    """The arrays that a file's digest is of: without alpha where nothing is transparent, since a picture that was read
    does not say whether its file had such an alpha."""
    full = np.iinfo(shown.dtype).max
    return [shown[..., :3] if shown.shape[2] == 4 and (shown[..., 3] == full).all() else shown]


def _chunks(frame: Any, shown: Iterable[np.ndarray], path: Path) -> list[tuple[bytes, bytes]]:
    """The metadata of the file. ``shown`` are the pixels that it holds."""
    texts = facts(frame, shown, path)
    chunks = [(b"sRGB", b"\0"), png_chunks.text("Software", texts["software"])]  # rendering intent: perceptual
    for name in ("background", MADE_FROM, "scene", SCENE_FOLDER):
        # Readers ignore larger texts, and Pillow then refuses the whole picture.
        if name in texts and len(texts[name].encode()) < _LARGEST_TEXT:
            chunks.append(png_chunks.compressed_text(_KEYWORDS.get(name, name), texts[name]))
    return chunks


def held(rgba: np.ndarray, depth: np.ndarray | None) -> list[np.ndarray]:
    """The arrays that the file stores of a picture that was read from it."""
    return opaque(straight(rgba) if (rgba[..., 3] != 1.0).any() else display(rgba, (0.0, 0.0, 0.0)))


def texts(path: str) -> dict[str, Any]:
    """The texts that precede the pixels, which are not read."""
    from PIL import PngImagePlugin

    with open(path, "rb") as file, PngImagePlugin.PngImageFile(file) as image:
        header = {k: v for k, v in image.info.items() if isinstance(v, (str, int, float))}
    return header | {name: header[key] for name, key in _KEYWORDS.items() if key in header}


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
        rgba[part] = _linear_grey(pixels[part]) if is_grey16 else linear(pixels[part])
    return rgba, None, header


def linear(pixels: np.ndarray) -> np.ndarray:
    """``pixels`` (uint8 or uint16 [..., 4], sRGB-encoded, straight alpha) as linear, premultiplied light."""
    largest = np.iinfo(pixels.dtype).max
    levels = srgb_to_linear(np.arange(largest + 1) / largest)
    alpha = pixels[..., 3:] / largest
    return np.concatenate([levels[pixels[..., :3]] * alpha, alpha], axis=-1)


def _linear_grey(pixels: np.ndarray) -> np.ndarray:
    grey = srgb_to_linear(pixels.astype(np.float64) / 65535.0)
    return np.stack([grey, grey, grey, np.ones_like(grey)], axis=-1)
