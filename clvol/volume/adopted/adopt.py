"""Recognising objects of other libraries by the module of their class, or by an array protocol."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from clvol.volume.adopted.facts import Adopted, name_of, refused

# By the first part of the module of the object's class, or of a class that it inherits from: the module of this package
# and its function.
_BY_LIBRARY = {
    "xarray": ("labelled", "adopt_xarray"),
    "SimpleITK": ("medical", "adopt_simpleitk"),
    "itk": ("medical", "adopt_itk"),
    "nibabel": ("medical", "adopt_nibabel"),
    "vtkmodules": ("vtk_image", "adopt_vtk"),
    "zarr": ("labelled", "adopt_zarr"),
    "dask": ("arrays", "adopt_chunked"),
    "h5py": ("arrays", "adopt_chunked"),
    "netCDF4": ("arrays", "adopt_chunked"),
    "tensorstore": ("arrays", "adopt_chunked"),
}
EXPECTED = (
    "an array [z, y, x] of numpy, or an object of xarray, SimpleITK, nibabel, VTK, pyvista, zarr, dask, h5py or DLPack"
)


def adopt(value: Any) -> Adopted | None:
    """What ``value`` says about itself; None for an array of numpy, and what numpy makes one of (a list).

    VolumeError, which says what to write instead, for what is no volume.
    """
    if isinstance(value, (np.ndarray, list, tuple)):
        return None
    if isinstance(value, (str, os.PathLike)):
        path = os.fspath(value)
        raise refused(f"a path, {str(path)!r}"[:200], f"an array; clvol.load_volume({str(path)!r}) reads a file"[:200])
    library = _library_of(value)
    if library is not None:
        return _adopted(*_BY_LIBRARY[library], value)
    if isinstance(value, Mapping):
        raise refused("a dict", f"{EXPECTED}; a table of a scene goes into clvol.Scene(volume={{...}})")
    if hasattr(value, "__dlpack__"):
        return _adopted("arrays", "adopt_dlpack", value)
    if any(hasattr(value, name) for name in ("__array__", "__array_interface__", "__array_struct__")):
        return None
    try:
        memoryview(value).release()
    except (TypeError, BufferError, ValueError):
        what = "None" if value is None else f"an object of type {name_of(value)}"
        raise refused(what, EXPECTED) from None
    return None


def _adopted(module: str, function: str, value: Any) -> Adopted:
    """Imported where it is used, since most volumes are files."""
    return getattr(import_module(f"{__package__}.{module}"), function)(value)


def is_array_like(value: Any) -> bool:
    """Whether ``Volume(value)`` may work: ``value`` is an array, or an object that ``adopt`` knows."""
    if isinstance(value, np.ndarray) or _library_of(value) is not None:
        return True
    return any(hasattr(type(value), name) for name in ("__dlpack__", "__array__", "__array_interface__"))


def _library_of(value: Any) -> str | None:
    for base in type(value).__mro__:
        root = base.__module__.partition(".")[0]
        if root in _BY_LIBRARY:
            return root
    return None
