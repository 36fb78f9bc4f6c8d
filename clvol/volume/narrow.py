"""Lossless conversion of integers of 32 and 64 bits, and of float16, to the types that volumes can have.

It is the same for all readers and for arrays: ``check_type`` accepts these types, and the constructor of ``Volume``
narrows them. While a file is read, the context ``narrowing`` holds the settings of the ``load_volume`` call, so that
readers need not pass them on.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.memory import check_memory

WIDE_TYPES = ("int32", "uint32", "int64", "uint64", "float16")
LARGEST_LABEL = 2**53  # beyond it float64 does not hold every whole number
_NARROW = ("uint8", "int8", "uint16", "int16")
_BLOCK = 1 << 20  # voxels that are examined together
_EXACT = (
    "numbers that float64 holds exactly; array.astype('float64') rounds them, and label maps are "
    "numbered anew by numpy.unique(array, return_inverse=True)"
)


@dataclass(frozen=True)
class Narrowing:
    """How wide voxels are narrowed.

    ``memory_cap``: bytes that wide and narrowed voxels may take together, None as for ``check_memory``. ``labels``:
    numbers beyond +-2^53 may become +-2^53, since no scene can name them.
    """

    memory_cap: int | None = None
    labels: bool = False


_current: ContextVar[Narrowing] = ContextVar("narrowing", default=Narrowing())


def current_narrowing() -> Narrowing:
    """The settings of the innermost ``narrowing`` context."""
    return _current.get()


@contextmanager
def narrowing(how: Narrowing) -> Iterator[None]:
    """A context in which voxels are narrowed according to ``how``."""
    token = _current.set(how)
    try:
        yield
    finally:
        _current.reset(token)


def narrowed(array: np.ndarray, where: str, how: Narrowing | None = None) -> np.ndarray:
    """``array`` (native type); a wide type is converted to the smallest type that holds every value exactly.

    The types are uint8, int8, uint16, int16, float32 and float64. Raises VolumeError if none of them does, or if wide
    and narrowed voxels together exceed the memory cap.
    """
    if array.dtype.name not in WIDE_TYPES:
        return array
    how = how or current_narrowing()
    flat = array.reshape(-1)  # readers' arrays are contiguous; others are copied here
    blocks = (flat[start : start + _BLOCK] for start in range(0, flat.size, _BLOCK))
    dtype = exact_type(array.dtype, blocks, where, how)
    held = 0 if how.memory_cap is None else array.nbytes
    check_memory(where, held + array.size * dtype.itemsize, how.memory_cap)
    out = np.empty(array.shape, dtype)
    target = out.reshape(-1)
    for start in range(0, flat.size, _BLOCK):
        block = slice(start, start + _BLOCK)
        target[block] = cast(flat[block], dtype, how)
    return out


def exact_type(
    wide: np.dtype, blocks: Iterable[np.ndarray], where: str, how: Narrowing
) -> np.dtype:
    """The type for voxels of type ``wide``. ``blocks`` yields all of them."""
    if wide.kind == "f":
        return np.dtype(np.float32)
    low, high, in_float32, in_float64 = 0, 0, True, True
    first = True
    for block in blocks:
        if not block.size:
            continue
        least, most = int(block.min()), int(block.max())
        low, high = (least, most) if first else (min(low, least), max(high, most))
        first = False
        if max(-least, most) > 2**24 and in_float32:
            in_float32 = _holds(block, np.float32)
        if max(-least, most) > LARGEST_LABEL and in_float64:
            in_float64 = _holds(block, np.float64)
    for name in _NARROW:
        limits = np.iinfo(name)
        if limits.min <= low and high <= limits.max:
            return np.dtype(name)
    if in_float32 and in_float64:
        return np.dtype(np.float32)
    if in_float64 or how.labels:
        return np.dtype(np.float64)
    raise VolumeError(where, f"{wide.name} voxels from {low} to {high}", _EXACT)


def cast(block: np.ndarray, dtype: np.dtype, how: Narrowing) -> np.ndarray:
    """``block`` in the type that ``exact_type`` returned."""
    if how.labels and dtype == np.float64 and block.dtype.kind in "iu":
        low = -LARGEST_LABEL if block.dtype.kind == "i" else 0
        most = np.iinfo(block.dtype).max
        if most > LARGEST_LABEL:
            block = block.clip(low, LARGEST_LABEL)
    return block.astype(dtype)


def _holds(block: np.ndarray, kind: type) -> bool:
    """Whether every integer of ``block`` survives a round trip through the floating-point type ``kind``."""
    as_float = block.astype(kind).astype(np.float64)
    limits = np.iinfo(block.dtype)
    inside = (as_float >= float(limits.min)) & (as_float < float(limits.max + 1))
    if not inside.all():  # rounded up beyond the type
        return False
    return bool(np.array_equal(as_float.astype(block.dtype), block))
