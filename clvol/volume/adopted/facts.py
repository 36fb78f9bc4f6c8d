"""What an object of another library says about itself as a volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.grid import Grid


@dataclass(frozen=True)
class Adopted:
    """``array`` [z, y, x] as it is in the object, and what the object states; None where it states nothing.

    Values are ``slope`` * stored + ``offset``. ``note`` is a sentence that the caller should read.
    """

    array: np.ndarray
    grid: Grid | None = None
    frame: str | None = None
    unit: str | None = None
    name: str | None = None
    slope: float = 1.0
    offset: float = 0.0
    note: str | None = None


def refused(what: str, expected: str) -> VolumeError:
    return VolumeError("volume", what, expected)


def name_of(value: object) -> str:
    """The type of an object with its library, as in "xarray Dataset"."""
    root = type(value).__module__.partition(".")[0]
    return type(value).__name__ if root == "builtins" else f"{root} {type(value).__name__}"
