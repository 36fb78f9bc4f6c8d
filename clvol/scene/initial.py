"""The text of a scene to go on from: what was chosen for a volume, with the meaning of each key beside it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from clvol.readers import is_url
from clvol.scene.camera import Camera
from clvol.scene.table import Table
from clvol.scene.write import format_value

if TYPE_CHECKING:
    from clvol.scene.scene import Scene

_WIDTH = 42  # columns before a comment
_ALWAYS: dict[str, tuple[str, ...]] = {
    "image": ("width", "height", "background"),
    "integration": ("method", "step", "classification", "filter", "compositing"),
}


def initial_scene(scene: Scene, folder: str) -> str:
    """TOML of ``scene``, completed, for a file in ``folder``: each key with its title as a comment.

    It reads back as the same scene; the volume is named relative to ``folder``.
    """
    chosen = scene.chosen
    lines = ["# A scene of clvol. `clvol scene --keys` prints every key; `clvol render` renders this file."]
    if chosen is not None:
        lines += [f"# {line}" for line in _reasons(chosen)]
    lines += ["version = 1"]
    for name, field in type(scene).model_fields.items():
        value = getattr(scene, name)
        if name == "version" or value is None:
            continue
        if name not in scene.model_fields_set and name not in _ALWAYS:
            continue
        if isinstance(value, tuple):
            for table in value:
                lines += ["", f"[[{name}]]", *_keys(table, _stated(table))]
        elif isinstance(value, BaseModel):
            keys = _stated(value) | {key: getattr(value, key) for key in _ALWAYS.get(name, ())}
            if name == "volume" and isinstance(keys.get("file"), str):
                keys["file"] = _from_folder(scene.folder, keys["file"], folder)
            if name == "transfer_function":
                keys.setdefault("color_space", "srgb")
            lines += ["", f"# {field.title}", f"[{name}]", *_keys(value, keys)]
            if isinstance(value, Camera):
                lines.append('# view = "front-left"  # in place of position: a side, or up to three that meet')
    return "\n".join(lines) + "\n"


def _reasons(chosen: Mapping[str, Any]) -> list[str]:
    said = [f"Chosen from the volume, which looks like: {chosen['kind']} ({chosen['why']})."]
    if "expects" in chosen:
        said = [f"Preset {chosen['preset']}, for {chosen['expects']}. The volume looks like: {chosen['kind']}."]
    return [*said, f"View: {chosen['view']}."]


def _stated(table: BaseModel) -> dict[str, Any]:
    dumped = table.model_dump(mode="python", exclude_unset=True, warnings=False)
    return {key: value for key, value in dumped.items() if value is not None}


def _keys(table: BaseModel, values: Mapping[str, Any]) -> list[str]:
    lines: list[str] = []
    fields = type(table).model_fields
    for key in fields:
        if key not in values:
            continue
        value = getattr(table, key) if isinstance(getattr(table, key), Table) else values[key]
        text, title = f"{key} = {format_value(value)}", fields[key].title
        if "\n" in text:
            lines += [f"# {title}", text]
        else:
            lines.append(f"{text:<{_WIDTH}}  # {title}")
    return lines


def _from_folder(volume_folder: os.PathLike[str], file: str, folder: str) -> str:
    """``file``, named relative to ``volume_folder``, as named relative to ``folder``; absolute if it was."""
    if os.path.isabs(file) or is_url(file):
        return file
    return os.path.relpath(os.path.join(volume_folder, file), folder)
