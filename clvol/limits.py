"""Checks against a limit on the memory of the process (``ulimit -v``, some batch systems).

Libraries handle such a limit badly. OpenBLAS, of which numpy and scipy each ship a copy, reserves 32 MiB when it is
loaded; if the limit does not allow that, it ends the process or retries forever. OpenCL compilers crash or hang. So
if there is a limit, the memory that a library needs is reserved and released before the library is loaded. Without a
limit nothing is checked.
"""

from __future__ import annotations

import mmap
import sys
from importlib.abc import MetaPathFinder

from clvol.errors import RenderError

_ROOM_TO_IMPORT = 96 << 20  # the pages of OpenBLAS, and what else an import needs
_ROOM_FOR_OPENCL = 800 << 20  # measured with libraries and compilers: 760 MiB with PoCL 3.1, 920 MiB with Intel's
_ROOM_TO_COMPILE = 512 << 20  # once the libraries are loaded
_LIBRARIES = ("numpy", "scipy", "skimage", "matplotlib")


def keep_room_to_import() -> None:
    """Makes the import of a library raise :class:`clvol.errors.RenderError` if the limit leaves no room for it."""
    if _limit() is not None:
        sys.meta_path.insert(0, _Guard())


def check_room_for_opencl(loaded: bool) -> None:
    """Raises :class:`clvol.errors.RenderError` if OpenCL programs cannot be compiled within the limit.

    ``loaded``: whether the OpenCL libraries are loaded already.
    """
    _check(_ROOM_TO_COMPILE if loaded else _ROOM_FOR_OPENCL)


class _Guard(MetaPathFinder):
    """An import hook that finds no module, but refuses libraries for which there is no room."""

    def find_spec(self, name: str, path=None, target=None) -> None:
        if name.partition(".")[0] in _LIBRARIES:
            _check(_ROOM_TO_IMPORT)


def _check(room: int) -> None:
    limit = _limit()
    if limit is None:
        return
    try:
        mmap.mmap(-1, room).close()  # reserved and released; no page of it is touched
    except (OSError, ValueError, OverflowError):
        what = f"not enough: the process may use {limit / 1e6:.0f} MB in all (ulimit -v)"
        raise RenderError("memory", what, "a limit of at least 2 GB, or none") from None


def _limit() -> int | None:
    try:
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    except (ImportError, OSError, ValueError):  # the system has no such limit
        return None
    return None if limit == resource.RLIM_INFINITY else limit
