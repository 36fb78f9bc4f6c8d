"""The scene that a picture carries: its text, which is read as a scene file is, and what the picture shows of it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clvol.errors import SceneError
from clvol.image import WITH_SCENE, picture_texts
from clvol.image.about import MADE_FROM, SCENE_FOLDER
from clvol.scene.camera import Camera
from clvol.scene.display import Display

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_EXPECTED = "a picture that clvol has rendered"


@dataclass(frozen=True)
class Moment:
    """What a picture shows of its scene: the camera and the time (seconds) of a frame of an animation, or of a call
    from Python; None where that is the scene's own. ``made_from``: as in its header."""

    camera: Camera | None
    time: float | None
    made_from: dict[str, Any]


@dataclass(frozen=True)
class Carried:
    """The scene of a picture: ``text`` of a scene file, the ``folder`` that its file names are relative to, as seen
    from the picture, and the ``moment`` that is shown."""

    path: Path
    text: str
    folder: Path
    moment: Moment

    def folder_with(self, file: Any) -> Path:
        """The folder, or that of the picture if only there is a ``file``."""
        if isinstance(file, str) and "\0" not in file and not os.path.exists(self.folder / file):
            if os.path.exists(self.path.parent / file):
                return self.path.parent
        return self.folder


def is_picture_path(path: Path) -> bool:
    """Whether ``path`` has the ending of a picture that may carry a scene, and is never a volume."""
    return path.suffix.lower() in WITH_SCENE


def carried_scene(path: Path, overrides: Iterable[str] = ()) -> Carried:
    """The scene that the picture ``path`` carries. UsageError if the picture cannot be read, SceneError if it carries
    no scene, or one whose voxels were passed as an array and are not named by ``overrides``."""
    texts = picture_texts(path)
    text = texts.get("scene")
    if not isinstance(text, str) or not text.strip():
        raise SceneError(str(path), "carries no scene", _EXPECTED)
    if "\n# volume: " in text and "volume.file" not in _keys(overrides):
        what = "its voxels were passed as an array, which a picture does not carry"
        raise SceneError(f"{path}: volume.file", what, "--set 'volume.file=\"FILE\"'")
    stated = texts.get(SCENE_FOLDER)
    known = isinstance(stated, str) and stated != "" and "\0" not in stated
    folder = Path(os.path.normpath(path.parent / str(stated))) if known else path.parent
    return Carried(path, text, folder, _moment(texts.get(MADE_FROM)))


def display_of(text: str, where: str) -> Display:
    """[display] of the scene ``text`` that the picture ``where`` carries. SceneError if it is wrong."""
    table = tables_of(text, where).get("display", {})
    return Display(**table) if isinstance(table, dict) else Display()


def tables_of(text: str, where: str) -> dict[str, Any]:
    """The tables of a scene's ``text`` that a picture carries; SceneError names the picture, ``where``."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError):
        raise SceneError(where, "the scene in its header is damaged", _EXPECTED) from None


def at_its_moment(data: dict[str, Any], moment: Moment, overrides: Iterable[str]) -> Moment:
    """Makes of the parsed scene ``data`` the one of a single picture, and returns what has to be rendered of it.

    The camera is kept apart from the scene, since lights and depth cues that were placed by the scene's own camera stay
    where they are; but where ``overrides`` change the camera, they change that of the picture.
    """
    camera, keys = moment.camera, _keys(overrides)
    if any(key.split(".")[0] == "camera" for key in keys):
        if camera is not None and "camera.view" not in keys:
            data["camera"] = camera.model_dump(mode="json", exclude_none=True)
        camera = None
    if "frame" not in moment.made_from:
        return Moment(camera, None, moment.made_from)
    animation = data.get("animation")
    data["animation"] = {**(animation if isinstance(animation, dict) else {}), "frames": 1}
    step, volume = moment.made_from.get("step"), data.get("volume")
    if type(step) is int and step >= 0 and isinstance(volume, dict) and "volume.step" not in keys:
        data["volume"] = {**volume, "step": step}  # whatever the number of frames says about its time
    return Moment(camera, moment.time, moment.made_from)


def _keys(overrides: Iterable[str]) -> set[str]:
    return {override.split("=")[0].strip() for override in overrides}


def _moment(text: Any) -> Moment:
    """What the text "made_from" of a header says; nothing where it is damaged."""
    try:
        told = json.loads(text)
        camera = Camera.model_validate_json(json.dumps(told["camera"]))
        time = told["time"]
    except (TypeError, ValueError, KeyError, RecursionError, SceneError):
        return Moment(None, None, {})
    is_time = isinstance(time, (int, float)) and not isinstance(time, bool) and abs(time) <= 1e6
    return Moment(camera, float(time) if is_time else None, told)
