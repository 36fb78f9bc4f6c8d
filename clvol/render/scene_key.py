"""The key of a prepared scene: equal for all scenes that it can render.

A key consists of values: numbers with their types, arrays with their bytes. Objects that have no value of their
own (a volume, an oracle) are part of it themselves: they are compared by identity, and live as long as the key.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from clvol.integrators.base import Integrator
from clvol.scene.resolve import ResolvedScene
from clvol.scene.table import Table
from clvol.transfer import TransferFunction

# Tables that ``Prepared.for_scene`` takes over from another scene, or that no picture depends on.
_TAKEN_OVER = ("camera", "image", "animation", "integration", "multiresolution", "pyramid", "slicing", "coherence")
_NOT_RENDERED = ("source", "origin", "folder", "chosen", "display", "overlay")
_FREE_SETTINGS = {"step": 1.0, "early_termination": 0.0}  # of [integration]


def scene_key(resolved: ResolvedScene, integrator: Integrator) -> tuple[Hashable, ...]:
    """A key that is equal for scenes that one prepared scene may serve (``Prepared.for_scene``). New tables of
    scenes are part of it by default: only those named here are left out."""
    left_out = (*_TAKEN_OVER, *_NOT_RENDERED)
    parts: list[Any] = [getattr(resolved, f.name) for f in fields(resolved) if f.name not in left_out]
    parts += resolved.integration.model_copy(update=_FREE_SETTINGS), *integrator.key(resolved)
    return tuple(map(value_key, parts))


def value_key(value: Any) -> Hashable:
    """A key that is equal for equal values of the same type; for a volume, or another object without a value, only for
    the same object."""
    if value is None or isinstance(value, TransferFunction):
        return value
    if isinstance(value, np.ndarray):
        return ("array", value.dtype.str, value.shape, value.tobytes())
    if isinstance(value, (tuple, list)):
        return tuple(map(value_key, value))
    if isinstance(value, Table):
        return (type(value), *((name, value_key(part)) for name, part in sorted(vars(value).items())))
    if is_dataclass(value):
        return (type(value), *(value_key(getattr(value, f.name)) for f in fields(value)))
    if isinstance(value, float):
        return (type(value), value.hex())  # 0 and -0 are two values
    return (type(value), value)
