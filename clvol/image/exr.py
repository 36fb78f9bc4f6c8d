"""OpenEXR: R, G, B, A (premultiplied, linear) and Z (depth), 32-bit float, ZIP-compressed.

Z is the distance along the pixel's ray, in world units, at which the accumulated opacity reaches
one half, and +inf where it never does. The header carries ``scene`` (the scene's text), ``stats``
(JSON), ``device``, ``software`` and the versions of clvol, pyopencl and numpy.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError
from clvol.image.about import facts


def write(frame: Any, rgba: np.ndarray, path: Path) -> None:
    """Write the frame to ``path``; OSError when that fails."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **facts(frame)}
    channels = {"RGBA": np.ascontiguousarray(rgba, dtype=np.float32)}
    depth = getattr(frame, "depth", None)
    if depth is not None:
        depth = np.ascontiguousarray(depth, dtype=np.float32)
        if depth.shape != rgba.shape[:2]:
            raise UsageError("frame.depth", f"its shape is {depth.shape}", f"{rgba.shape[:2]}")
        channels["Z"] = depth
    try:
        OpenEXR.File(header, channels).write(str(path))
    except (RuntimeError, ValueError) as error:
        # The library names the temporary file, which is nothing to the user.
        why = str(error).replace(f' to image file "{path}"', "").strip().rstrip(".")
        raise OSError(why) from error


def channels(path: str) -> dict[str, np.ndarray]:
    """The channels of the file's first part by name, as they are stored."""
    return _read(path)[0]


def _read(path: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The channels, and the header's texts and numbers."""
    import OpenEXR

    with OpenEXR.File(path, separate_channels=True) as file:
        pixels = {name: np.asarray(channel.pixels) for name, channel in file.channels().items()}
        header = {k: v for k, v in file.header().items() if isinstance(v, (str, int, float))}
    return pixels, header


def read(path: str) -> tuple[np.ndarray, np.ndarray | None, dict[str, Any]]:
    """``rgba`` (a missing A means opaque), Z or None, and the header's texts and numbers."""
    pixels, header = _read(path)
    missing = [name for name in "RGB" if name not in pixels]
    if missing:
        there = ", ".join(sorted(pixels)) or "none"
        raise UsageError(path, f"the channels are {there}", "R, G, B, A")
    opaque = np.ones(pixels["R"].shape, dtype=np.float32)
    rgba = np.stack([pixels.get(name, opaque) for name in "RGBA"], axis=-1).astype(np.float32)
    depth = pixels["Z"].astype(np.float32) if "Z" in pixels else None
    if "stats" in header:
        try:
            header["stats"] = json.loads(header["stats"])
        except ValueError:
            pass
    return rgba, depth, header
