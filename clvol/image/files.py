"""Writes frames and reads pictures in the format that the file name's ending says."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from io import TextIOBase
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np

from clvol.errors import ClvolError, RenderError, UsageError
from clvol.image.about import MADE_FROM, digest
from clvol.image.atomic import atomic_path, check_output_folder

# ending -> module of this package
ENDINGS = {
    ".exr": "exr", ".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".tif": "tiff", ".tiff": "tiff", ".npy": "npy",
}  # fmt: skip
WITH_SCENE = (".exr", ".png", ".jpg", ".jpeg")  # pictures that are never volumes


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
    """Writes ``frame`` as ``.exr``, ``.png``, ``.jpg``, ``.tif`` or ``.npy``. The file appears whole or not at all.

    ``frame.rgba`` is float32 [height, width, 4], linear, premultiplied, row 0 on top; ``frame.depth`` float32
    [height, width] in world units or None; ``frame.background`` [3] linear; ``frame.stats`` a dict;
    ``frame.scene_source`` a str or None; ``frame.made_from`` a function that returns a dict, or None;
    ``frame.display`` and ``frame.overlay`` as in ``clvol.image.develop``, or None. EXR stores rgba and depth
    unchanged, NPY rgba, and the others the image as displayed. Raises :class:`clvol.errors.UsageError` for an unknown
    ending or a path that cannot be written to, and :class:`clvol.errors.RenderError` when writing fails.
    """
    module = _format(path)
    rgba = checked(frame.rgba)
    with atomic_path(path) as temporary:
        try:
            module.write(frame, rgba, temporary)
        except UsageError as error:  # what the format cannot hold
            where = str(path) if error.where == str(temporary) else error.where
            raise UsageError(where, error.what, error.expected) from None


def checked(pixels: Any) -> np.ndarray:
    """``pixels`` as float32 [height, width, 4]; UsageError for another shape."""
    rgba = np.asarray(pixels, dtype=np.float32)
    if rgba.ndim != 3 or rgba.shape[2] != 4 or 0 in rgba.shape:
        raise UsageError("frame.rgba", f"its shape is {rgba.shape}", "[height, width, 4]")
    return rgba


def write_frame(frame: Any, stream: BinaryIO, ending: str = ".png") -> None:
    """Writes the bytes of a picture file to ``stream``, a binary file that is open for writing.

    ``ending``: as in ``save_frame``, which says what is raised; nothing is written to the stream if that fails.
    """
    module = _format(f"picture{ending}")
    rgba = checked(frame.rgba)
    if not callable(getattr(stream, "write", None)) or isinstance(stream, TextIOBase):
        kind = f"a {type(stream).__name__}"
        raise UsageError("frame.save", f"got {kind}", "a path, or a binary file that is open for writing")
    with TemporaryDirectory(prefix="clvol-") as folder:
        path = Path(folder) / f"picture{ending}"
        try:
            module.write(frame, rgba, path)
            content = path.read_bytes()
        except OSError as error:
            raise RenderError(folder, f"the file cannot be written: {error.strerror or error}") from error
    stream.write(content)


def picture_texts(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The metadata of a picture (``WITH_SCENE``), by lower-case names, without its pixels. UsageError if it cannot be
    read."""
    module = _format(path)
    with _reading(path):
        return {name.lower(): value for name, value in module.texts(os.fspath(path)).items()}


def save_picture(frame: Any, temporary: Path, path: str) -> None:
    """Writes ``frame`` to ``temporary``, a file of ``atomic_paths``, which flushes it. Errors name ``path``, the final
    name of the file."""
    module = _format(path)
    try:
        module.write(frame, checked(frame.rgba), temporary)
    except OSError as error:
        raise RenderError(path, f"the file cannot be written: {error.strerror or error}") from error
    except ClvolError as error:
        where = path if error.where == str(temporary) else error.where
        raise type(error)(where, error.what, error.expected) from error


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
    with _reading(path):
        rgba, depth, header = module.read(os.fspath(path), memory_cap)
    return {
        "rgba": np.ascontiguousarray(rgba, dtype=np.float32),
        "depth": depth,
        "has_alpha": header.pop("has_alpha"),
        "background": _background(header),
        MADE_FROM: _parsed(header, MADE_FROM, dict),
        "header": header,
    }


@contextmanager
def _reading(path: str | os.PathLike[str]) -> Iterator[None]:
    """Raises UsageError where ``path`` is no file, or where reading it fails in whatever way."""
    if not os.path.isfile(path):
        raise UsageError(str(path), "there is no such file", f"a picture ({', '.join(ENDINGS)})")
    try:
        yield
    except (UsageError, MemoryError):
        raise
    # The libraries raise exceptions of any type for damaged files.
    except Exception as error:
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UsageError(str(path), f"the picture cannot be read: {why}",
                         f"a whole {Path(path).suffix.lower()} file") from error


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
