"""What the caller says about a file beside its path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ReadOptions:
    """``dims`` (nx, ny, nz), ``dtype``, ``header_bytes`` (-1: the voxels end the file) and
    ``byte_order`` ("little", "big") for .raw; ``spacing`` or None; cap in bytes or None."""

    dims: Sequence[int] | None = None
    dtype: str | np.dtype | None = None
    spacing: Sequence[float] | None = None
    memory_cap: int | None = None
    header_bytes: int | None = None
    byte_order: str | None = None
