"""OpenCL does not outlive fork(): its threads and locks stay behind, and the child would wait forever.

So a child that was forked after OpenCL was used gets an error at once, wherever it would use it.
"""

from __future__ import annotations

import os

from clvol.errors import DeviceError

_used = False
_forked = False
_watched = False


def opencl_used() -> None:
    """Called before the first OpenCL call of a process: children forked from now on are refused."""
    global _used, _watched
    check_fork()
    _used = True
    if not _watched and hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_after_fork)
        _watched = True


def check_fork() -> None:
    """DeviceError in a child that was forked after its parent had used OpenCL."""
    if _forked:
        raise DeviceError(
            "OpenCL",
            "the parent process used it before this process was forked, and it does not work in both",
            'a process started by "spawn" (multiprocessing.get_context("spawn")), or OpenCL used in '
            "the children alone",
        )


def is_forked() -> bool:
    """Whether this process is such a child."""
    return _forked


def _after_fork() -> None:
    global _forked
    _forked = _used
