"""NumPy files of two arrays, one after the other.

The first is ``rgba``, float32 [height, width, 4], linear, premultiplied, and the second the picture's metadata, JSON
as uint8 [n]. ``numpy.load`` returns the first array.
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
_ALIGNED = 64  # bytes, the alignment of numpy's headers; the second array's length is a multiple of it


def write(frame: Any, rgba: np.ndarray, path: Path) -> None:
    """Writes ``rgba`` to ``path``. Raises OSError when that fails."""
    array = np.ascontiguousarray(rgba, dtype="<f4")
    text = json.dumps(facts(frame, held(rgba, None), path))
    metadata = np.frombuffer(text.ljust(-(-len(text) // _ALIGNED) * _ALIGNED).encode(), np.uint8)
    with open(path, "wb") as file:
        # numpy.save would append an ending of its own, and hide why a write failed.
        for part in (array, metadata):
            header = np.lib.format.header_data_from_array_1_0(part)
            np.lib.format.write_array_header_1_0(file, header)
            file.write(part.data)


def held(rgba: np.ndarray, depth: np.ndarray | None) -> list[np.ndarray]:
    """The arrays of a picture that the file stores."""
    return [rgba]


def read(path: str, memory_cap: int | None = None) -> tuple[np.ndarray, None, dict[str, Any]]:
    """``rgba`` as it is stored (opaque if it has three channels), no depth, and the metadata, to which ``has_alpha`` is
    added."""
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if (not isinstance(array, np.memmap) or array.ndim != 3 or array.shape[2] not in (3, 4)
            or 0 in array.shape or array.dtype.kind != "f"):
        kind = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else "an archive"
        raise UsageError(path, f"the array is {kind}", "floats [height, width, 4]")
    height, width, channels = array.shape
    # Reading a mapped file takes memory, too.
    nbytes = height * width * (RGBA_BYTES + channels * array.dtype.itemsize)
    check_picture(path, width, height, nbytes, memory_cap)
    rgba = np.ones((height, width, 4), dtype=np.float32)
    with np.errstate(over="ignore"):  # float64 values may exceed the range of float32
        rgba[..., :channels] = array
    header = _facts(path, array.offset + array.nbytes)
    return rgba, None, header | {"has_alpha": channels == 4}


def _facts(path: str, start: int) -> dict[str, Any]:
    """The metadata after the picture; empty if another tool has written the file."""
    with open(path, "rb") as file:
        if not 0 < os.fstat(file.fileno()).st_size - start <= _LARGEST_FACTS:
            return {}
        file.seek(start)
        try:
            array = np.lib.format.read_array(file, allow_pickle=False)
            found = json.loads(array.tobytes()) if array.dtype == np.uint8 else {}
        except (ValueError, MemoryError, OSError, RecursionError):
            return {}
    return found if isinstance(found, dict) else {}
