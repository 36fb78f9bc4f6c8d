"""The metadata of a picture: how it was made."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import clvol
from clvol.text import without_surrogates

MADE_FROM = "made_from"
SCENE_FOLDER = "scene_folder"
OVERLAY = "overlay"


@cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "unknown"


def _plain(value: Any) -> Any:
    """Numpy scalars and arrays as numbers and lists; anything else as its ``str()``."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def facts(frame: Any, held: Iterable[np.ndarray] = (), path: Path | None = None) -> dict[str, str]:
    """Texts for a header: software, versions, device, statistics and background; also, if they are known, the scene,
    its folder as seen from that of ``path``, the file, what an overlay is drawn from, and what the picture was made
    from (``clvol.render.made_from``), with a digest of ``held``, the arrays that the file stores."""
    stats = getattr(frame, "stats", None) or {}
    texts = {
        "software": f"clvol {clvol.__version__}",
        "clvol_version": clvol.__version__,
        "pyopencl_version": _version("pyopencl"),
        "numpy_version": _version("numpy"),
        "device": ", ".join(str(d) for d in stats.get("devices", ())) or "unknown",
        "stats": json.dumps(stats, default=_plain),
    }
    if "accuracy" in stats:  # as separate entries, which any tool that reads headers shows
        for name in ("rmse", "bound", "confidence"):
            texts[f"error_{name}"] = repr(float(stats["accuracy"][name]))
    background = getattr(frame, "background", None)
    if background is not None:
        texts["background"] = json.dumps([float(x) for x in np.asarray(background).reshape(3)])
    scene = getattr(frame, "scene_source", None)
    if scene:
        texts["scene"] = scene
        folder = getattr(frame, SCENE_FOLDER, None)
        if folder is not None and path is not None:
            texts[SCENE_FOLDER] = _seen_from(path, os.fspath(folder))
    overlay = getattr(frame, OVERLAY, None)
    if overlay is not None:
        texts[OVERLAY] = overlay.to_json()
    made_from = getattr(frame, MADE_FROM, None)
    if made_from is not None:
        texts[MADE_FROM] = json.dumps({**made_from(), "pixels": digest(held)})
    return {name: without_surrogates(text) for name, text in texts.items()}


def _seen_from(path: Path, folder: str) -> str:
    """``folder`` relative to that of ``path``, so that a picture and its volume may be moved together."""
    try:
        return os.path.relpath(folder, os.path.dirname(os.path.abspath(path)))
    except ValueError:  # on another drive
        return os.path.abspath(folder)


def texts_of(comment: Any) -> dict[str, Any]:
    """The metadata that a file keeps as JSON in its comment; empty for a comment of another kind."""
    try:
        text = comment.decode("utf-8") if isinstance(comment, bytes) else comment
        found = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        return {}
    return {k: v for k, v in found.items() if isinstance(v, (str, int, float))} if isinstance(found, dict) else {}


def digest(arrays: Iterable[np.ndarray]) -> str:
    """A digest of the shapes, types and contents of ``arrays``, 32 hexadecimal digits."""
    known = hashlib.blake2b(digest_size=16)
    for array in arrays:
        array = np.ascontiguousarray(array)
        known.update(f"{array.dtype.str} {array.shape}\n".encode())
        known.update(array.data)
    return known.hexdigest()
