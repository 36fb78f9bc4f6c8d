"""The camera, and the scene, at a time between keyframes (``clvol.scene.keyframe``)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from clvol.errors import SceneError
from clvol.scene import Scene
from clvol.scene.animation import Animation
from clvol.scene.camera import Camera
from clvol.scene.keyframe import Keyframe
from clvol.scene.load import assign
from clvol.scene.table import Table
from clvol.schedule.splines import catmull_rom, monotone, slerp

_OPPOSITE = -0.9999  # the cosine of directions between which no great circle is the shortest one
_CURVES = {
    "position": catmull_rom, "target": catmull_rom, "up": slerp, "fov_degrees": monotone, "height": monotone,
}  # fmt: skip


def camera_at(camera: Camera, keyframes: Sequence[Keyframe], seconds: float, origin: str = "scene") -> Camera:
    """``camera`` (complete) with what ``keyframes`` say of it at time ``seconds``. SceneError for a view that is none:
    a position in the target, or an ``up`` along the view."""
    found: dict[str, Any] = {}
    for key, curve in _CURVES.items():
        stated = [k for k in keyframes if k.camera is not None and getattr(k.camera, key) is not None]
        if stated:
            times, values = [k.time for k in stated], [getattr(k.camera, key) for k in stated]
            if key == "up":
                _check_ups(stated, origin)
            value = curve(times, values, seconds)
            found[key] = tuple(value.tolist()) if value.ndim else float(value)
    if not found:
        return camera
    try:
        return camera.model_copy(update=found)
    except SceneError as error:
        where = f"{origin}: animation.keyframe at {seconds:g} s"
        raise SceneError(where, f"the camera is at fault: {error}", "other keyframes") from None


def scene_at(scene: Scene, seconds: float) -> Scene:
    """``scene`` with what its keyframes set at time ``seconds``, and without keyframes; the scene itself if they set
    nothing. Its volume and fields are shared. SceneError for values that are not allowed."""
    keyframes = scene.animation.keyframe
    keys = dict.fromkeys(key for keyframe in keyframes for key in keyframe.set)
    if not keys:
        return scene
    tables: dict[str, Any] = {}
    for key in keys:
        name, *inner = key.split(".")
        stated = [k for k in keyframes if key in k.set]
        value = _between([k.time for k in stated], [k.set[key] for k in stated], seconds)
        where = f"{scene.origin}: animation.keyframe.set.{key}"
        if name not in tables:
            tables[name] = _data(getattr(scene, name, None), where)
        assign(tables, [name, *inner], value, where)
    animation = {key: getattr(scene.animation, key) for key in scene.animation.model_fields_set if key != "keyframe"}
    try:
        return scene.model_copy(update={**tables, "animation": Animation(**animation)})
    except SceneError as error:
        what = f"sets, at {seconds:g} s, what is not allowed: {error}"
        raise SceneError(f"{scene.origin}: animation.keyframe", what, "other values") from None


def check_scenes(scene: Scene) -> None:
    """SceneError if what keyframes set is not allowed, at their times and half way between them."""
    times = [keyframe.time for keyframe in scene.animation.keyframe if keyframe.set]
    for seconds in sorted({*times, *(0.5 * (a + b) for a, b in zip(times, times[1:]))}):
        scene_at(scene, seconds)


def _data(table: Any, where: str) -> Any:
    """A table of a scene, or a list of them, as it is in a file."""
    if isinstance(table, tuple):
        return [_data(item, where) for item in table]
    if isinstance(table, Table):
        return table.model_dump(mode="python", exclude_unset=True, warnings=False)
    raise SceneError(where, "the scene does not state that table", "a table of the scene file to change values of")


def _between(times: Sequence[float], values: Sequence[Any], seconds: float) -> Any:
    """``values``, numbers or lists and tables of them, all of one structure, at time ``seconds``."""
    first = values[0]
    if isinstance(first, dict):
        return {key: _between(times, [value[key] for value in values], seconds) for key in first}
    if isinstance(first, (list, tuple)):
        return [_between(times, list(items), seconds) for items in zip(*values)]
    found = float(monotone(times, values, seconds))
    whole = all(isinstance(value, int) for value in values) and found.is_integer()
    return int(found) if whole else found


def _check_ups(keyframes: Sequence[Keyframe], origin: str) -> None:
    unit = partial(np.linalg.norm, axis=1, keepdims=True)
    ups = np.array([k.camera.up for k in keyframes if k.camera is not None], np.float64)
    ups = ups / np.maximum(unit(ups), 1e-300)
    for before, after, keyframe in zip(ups, ups[1:], keyframes[1:]):
        if before @ after < _OPPOSITE:
            where = f"{origin}: animation.keyframe at {keyframe.time:g} s: camera.up"
            raise SceneError(where, "opposite to the one before", "less than half a turn between two keyframes")
