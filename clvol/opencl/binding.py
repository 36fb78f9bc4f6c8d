"""pyopencl, without the caches of its own.

They lie in the user's cache folder, and pyopencl fails where that cannot be written, is full, damaged
or locked by another process. Programs are kept by :mod:`clvol.opencl.program_store` instead; what is
lost is a file of generated Python functions, which are made faster than they are read.
"""

from __future__ import annotations

import os

from clvol.errors import DeviceError

_VARIABLE = "PYOPENCL_NO_CACHE"
_said = os.environ.get(_VARIABLE)
os.environ[_VARIABLE] = "1"
try:
    import pyopencl as cl
except ImportError as error:
    raise DeviceError(
        "pyopencl", f"cannot be loaded ({error})", "a working installation of it"
    ) from None
finally:
    if _said is None:
        del os.environ[_VARIABLE]
    else:
        os.environ[_VARIABLE] = _said
cl._PYOPENCL_NO_CACHE = True  # where somebody imported it before us

__all__ = ["cl"]
