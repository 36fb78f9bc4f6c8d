"""A resolved scene as JSON, and back, value by value: every number is the same afterwards.

Objects are made of a closed list of types: the tables of scenes, and a few further ones.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from clvol.device.view import PixelLattice, PixelList
from clvol.readers.meshes import ClosedMesh
from clvol.scene import OpacityFactor, RefractiveIndex, ResolvedChannel, ResolvedField, ResolvedScene, TransferLayer
from clvol.scene.classification import ChosenClassification
from clvol.scene.glow import Glow
from clvol.scene.step_times import StepTimes
from clvol.scene.table import Table
from clvol.transfer import TransferFunction
from clvol.volume.axis import ValueAxis
from clvol.volume.colored import Colors
from clvol.volume.grid import Grid
from clvol.volume.volume import Volume

_TYPES: dict[str, type] = {
    each.__name__: each
    for each in (
        ChosenClassification, ClosedMesh, Colors, Glow, Grid, OpacityFactor, PixelLattice, PixelList, RefractiveIndex,
        ResolvedChannel, ResolvedField, ResolvedScene, StepTimes, TransferFunction, TransferLayer, ValueAxis,
    )  # fmt: skip
}


@cache
def _tables() -> dict[str, type[Table]]:
    """The tables of scenes by their names."""
    found: dict[str, type[Table]] = {}
    waiting = [Table]
    while waiting:
        for each in waiting.pop().__subclasses__():
            found[each.__name__] = each
            waiting.append(each)
    return found


def encoded(value: Any, volume_number: Callable[[Volume], int] | None = None) -> Any:
    """``value`` as what JSON holds; volumes as the numbers that ``volume_number`` gives. TypeError for what is none of
    the types of a scene."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value.item() if isinstance(value, np.generic) else value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {"array": [value.dtype.str, list(value.shape), data]}
    if isinstance(value, Volume) and volume_number is not None:
        return {"volume": volume_number(value)}
    if isinstance(value, Path):
        return {"path": str(value)}
    if isinstance(value, (tuple, list)):
        return {type(value).__name__: [encoded(each, volume_number) for each in value]}
    if isinstance(value, dict):
        return {"dict": [[encoded(k), encoded(v, volume_number)] for k, v in value.items()]}
    name = type(value).__name__
    if isinstance(value, Table):
        known = {key: encoded(each, volume_number) for key, each in vars(value).items()}
        return {"table": name, "values": known, "set": sorted(value.model_fields_set)}
    if is_dataclass(value) and _TYPES.get(name) is type(value):
        return {"type": name, "values": {f.name: encoded(getattr(value, f.name), volume_number) for f in fields(value)}}
    raise TypeError(f"{type(value).__name__} is not part of a scene")


def decoded(value: Any, volumes: dict[int, Volume] | None = None) -> Any:
    """What ``encoded`` made ``value`` of. ``volumes``: by number."""
    if not isinstance(value, dict):
        return value
    if "array" in value:
        dtype, shape, data = value["array"]
        array = np.frombuffer(base64.b64decode(data), np.dtype(dtype)).reshape(shape)
        return array
    if "volume" in value:
        return (volumes or {})[value["volume"]]
    if "path" in value:
        return Path(value["path"])
    if "dict" in value:
        return {decoded(k): decoded(v, volumes) for k, v in value["dict"]}
    for kind in (tuple, list):
        if kind.__name__ in value:
            return kind(decoded(each, volumes) for each in value[kind.__name__])
    known = {key: decoded(each, volumes) for key, each in value["values"].items()}
    if "table" in value:
        return _tables()[value["table"]].model_construct(set(value["set"]), **known)
    return _TYPES[value["type"]](**known)
