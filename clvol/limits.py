"""A limit on the memory of the process (``ulimit -v``, some batch systems) that libraries bear badly.

OpenBLAS, which numpy and scipy each bring along, reserves 32 MiB when it is loaded: where the limit has no room for
them it ends the process, or asks again for ever. Compilers of OpenCL crash or wait for ever. So where there is a
limit, room is looked for first. Without one nothing is done.
"""

from __future__ import annotations

import mmap
import sys
from importlib.abc import MetaPathFinder

from clvol.errors import RenderError

_ROOM_TO_IMPORT = 96 << 20  # OpenBLAS's pages, and what importing takes beside them
_ROOM_FOR_OPENCL = 800 << 20  # measured, for libraries and compilers: PoCL 3.1 760 MiB, Intel's 920
_ROOM_TO_COMPILE = 512 << 20  # once the libraries are there
_LIBRARIES = ("numpy", "scipy", "skimage", "matplotlib")


def keep_room_to_import() -> None:
    """From now on, importing a library for which there is no room raises
    :class:`clvol.errors.RenderError`."""
    if _limit() is not None:
        sys.meta_path.insert(0, _Guard())


def check_room_for_opencl(loaded: bool) -> None:
    """Raises :class:`clvol.errors.RenderError` if OpenCL programs cannot be compiled within the limit.

    ``loaded``: OpenCL libraries are there already.
    """
    _check(_ROOM_TO_COMPILE if loaded else _ROOM_FOR_OPENCL)


class _Guard(MetaPathFinder):
    """Finds no module; refuses the libraries for which there is no room."""

    def find_spec(self, name: str, path=None, target=None) -> None:
        if name.partition(".")[0] in _LIBRARIES:
            _check(_ROOM_TO_IMPORT)


def _check(room: int) -> None:
    limit = _limit()
    if limit is None:
        return
    try:
        mmap.mmap(-1, room).close()  # reserved and given back: no page of it is touched
    except (OSError, ValueError, OverflowError):
        what = f"not enough: the process may use {limit / 1e6:.0f} MB in all (ulimit -v)"
        raise RenderError("memory", what, "a limit of at least 2 GB, or none") from None


def _limit() -> int | None:
    try:
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    except (ImportError, OSError, ValueError):  # systems that have no such limit
        return None
    return None if limit == resource.RLIM_INFINITY else limit
