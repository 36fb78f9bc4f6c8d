"""The linear map from the stored number of a voxel to its value."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.errors import VolumeError

_LARGEST = 1e30
_ROUNDING = 1e-12  # relative error of a division


@dataclass(frozen=True)
class ValueAxis:
    """values = ``slope`` * stored + ``offset``; finite, slope not 0, both at most 1e30 in magnitude.

    Raises VolumeError for other numbers.
    """

    slope: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        for name in ("slope", "offset"):
            try:
                number = float(getattr(self, name))
            except (TypeError, ValueError, OverflowError):
                number = math.nan
            least = 1.0 / _LARGEST if name == "slope" else 0.0
            if not least <= abs(number) <= _LARGEST:
                wanted = "a finite number" + (" that is not 0" if name == "slope" else "")
                raise VolumeError(name, f"got {getattr(self, name)!r}", wanted)
            object.__setattr__(self, name, number)

    @property
    def is_plain(self) -> bool:
        """Whether values equal stored numbers."""
        return self.slope == 1.0 and self.offset == 0.0

    def values(self, stored: Any) -> Any:
        """The values of ``stored`` numbers, float64 of the same shape (a float for a float)."""
        return self.slope * stored + self.offset

    def stored(self, values: Any, whole: bool = False) -> np.ndarray:
        """The stored numbers, float64, of ``values``.

        ``whole``: voxels are integers, so results that are within rounding of a whole number become that number, and
        the steps of a function meet voxels exactly.
        """
        values = np.asarray(values, np.float64)
        if self.is_plain:
            return values
        found = (values - self.offset) / self.slope
        if whole:
            nearest = np.rint(found)
            unsure = _ROUNDING * (np.abs(values) + abs(self.offset)) / abs(self.slope)
            found = np.where(np.abs(found - nearest) <= unsure, nearest, found)
        return found

    def span(self, stored: tuple[float, float]) -> tuple[float, float]:
        """(lowest, highest) value of the range of ``stored`` numbers (lowest, highest)."""
        if self.is_plain:
            return stored
        first, last = (self.values(number) for number in stored)
        return (first, last) if first <= last else (last, first)

    def after(self, inner: ValueAxis) -> ValueAxis:
        """The axis that applies ``inner`` and then this one."""
        if self.is_plain:
            return inner
        return ValueAxis(self.slope * inner.slope, self.slope * inner.offset + self.offset)

    def turned(self, dtype: np.dtype) -> ValueAxis:
        """The axis that gives voxels mirrored by ``turned`` the same values."""
        if dtype.kind == "f":
            return ValueAxis(-self.slope, self.offset)
        return ValueAxis(-self.slope, self.offset + self.slope * _mirror(dtype))


def turned(stored: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """``stored`` numbers of voxels of ``dtype`` in reverse order: -x for floats, 255 - x for uint8, -1 - x for int8.

    The function is its own inverse. ``stored`` may have another type than the voxels (statistics).
    """
    if dtype.kind == "f":
        return -stored
    if stored.dtype == dtype:
        return np.invert(stored)
    return _mirror(dtype) - stored


def _mirror(dtype: np.dtype) -> float:
    limits = np.iinfo(dtype)
    return float(limits.min + limits.max)
