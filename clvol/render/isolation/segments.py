"""Memory that processes share. It has no name, so that nothing is left of it however they end."""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Sequence
from itertools import count
from typing import Any

import numpy as np

from clvol.errors import RenderError

_numbers = count(1)
_KEPT = 8  # arrays of earlier pictures


class Segment:
    """``nbytes`` of memory, which begin at a page. ``number`` is its name in messages."""

    def __init__(self, nbytes: int) -> None:
        self.nbytes, self.number = max(nbytes, 1), next(_numbers)
        try:
            self.descriptor = _anonymous_file(self.nbytes)
            self._map = mmap.mmap(self.descriptor, self.nbytes)
        except OSError as error:
            what = f"no shared memory for {nbytes} bytes ({error.strerror})"
            raise RenderError("isolate", what, "more memory, or devices in this process") from None

    def __del__(self) -> None:
        descriptor = getattr(self, "descriptor", None)
        if descriptor is not None:
            os.close(descriptor)

    def array(self, dtype: Any, shape: Sequence[int]) -> np.ndarray:
        return np.frombuffer(self._map, dtype, int(np.prod(shape, dtype=np.int64))).reshape(shape)


def _anonymous_file(nbytes: int) -> int:
    """A descriptor of memory without a name: not of /dev/shm, which is small in many containers."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("clvol", os.MFD_CLOEXEC)
        os.ftruncate(descriptor, nbytes)
        return descriptor
    with tempfile.TemporaryFile() as file:
        os.posix_fallocate(file.fileno(), 0, nbytes)
        return os.dup(file.fileno())


class SharedArray(np.ndarray):
    """An array in a ``segment``."""

    segment: Segment


def shared_memory_array(shape: Sequence[int], dtype: Any) -> SharedArray:
    dtype = np.dtype(dtype)
    segment = Segment(int(np.prod(shape, dtype=np.int64)) * dtype.itemsize)
    made = segment.array(dtype, shape).view(SharedArray)
    made.segment = segment
    return made


class PictureMemory:
    """Arrays for pictures, used again for later ones (``device_group.Arrays``)."""

    def __init__(self) -> None:
        self._free: list[SharedArray] = []

    def make(self, shape: Sequence[int], dtype: Any) -> np.ndarray:
        for k, each in enumerate(self._free):
            if each.shape == tuple(shape) and each.dtype == dtype:
                return self._free.pop(k)
        return shared_memory_array(shape, dtype)

    def taken(self, array: np.ndarray) -> np.ndarray:
        """A copy that is the caller's own."""
        return np.array(array, subok=False)

    def release(self, arrays: Sequence[np.ndarray | None], still_used: bool) -> None:
        """``arrays`` are free for other pictures, unless a device may still write to them."""
        if not still_used:
            self._free += [each for each in arrays if isinstance(each, SharedArray)]
            del self._free[:-_KEPT]


def mapped(descriptor: int, nbytes: int, *, writable: bool, offset: int = 0) -> mmap.mmap:
    """The file of ``descriptor``, which is closed, as memory; without ``writable`` nobody here can change it."""
    start = offset - offset % mmap.ALLOCATIONGRANULARITY
    access = mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ
    try:
        return mmap.mmap(descriptor, nbytes + offset - start, access=access, offset=start)
    finally:
        os.close(descriptor)


def array_in(memory: mmap.mmap, dtype: Any, shape: Sequence[int], offset: int = 0) -> np.ndarray:
    """``offset``: that of the file, as for ``mapped``."""
    items = int(np.prod(shape, dtype=np.int64))
    return np.frombuffer(memory, dtype, items, offset % mmap.ALLOCATIONGRANULARITY).reshape(shape)
