"""What an engine was made for, as a key: equal for scenes that it renders alike.

A key is made of values alone: numbers with their types, arrays with their bytes. Objects that have no value of their
own (a volume, an oracle) are in it themselves: they count as what they are, and live as long as the key.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from clvol.scene.resolve import ResolvedScene
from clvol.scene.table import Table
from clvol.transfer import TransferFunction

# What ``Raycaster.like`` takes over from another scene, and what no picture depends on.
_FROM_LIKE = ("camera", "image", "animation", "integration", "multiresolution", "pyramid")
_NOT_RENDERED = ("source", "origin")
_FREE_SETTINGS = {"step": 1.0, "early_termination": 0.0}  # of [integration]


def engine_key(resolved: ResolvedScene) -> tuple[Hashable, ...]:
    """Equal for scenes that an engine may be shared for (``Raycaster.like``). A table that a scene gets in the
    future counts: only those named here do not."""
    left_out = (*_FROM_LIKE, *_NOT_RENDERED)
    parts: list[Any] = [getattr(resolved, f.name) for f in fields(resolved) if f.name not in left_out]
    integration = resolved.integration.model_copy(update=_FREE_SETTINGS)
    parts.append(integration)
    if integration.method == "multiresolution":
        parts.append(resolved.multiresolution)
        if resolved.multiresolution.stepping == "pyramid":
            parts.append(resolved.pyramid.levels)
    if integration.method == "pyramid":
        from clvol.integrators.pyramid.oracles import oracle_named

        parts += resolved.pyramid, oracle_named(resolved.pyramid.oracle)
    return tuple(map(value_key, parts))


def value_key(value: Any) -> Hashable:
    """Equal for equal values of the same type; for a volume, or whatever else has no value, for the same object."""
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
