"""Scenes that are loaded one after another and differ in a few keys, as those of a job or of an animation do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from clvol.scene.load import load_scene
from clvol.scene.resolve import ResolvedScene
from clvol.scene.same_value import is_same
from clvol.scene.scene import Scene


class SceneFamily:
    """Loads and resolves scenes as ``load_scene`` and ``Scene.resolve`` do. What a scene has in common with the one
    before, tables and volumes, is the same object, so that it is not checked again, and whatever was made of it is
    found by identity."""

    def __init__(self) -> None:
        self._data: dict[str, Any] = {}  # as the last scene's file and settings state it
        self._scene: Scene | None = None
        self._resolved: ResolvedScene | None = None

    def load(self, path: str | Path, overrides: Iterable[str] = (), settings: Iterable[tuple[str, Any]] = ()) -> Scene:
        """As ``load_scene``; with the volumes of the scene before where they are the same, and have not changed."""
        before, self._data = self._data, {}  # which stays where the scene is wrong, or from a picture's header
        scene = load_scene(path, overrides, settings, partial(self._made, before))
        if self._scene is not None and scene is not self._scene:
            scene.share_volumes(self._scene)
        self._scene = scene
        return scene

    def resolve(self, scene: Scene, memory_cap: int | None = None) -> ResolvedScene:
        resolved, before = scene.resolve(memory_cap), self._resolved
        if before is not None:
            common = {field.name: getattr(before, field.name) for field in fields(resolved)}
            same = {name: value for name, value in common.items() if _is_other(getattr(resolved, name), value)}
            resolved = replace(resolved, **same) if same else resolved
        self._resolved = resolved
        return resolved

    def _made(self, stated: dict[str, Any], data: dict[str, Any], origin: str, folder: Path) -> Scene:
        """``Scene.from_data`` with the tables of the scene before, of the data ``stated``, that are the same."""
        before, given = self._scene, data
        if before is not None and (before.origin, before.folder) == (origin, folder):
            same = [name for name, value in data.items() if name in stated and is_same(value, stated[name])]
            given = data | {name: getattr(before, name) for name in same}
        scene = Scene.from_data(given, origin, folder)
        self._data = data
        return scene


def _is_other(value: Any, before: Any) -> bool:
    """Whether they are the same, but not one object."""
    return value is not before and is_same(value, before)
