"""OpenEXR: R, G, B, A (premultiplied, linear) and Z (depth), 32-bit float, ZIP-compressed.

Z is the distance along the pixel's ray, in world units, at which the accumulated opacity reaches one half, and +inf
where it never does. The header contains ``scene`` (the scene's text), ``scene_folder`` (relative to the picture's
folder), ``made_from``, ``overlay`` and ``stats`` (JSON), ``background`` (JSON, linear), ``device``, ``software`` and
the versions of clvol, pyopencl and numpy.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError
from clvol.image.about import facts
from clvol.image.limits import RGBA_BYTES, check_picture


def write(frame: Any, rgba: np.ndarray, path: Path) -> None:
    """Writes the frame to ``path``. Raises OSError when that fails."""
    import OpenEXR

    channels = {"RGBA": np.ascontiguousarray(rgba, dtype=np.float32)}
    depth = getattr(frame, "depth", None)
    if depth is not None:
        depth = np.ascontiguousarray(depth, dtype=np.float32)
        if depth.shape != rgba.shape[:2]:
            raise UsageError("frame.depth", f"its shape is {depth.shape}", f"{rgba.shape[:2]}")
        channels["Z"] = depth
    texts = facts(frame, held(rgba, depth), path)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **texts}
    try:
        # The path is passed as bytes, because a name need not be UTF-8.
        OpenEXR.File(header, channels).write(os.fsencode(path))
    except (RuntimeError, ValueError) as error:
        # The library's message names the temporary file, of which the user does not know.
        why = str(error).replace(f' to image file "{path}"', "").strip().rstrip(".")
        raise OSError(why) from error


def held(rgba: np.ndarray, depth: np.ndarray | None) -> list[np.ndarray]:
    """The arrays of a picture that the file stores."""
    return [rgba] if depth is None else [rgba, depth]


def channels(path: str, memory_cap: int | None = None) -> dict[str, np.ndarray]:
    """The channels of the file's first part by name, as they are stored. Raises UsageError if they take more than
    ``memory_cap`` bytes (``clvol.image.limits``)."""
    return _read(path, memory_cap)[0]


def check_size(path: str, memory_cap: int | None) -> None:
    """Raises UsageError if reading the file takes more bytes than the cap. Only the header is read."""
    with _opened(path, header_only=True) as file:
        nbytes, width, height = 0, 0, 0
        for index in range(len(file.parts)):
            header = file.header(index)
            if "deep" in str(header.get("type", "")):
                raise UsageError(path, "has deep pixels, with several samples each", "one sample per pixel")
            low, high = (np.asarray(corner, dtype=np.int64) for corner in header["dataWindow"])
            width, height = (int(n) for n in high - low + 1)
            samples = sum(1 / (c.xSampling * c.ySampling) for c in header["channels"])
            nbytes += math.ceil(width * height * (4 * samples + RGBA_BYTES))
            tile = header.get("tiles")
            if tile is not None:
                nbytes += math.ceil(int(tile.xSize) * int(tile.ySize) * 4 * samples)
            check_picture(path, width, height, nbytes, memory_cap)


def _read(path: str, memory_cap: int | None) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The channels, and the strings and numbers of the header."""
    check_size(path, memory_cap)
    with _opened(path, separate_channels=True) as file:
        pixels = {name: np.asarray(channel.pixels) for name, channel in file.channels().items()}
        header = {k: v for k, v in file.header().items() if isinstance(v, (str, int, float))}
    return pixels, header


@contextmanager
def _opened(path: str, **options: bool) -> Iterator[Any]:
    import OpenEXR

    with OpenEXR.File(os.fsencode(path), **options) as file:
        yield file


def texts(path: str) -> dict[str, Any]:
    """The strings and numbers of the header; no pixel is read."""
    with _opened(path, header_only=True) as file:
        return {k: v for k, v in file.header().items() if isinstance(v, (str, int, float))}


def read(
    path: str, memory_cap: int | None = None
) -> tuple[np.ndarray, np.ndarray | None, dict[str, Any]]:
    """``rgba`` (opaque if the file has no A), Z or None, and the strings and numbers of the header, to which
    ``has_alpha`` is added."""
    pixels, header = _read(path, memory_cap)
    missing = [name for name in "RGB" if name not in pixels]
    if missing:
        there = ", ".join(sorted(pixels)) or "none"
        raise UsageError(path, f"the channels are {there}", "R, G, B, A")
    rgba = np.ones((*pixels["R"].shape, 4), dtype=np.float32)
    for k, name in enumerate("RGBA"):
        if name in pixels:
            rgba[..., k] = pixels[name]
    depth = pixels["Z"].astype(np.float32) if "Z" in pixels else None
    if "stats" in header:
        try:
            header["stats"] = json.loads(header["stats"])
        except (ValueError, RecursionError):
            pass
    return rgba, depth, header | {"has_alpha": "A" in pixels}
