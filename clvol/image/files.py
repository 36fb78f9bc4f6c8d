"""Writes frames and reads pictures in the format that the file name's ending says."""

from __future__ import annotations

import json
import os
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError
from clvol.image.about import MADE_FROM, digest
from clvol.image.atomic import atomic_path, check_output_folder

ENDINGS = {".exr": "exr", ".png": "png", ".npy": "npy"}  # ending -> module of this package


def _format(path: str | os.PathLike[str]) -> Any:
    try:
        name = ENDINGS[Path(path).suffix.lower()]
    except KeyError:
        raise UsageError(str(path), f'unknown ending "{Path(path).suffix}" of a picture',
                         " or ".join(ENDINGS)) from None
    return import_module(f"clvol.image.{name}")


def check_output(path: str | os.PathLike[str]) -> None:
    """Raises :class:`clvol.errors.UsageError` now if :func:`save_frame` could not write to ``path`` later."""
    _format(path)
    check_output_folder(path)


def save_frame(frame: Any, path: str | os.PathLike[str]) -> None:
    """Writes ``frame`` as ``.exr``, ``.png`` or ``.npy``. The file appears whole or not at all.

    ``frame.rgba`` is float32 [height, width, 4], linear, premultiplied, row 0 on top;
    ``frame.depth`` float32 [height, width] in world units or None; ``frame.background`` [3] linear;
    ``frame.stats`` a dict; ``frame.scene_source`` a str or None; ``frame.made_from`` a function that
    returns a dict, or None. EXR stores rgba and depth unchanged, NPY rgba, and PNG the image over the
    background. Raises :class:`clvol.errors.UsageError` for an unknown ending or a path that cannot be written to,
    and :class:`clvol.errors.RenderError` when writing fails.
    """
    module = _format(path)
    rgba = np.asarray(frame.rgba, dtype=np.float32)
    if rgba.ndim != 3 or rgba.shape[2] != 4 or 0 in rgba.shape:
        raise UsageError("frame.rgba", f"its shape is {rgba.shape}", "[height, width, 4]")
    with atomic_path(path) as temporary:
        module.write(frame, rgba, temporary)


def load_image(path: str | os.PathLike[str], memory_cap: int | None = None) -> dict[str, Any]:
    """Reads a picture: ``{"rgba", "depth", "header", "has_alpha", "background", "made_from"}``.

    ``rgba`` is float32 [height, width, 4], linear, premultiplied (a PNG is decoded from sRGB), ``depth`` float32
    [height, width] or None, and ``header`` a dict of the file's metadata. ``has_alpha`` is whether the file has an
    alpha channel. ``background`` ([3], linear) is the colour that the picture is, or is meant to be, composited
    over, and ``made_from`` a dict of what it was rendered from; both are None if the file does not state them.

    ``memory_cap``: the largest number of bytes that reading may take; None means 1 GiB, or 75 % of the available
    memory if that is less. Raises :class:`clvol.errors.UsageError` when the file is missing, is not a picture of its
    format, or needs more memory; in the last case nothing has been allocated.
    """
    module = _format(path)
    if not os.path.isfile(path):
        raise UsageError(str(path), "there is no such file", "a picture (.exr, .png, .npy)")
    try:
        rgba, depth, header = module.read(os.fspath(path), memory_cap)
    except (UsageError, MemoryError):
        raise
    # The libraries raise exceptions of any type for damaged files.
    except Exception as error:
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UsageError(str(path), f"the picture cannot be read: {why}",
                         f"a whole {Path(path).suffix.lower()} file") from error
    return {
        "rgba": np.ascontiguousarray(rgba, dtype=np.float32),
        "depth": depth,
        "has_alpha": header.pop("has_alpha"),
        "background": _background(header),
        MADE_FROM: _parsed(header, MADE_FROM, dict),
        "header": header,
    }


def is_intact(path: str | os.PathLike[str], picture: dict[str, Any]) -> bool:
    """Whether ``picture``, which ``load_image`` has read from ``path``, has the pixels that were written."""
    held = _format(path).held(picture["rgba"], picture["depth"])
    return (picture[MADE_FROM] or {}).get("pixels") == digest(held)


def _background(header: dict[str, Any]) -> np.ndarray | None:
    values = _parsed(header, "background", list)
    try:
        color = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return color if color.shape == (3,) and np.isfinite(color).all() else None


def _parsed(header: dict[str, Any], key: str, kind: type) -> Any:
    try:
        value = json.loads(header[key])
    except (KeyError, TypeError, ValueError, RecursionError):
        return None
    return value if isinstance(value, kind) else None
