"""NumPy's .npy: one array [z, y, x], mapped into memory, never unpickled."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.options import ReadOptions
from clvol.volume.memory import check_memory
from clvol.volume.narrow import WIDE_TYPES
from clvol.volume.volume import Volume, check_type


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a .npy file, with a spacing of 1 and its first voxel at the origin.

    A C-ordered native array is mapped; any other is copied. An array of four axes [t, z, y, x] is one of times only
    where ``options.time`` says so: nothing in the file does.
    """
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if not isinstance(array, np.memmap):
        if hasattr(array, "close"):
            array.close()
        raise VolumeError(str(path), "not a .npy array (an .npz archive?)", "one array")
    native = check_type(array.dtype, str(path))
    stored = path.stat().st_size
    if array.size and array.offset + array.nbytes != stored:
        what = f"{stored - array.offset} bytes of voxel data"
        raise VolumeError(str(path), what, f"{array.nbytes} bytes as the header promises")
    if array.ndim == 4 and options.time is None:
        expected = 'a 3-D array [z, y, x], or volume.time = "all" (or the index of one) if the first axis is time'
        raise VolumeError(str(path), "a 4-D array", expected)
    if array.ndim == 4:
        array = array[options.choose("time", str(path), [None] * len(array))]
    mapped = array.flags.c_contiguous and array.dtype.isnative and native.name not in WIDE_TYPES
    check_memory(str(path), array.nbytes, options.memory_cap, mapped=mapped)
    return Volume(array)
