"""Frames of files: the light of a picture that has been rendered, to be displayed in another way."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from clvol.errors import UsageError
from clvol.image import load_image
from clvol.image.about import MADE_FROM, OVERLAY, SCENE_FOLDER
from clvol.overlay import DrawnOverlay
from clvol.scene.carried import display_of

_LIGHT = (".exr", ".npy")  # formats that hold light, not colours as displayed


def load_frame(kind: Callable[..., Any], path: str | os.PathLike[str], memory_cap: int | None = None) -> Any:
    """A frame (``kind``: its class) of the picture ``path``. Raises UsageError, SceneError."""
    ending = Path(path).suffix.lower()
    if ending not in _LIGHT:
        what = "holds colours as displayed, not light" if ending else "has no ending"
        raise UsageError(str(path), what, " or ".join(_LIGHT))
    picture = load_image(path, memory_cap)
    header, made_from = picture["header"], picture[MADE_FROM]
    scene = header.get("scene")
    stats = header.get("stats")
    folder = header.get(SCENE_FOLDER)
    frame = kind(
        picture["rgba"],
        picture["depth"],
        stats=stats if isinstance(stats, dict) else {},
        scene_source=scene if isinstance(scene, str) else None,
        made_from=None if made_from is None else (lambda: _without_pixels(made_from)),
        display=display_of(scene, str(path)) if isinstance(scene, str) else None,
        overlay=_overlay(header.get(OVERLAY), str(path)),
    )
    if isinstance(folder, str) and "\0" not in folder:
        frame.scene_folder = os.path.abspath(Path(path).parent / folder)
    if picture["background"] is not None:
        frame.background = picture["background"]
    return frame


def _without_pixels(made_from: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in made_from.items() if key != "pixels"}


def _overlay(text: Any, path: str) -> DrawnOverlay | None:
    if not isinstance(text, str):
        return None
    try:
        return DrawnOverlay.from_json(text)
    except ValueError:  # pydantic's ValidationError is one
        what = "what its header says of the overlay is damaged"
        raise UsageError(f"{path}: overlay", what, "a whole picture") from None
