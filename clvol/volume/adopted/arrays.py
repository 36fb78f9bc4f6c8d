"""Arrays without a grid: in chunks (dask, h5py, netCDF4, tensorstore), and of other memory (DLPack)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clvol.volume.adopted.facts import Adopted, name_of, refused
from clvol.volume.memory import check_memory


def adopt_chunked(value: Any) -> Adopted:
    """All voxels of an array that is read, or computed, in chunks."""
    return Adopted(voxels_of(value))


def voxels_of(value: Any) -> np.ndarray:
    """The voxels of a lazy array; VolumeError if they do not fit into memory, or if it is no array."""
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if not isinstance(shape, tuple) or dtype is None or not hasattr(value, "__getitem__"):
        raise refused(f"a {name_of(value)}", "one of the arrays in it: group['name']")
    kind = getattr(dtype, "numpy_dtype", dtype)
    if all(isinstance(n, (int, np.integer)) for n in shape) and len(shape) == 3:
        check_memory("volume", math.prod(int(n) for n in shape) * np.dtype(kind).itemsize, None)
    if hasattr(value, "compute"):  # dask
        return value.compute()
    found = value[...]
    if isinstance(found, np.ma.MaskedArray):  # netCDF4: numpy's masked arrays are refused by Volume
        return found
    return np.asarray(found)


def adopt_dlpack(value: Any) -> Adopted:
    """A tensor in memory of the host (torch, jax, cupy, ...), which is shared."""
    try:
        return Adopted(np.from_dlpack(value))
    except (BufferError, TypeError, RuntimeError, ValueError, AttributeError) as error:
        device = getattr(value, "device", None)
        on = f" on {device}" if device is not None and "cpu" not in str(device).lower() else ""
        reason = "" if on else f" ({' '.join(str(error).split())[:120]})"
        hint = "memory of the host: x.cpu() or x.get()" if on else "an array of the host: numpy.asarray(x)"
        if getattr(value, "requires_grad", False):
            hint = "a tensor without gradients: x.detach()"
        raise refused(f"a {name_of(value)}{on}{reason}", hint) from None
