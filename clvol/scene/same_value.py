"""Whether two values of a scene are the same, bit for bit."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel


def is_same(one: Any, other: Any) -> bool:
    """Whether ``one`` and ``other`` have the same type and value: 1, 1.0 and True are three values, 0.0 and -0.0 are
    two. Objects without a value, such as volumes, are the same only if they are one object."""
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, float):
        return one.hex() == other.hex()
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(is_same, one, other))
    if isinstance(one, dict):
        return list(one) == list(other) and all(map(is_same, one.values(), other.values()))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    if isinstance(one, BaseModel):
        return one.model_fields_set == other.model_fields_set and is_same(vars(one), vars(other))
    if is_dataclass(one):
        return all(is_same(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    return isinstance(one, (str, int, Path)) and bool(one == other)
