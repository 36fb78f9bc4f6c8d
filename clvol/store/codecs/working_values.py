"""Working values: the integers of 16 bits in which vector-quantising codecs compute, whatever the type of voxels.

All arithmetic on working values is in integers, so encoders and decoders give the same bits on every device.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

WORKING_BITS = 16
LARGEST = (1 << WORKING_BITS) - 1
_EXACT = 1 << 24  # integers up to here are exact in float32


@dataclass(frozen=True)
class WorkingValues:
    """The map between voxels of one volume and working values 0 ... 65535.

    Voxels of integer types (``low`` ... ``low + span``): ``voxel = low + (w * (span + 1) >> 16)``; the working value
    of a voxel is the middle of those that decode to it.

    Floating-point voxels: ``voxel = float32(w + first) * scale``, where ``first`` and ``w + first`` are integers that
    float32 holds exactly, so that there is a single rounding. ``low`` and ``span`` are 0.

    ``dtype``: of decoded voxels; float32 for float64 volumes.
    """

    dtype: np.dtype
    low: int = 0
    span: int = 0
    first: int = 0
    scale: float = 1.0

    @property
    def is_float(self) -> bool:
        return self.dtype.kind == "f"

    def encoded(self, voxels: np.ndarray) -> np.ndarray:
        """int32, of the shape of ``voxels``. Voxels beyond the range are clipped; those that are not finite are 0."""
        if self.is_float:
            finite = np.where(np.isfinite(voxels), voxels, 0.0).astype(np.float64)
            return np.clip(np.rint(finite / self.scale) - self.first, 0, LARGEST).astype(np.int32)
        offset = np.clip(voxels.astype(np.int64) - self.low, 0, self.span)
        middle = (2 * offset + 1 << WORKING_BITS) // (2 * (self.span + 1))
        first = -(-(offset << WORKING_BITS) // (self.span + 1))  # of those that decode to the voxel; maybe the only one
        return np.maximum(middle, first).astype(np.int32)

    def decoded(self, working: np.ndarray) -> np.ndarray:
        """Voxels of ``dtype``; working values beyond 0 ... 65535 are clipped."""
        clipped = np.clip(working, 0, LARGEST).astype(np.uint32)
        if self.is_float:
            return (clipped.view(np.int32) + np.int32(self.first)).astype(np.float32) * np.float32(self.scale)
        clipped *= np.uint32(self.span + 1)  # at most 65535 * 65536, which 32 bits hold
        clipped >>= np.uint32(WORKING_BITS)
        return (clipped.view(np.int32) + np.int32(self.low)).astype(self.dtype)

    def to_json(self) -> dict[str, Any]:
        return {
            "dtype": self.dtype.name, "low": self.low, "span": self.span,
            "first": self.first, "scale": float(self.scale),
        }  # fmt: skip

    @classmethod
    def from_json(cls, own: dict) -> WorkingValues:
        """ValueError, KeyError or TypeError if these are not the parameters of a map."""
        dtype, scale = np.dtype(own["dtype"]), float(own["scale"])
        low, span, first = (int(own[key]) for key in ("low", "span", "first"))
        if not (0 <= span <= LARGEST and math.isfinite(scale) and scale > 0 and abs(first) < _EXACT):
            raise ValueError("working values")
        return cls(dtype, low, span, first, scale)


def working_values(dtype: np.dtype, value_range: tuple[float, float]) -> WorkingValues:
    """The map for voxels of ``dtype`` whose finite values lie in ``value_range``."""
    low, high = value_range
    if np.dtype(dtype).kind in "iu":
        return WorkingValues(np.dtype(dtype), int(low), int(high) - int(low))
    # The smallest scale for which all of w + first is exact in float32; float32 itself, so that decoders agree.
    largest = max(abs(low), abs(high))
    scale = max((high - low) / (LARGEST - 1), largest / (_EXACT - LARGEST - 2), float(np.finfo(np.float32).tiny))
    scale = float(np.nextafter(np.float32(scale), np.float32(np.inf)))
    return WorkingValues(np.dtype(np.float32), first=math.floor(low / scale), scale=scale)
