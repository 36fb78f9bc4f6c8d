"""TIFF files hold the image as displayed: 16 bits, sRGB-encoded, over its background, or with straight alpha where the
scene's display is transparent; compressed without loss. The image description holds the metadata as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError
from clvol.image.about import facts, texts_of
from clvol.image.develop import developed, shown_picture, straight
from clvol.image.limits import RGBA_BYTES, check_picture
from clvol.image.png import linear, opaque

_BITS = 16
_COLORS = {"MINISBLACK": 1, "RGB": 3}


def write(frame: Any, rgba: np.ndarray, path: Path) -> None:
    """Writes the frame to ``path``. Raises OSError when that fails."""
    import tifffile

    shown = shown_picture(frame, rgba, _BITS)
    texts = facts(frame, opaque(shown), path)
    tifffile.imwrite(
        path, shown, photometric="rgb", extrasamples=["unassalpha"] if shown.shape[2] == 4 else None,
        compression="zlib", predictor=True, metadata=None, software=texts["software"], description=json.dumps(texts),
    )  # fmt: skip


def held(rgba: np.ndarray, depth: np.ndarray | None) -> list[np.ndarray]:
    """The arrays that the file stores of a picture that was read from it."""
    if (rgba[..., 3] != 1.0).any():
        return opaque(straight(rgba, _BITS))
    return [developed(rgba, (0.0, 0.0, 0.0), bits=_BITS)]


def read(path: str, memory_cap: int | None = None) -> tuple[np.ndarray, None, dict[str, Any]]:
    """The first page, decoded from sRGB to linear light and premultiplied, no depth, and the metadata, to which
    ``has_alpha`` and ``bits`` are added."""
    import tifffile

    with tifffile.TiffFile(path) as file:
        page = file.pages.first
        colors = _COLORS.get(getattr(page.photometric, "name", ""))
        channels = page.samplesperpixel
        right = colors is not None and channels in (colors, colors + 1) and page.dtype in (np.uint8, np.uint16)
        if not right or page.planarconfig != 1 or page.imagedepth != 1:
            kind = f"{page.dtype} {page.shape}, {getattr(page.photometric, 'name', 'unknown')}"
            raise UsageError(path, f"the pixels are {kind}", "grey or RGB with 8 or 16 bits")
        height, width = page.imagelength, page.imagewidth
        itemsize = np.dtype(page.dtype).itemsize
        check_picture(path, width, height, width * height * (2 * channels * itemsize + RGBA_BYTES), memory_cap)
        associated = 1 in page.extrasamples  # premultiplied by its encoded alpha, by other tools
        header = texts_of(page.description) | {"bits": 8 * itemsize, "has_alpha": channels > (colors or 0)}
        if 34675 in page.tags:
            header["unread_profile"] = True
        pixels = page.asarray().reshape(height, width, channels)
    rgba = np.ones((height, width, 4), dtype=np.float32)
    for row in range(0, height, 256):
        rgba[row : row + 256] = _linear(pixels[row : row + 256], associated)
    return rgba, None, header


def _linear(part: np.ndarray, associated: bool) -> np.ndarray:
    largest = np.iinfo(part.dtype).max
    whole = np.full((*part.shape[:2], 4), largest, part.dtype)
    whole[..., :3] = part[..., :3] if part.shape[2] >= 3 else part[..., :1]
    if part.shape[2] in (2, 4):
        alpha = whole[..., 3] = part[..., -1]
        if associated:
            color = whole[..., :3] * (largest / np.maximum(alpha, 1.0))[..., None]
            whole[..., :3] = np.minimum(np.rint(color), largest)
    return linear(whole)
