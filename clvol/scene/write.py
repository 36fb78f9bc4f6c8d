"""A scene as the text of a scene file, as it is stored in the header of a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from clvol.transfer import TransferFunction
from clvol.volume.series import VolumeSeries

if TYPE_CHECKING:
    from clvol.scene.scene import Scene


def to_toml(scene: Scene) -> str:
    """TOML that reads back as ``scene``: the keys that were set, in the order of the models.

    A volume or a field that was passed as an array is described in a comment.
    """
    lines = ["version = 1"]
    for name in type(scene).model_fields:
        value = getattr(scene, name)
        if name == "version" or name not in scene.model_fields_set or value is None:
            continue
        if isinstance(value, tuple):
            for item in value:
                lines += ["", f"[[{name}]]", *_keys(item)]
        elif isinstance(value, TransferFunction):
            lines += ["", f"[{name}]", *_function_keys(value)]
        elif isinstance(value, BaseModel):
            lines += ["", f"[{name}]", *_keys(value)]
        else:
            lines += ["", f"# volume: {_voxels(value)}"]
    return "\n".join(lines) + "\n"


def _keys(table: BaseModel) -> list[str]:
    settings = table.model_dump(mode="python", exclude_unset=True, warnings=False)
    return [_key(key, value) for key, value in settings.items() if value is not None]


def _key(key: str, value: Any) -> str:
    if hasattr(value, "grid"):  # a field's volume
        return f"# {key}: {_voxels(value)}"
    return f"{key} = {format_value(value)}"


def _voxels(volume: Any) -> str:
    if isinstance(volume, VolumeSeries):
        return f"{len(volume)} steps, each of {_voxels(volume.step(0))}"
    shape = " x ".join(str(n) for n in volume.grid.size)
    return f"{shape} voxels of {volume.dtype}, passed as an array"


def function_to_toml(function: TransferFunction) -> str:
    """The table [transfer_function] of a scene file with the points of ``function``."""
    return "\n".join(["[transfer_function]", *_function_keys(function)]) + "\n"


def _function_keys(function: TransferFunction) -> list[str]:
    points = [
        {"value": float(value), "opacity": float(opacity), "color": color.tolist()}
        for value, opacity, color in zip(function.values, function.opacities, function.colors)
    ]
    unit = f"opacity_unit = {format_value(function.opacity_unit)}"
    return [unit, 'color_space = "linear"', f"points = {format_value(points)}"]


def _bare(key: str) -> str:
    """A key as it is written: in quotes where it has dots."""
    return f'"{key}"' if "." in key else key


def format_value(value: Any) -> str:
    if type(value) is float:  # what most values are
        return repr(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # A JSON string is a TOML basic string, except for DEL.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_bare(key)} = {format_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        if value and isinstance(value[0], Mapping):
            return "[\n" + "".join(f"  {format_value(item)},\n" for item in value) + "]"
        return "[" + ", ".join(format_value(item) for item in value) + "]"
    return repr(value)
