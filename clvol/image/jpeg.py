"""JPEG files hold the image as displayed, over its background: quality 95, without chroma subsampling.

The comment holds the metadata as JSON, if they fit into its 64 KiB. The digest of the pixels is that of the decoded
file, since the compression is not exact.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError
from clvol.image.about import MADE_FROM, SCENE_FOLDER, facts, texts_of
from clvol.image.develop import display, shown_picture
from clvol.image.limits import RGBA_BYTES, check_picture
from clvol.image.png import linear

_QUALITY = 95
_LARGEST_COMMENT = 65533
_LARGEST_EDGE = 65535
_KEPT = ("software", "clvol_version", "background", SCENE_FOLDER, MADE_FROM, "scene")


def write(frame: Any, rgba: np.ndarray, path: Path) -> None:
    """Writes the frame to ``path``. Raises OSError when that fails, UsageError for a picture that is too large or
    transparent."""
    if max(rgba.shape[:2]) > _LARGEST_EDGE:
        size = f"{rgba.shape[1]} x {rgba.shape[0]} pixels"
        raise UsageError(str(path), size, f"at most {_LARGEST_EDGE} pixels per edge in a .jpg")
    how = getattr(frame, "display", None)
    if how is not None and how.transparent:
        raise UsageError(str(path), "a .jpg of a transparent picture", ".png or .tif, or display.transparent = false")
    shown = shown_picture(frame, rgba)
    comment = b""
    if getattr(frame, MADE_FROM, None) is not None or getattr(frame, "scene_source", None):
        plain = io.BytesIO(_encoded(shown, b""))
        texts = facts(frame, [_decoded(plain)], path)
        comment = _comment({name: texts[name] for name in _KEPT if name in texts})
    path.write_bytes(_encoded(shown, comment))


def _comment(texts: dict[str, str]) -> bytes:
    """The metadata as JSON; without the scene, or without any, where they are too long."""
    choices: tuple[set[str], ...] = (set(), {"scene"}, set(texts))
    for left_out in choices:
        text = json.dumps({name: text for name, text in texts.items() if name not in left_out}).encode()
        if len(text) <= _LARGEST_COMMENT:
            return text
    return b""


def _encoded(shown: np.ndarray, comment: bytes) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(shown).save(file, format="JPEG", quality=_QUALITY, subsampling=0, comment=comment)
    return file.getvalue()


def _decoded(file: io.BytesIO) -> np.ndarray:
    from PIL.JpegImagePlugin import JpegImageFile

    with JpegImageFile(file) as image:
        return np.asarray(image.convert("RGB"))


def held(rgba: np.ndarray, depth: np.ndarray | None) -> list[np.ndarray]:
    """The arrays that the file stores of a picture that was read from it."""
    return [display(rgba, (0.0, 0.0, 0.0))]


def texts(path: str) -> dict[str, Any]:
    """The metadata of the file; no pixel is read."""
    from PIL.JpegImagePlugin import JpegImageFile

    with open(path, "rb") as file, JpegImageFile(file) as image:
        return texts_of(image.info.get("comment", b""))


def read(path: str, memory_cap: int | None = None) -> tuple[np.ndarray, None, dict[str, Any]]:
    """The picture decoded from sRGB to linear light, no depth, and the metadata, to which ``has_alpha`` and ``bits``
    are added."""
    from PIL.JpegImagePlugin import JpegImageFile

    # Image.open would apply a limit on the number of pixels, regardless of their size.
    with open(path, "rb") as file, JpegImageFile(file) as image:
        width, height = image.size
        check_picture(path, width, height, width * height * (8 + RGBA_BYTES), memory_cap)
        header = texts_of(image.info.get("comment", b"")) | {"bits": 8, "has_alpha": False}
        if "icc_profile" in image.info:
            header["unread_profile"] = True
        pixels = np.asarray(image.convert("RGBA"))
    rgba = np.ones((height, width, 4), dtype=np.float32)
    for row in range(0, height, 256):
        rgba[row : row + 256] = linear(pixels[row : row + 256])
    return rgba, None, header
