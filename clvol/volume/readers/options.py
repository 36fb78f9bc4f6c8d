"""What the caller says about a file beside its path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ReadOptions:
    """``dims`` (nx, ny, nz) and ``dtype`` for .raw; ``spacing`` or None; cap in bytes or None."""

    dims: Sequence[int] | None = None
    dtype: str | np.dtype | None = None
    spacing: Sequence[float] | None = None
    memory_cap: int | None = None
