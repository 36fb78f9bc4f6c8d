"""pyopencl, imported when it is first used, and without its own caches.

Importing clvol makes no OpenCL call and loads no OpenCL library: ``cl`` stands for the module pyopencl,
which is imported when one of its attributes is first accessed.

pyopencl's caches lie in the user's cache folder, and pyopencl fails where that cannot be written, is full, damaged
or locked by another process. Programs are kept by :mod:`clvol.opencl.program_store` instead. The only
loss is a file of generated Python functions, which are generated faster than they are read.
"""

from __future__ import annotations

import os
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any

from clvol.errors import DeviceError

_VARIABLE = "PYOPENCL_NO_CACHE"


@cache
def load_pyopencl() -> ModuleType:
    """The module pyopencl; DeviceError where it cannot be loaded."""
    before = os.environ.get(_VARIABLE)
    os.environ[_VARIABLE] = "1"
    try:
        import pyopencl
    except ImportError as error:
        raise DeviceError(
            "pyopencl", f"cannot be loaded ({error})", "a working installation of it"
        ) from None
    finally:
        if before is None:
            del os.environ[_VARIABLE]
        else:
            os.environ[_VARIABLE] = before
    pyopencl._PYOPENCL_NO_CACHE = True  # in case it was imported before clvol
    return pyopencl


class _WhenUsed:
    """A module that is imported when one of its attributes is first accessed."""

    def __getattr__(self, name: str) -> Any:
        return getattr(load_pyopencl(), name)


if TYPE_CHECKING:
    import pyopencl as cl
else:
    cl = _WhenUsed()

__all__ = ["cl", "load_pyopencl"]
