"""Ends the process of the command with its own exit status, whatever OpenCL libraries do at exit.

When a process exits, its libraries are unloaded, and some OpenCL libraries crash, hang or print messages then, so
that a picture that was written correctly would count as a failure. The process therefore exits without unloading
them, once Python has done everything that it does at exit.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
import threading
from typing import NoReturn

from clvol.cli import main
from clvol.limits import keep_room_to_import


def command_line() -> NoReturn:
    """Runs the command ``clvol``, and ends the process."""
    # OpenBLAS, which numpy uses, starts one thread per core when it is loaded, and ends the process if that many are
    # not allowed (ulimit -u). No matrix here is large enough to need a second thread.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Plug-ins of other packages have no part in the scene's tables; looking for them takes 8 ms.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    keep_room_to_import()
    # A tenth of the time of a small picture went into looking for cycles among what imports had just made.
    gc.set_threshold(10_000)
    leave(main())


def leave(status: int) -> NoReturn:
    """Ends the process with ``status``; without unloading libraries if OpenCL ones are loaded."""
    if "pyopencl" not in sys.modules:
        sys.exit(status)
    try:
        for thread in threading.enumerate():  # as Python itself would wait for them
            if thread is not threading.current_thread() and not thread.daemon:
                thread.join()
        atexit._run_exitfuncs()
    except BaseException:  # it is reported on stderr, and the work is done
        pass
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):  # its reader has gone away
            pass
    os._exit(status)
