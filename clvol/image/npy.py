"""NumPy files: ``rgba``, float32 [height, width, 4], linear, premultiplied; and after it, as
``numpy.save`` appends further arrays to a file, a second one: what the picture says about itself,
JSON as uint8 [n]. ``numpy.load`` gives the first.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError
from clvol.image.about import facts
from clvol.image.limits import RGBA_BYTES, check_picture

_LARGEST_FACTS = 256 << 20
_ALIGNED = 64  # bytes: numpy's headers are, and so is our second array's length


def write(frame: Any, rgba: np.ndarray, path: Path) -> None:
    """Write ``rgba`` to ``path``; OSError when that fails."""
    array = np.ascontiguousarray(rgba, dtype="<f4")
    text = json.dumps(facts(frame, held(rgba, None)))
    said = np.frombuffer(text.ljust(-(-len(text) // _ALIGNED) * _ALIGNED).encode(), np.uint8)
    with open(path, "wb") as file:
        # Not numpy.save: it appends an ending of its own, and hides why a write failed.
        for part in (array, said):
            header = np.lib.format.header_data_from_array_1_0(part)
            np.lib.format.write_array_header_1_0(file, header)
            file.write(part.data)


def held(rgba: np.ndarray, depth: np.ndarray | None) -> list[np.ndarray]:
    """What the file holds of a picture."""
    return [rgba]


def read(path: str, memory_cap: int | None = None) -> tuple[np.ndarray, None, dict[str, Any]]:
    """``rgba`` as in the file, no depth, and what the file says about itself, with ``has_alpha``.
    Three channels mean opaque."""
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if (not isinstance(array, np.memmap) or array.ndim != 3 or array.shape[2] not in (3, 4)
            or 0 in array.shape or array.dtype.kind != "f"):
        kind = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else "an archive"
        raise UsageError(path, f"the array is {kind}", "floats [height, width, 4]")
    height, width, channels = array.shape
    # A mapped file takes memory, too, as it is read.
    nbytes = height * width * (RGBA_BYTES + channels * array.dtype.itemsize)
    check_picture(path, width, height, nbytes, memory_cap)
    rgba = np.ones((height, width, 4), dtype=np.float32)
    with np.errstate(over="ignore"):  # of float64 beyond float32's range
        rgba[..., :channels] = array
    header = _facts(path, array.offset + array.nbytes)
    return rgba, None, header | {"has_alpha": channels == 4}


def _facts(path: str, start: int) -> dict[str, Any]:
    """What follows the picture; nothing where another tool has written it."""
    with open(path, "rb") as file:
        if not 0 < os.fstat(file.fileno()).st_size - start <= _LARGEST_FACTS:
            return {}
        file.seek(start)
        try:
            said = np.lib.format.read_array(file, allow_pickle=False)
            known = json.loads(said.tobytes()) if said.dtype == np.uint8 else {}
        except (ValueError, MemoryError, OSError, RecursionError):
            return {}
    return known if isinstance(known, dict) else {}
