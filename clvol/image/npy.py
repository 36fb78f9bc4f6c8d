"""NumPy files: ``rgba`` alone, float32 [height, width, 4], linear, premultiplied."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError


def write(frame: Any, rgba: np.ndarray, path: Path) -> None:
    """Write ``rgba`` to ``path``; OSError when that fails."""
    array = np.ascontiguousarray(rgba, dtype="<f4")
    with open(path, "wb") as file:
        # Not numpy.save: it appends an ending of its own, and hides why a write failed.
        np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(array))
        file.write(array.data)


def read(path: str) -> tuple[np.ndarray, None, dict[str, Any]]:
    """``rgba`` as in the file, no depth, an empty header. Three channels mean opaque."""
    array = np.load(path, allow_pickle=False)
    if (not isinstance(array, np.ndarray) or array.ndim != 3 or array.shape[2] not in (3, 4)
            or 0 in array.shape or array.dtype.kind != "f"):
        kind = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else "an archive"
        raise UsageError(path, f"the array is {kind}", "floats [height, width, 4]")
    rgba = np.ones((*array.shape[:2], 4), dtype=np.float32)
    rgba[..., : array.shape[2]] = array
    return rgba, None, {}
