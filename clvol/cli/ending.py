"""How the process of the command ends: with its own exit status, whatever OpenCL libraries do then.

When a process ends, the libraries in it are unloaded, and some crash, hang or print while they are: a
picture that is written, and whole, would count as a failure. So once all is done that Python does at
the end, the process leaves without them.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
from typing import NoReturn

from clvol.cli import main
from clvol.limits import keep_room_to_import


def command_line() -> NoReturn:
    """The command ``clvol``, to the end of the process."""
    # numpy's library starts a thread a core when it is loaded, and ends the process where that many are not
    # allowed (ulimit -u). Nothing here multiplies matrices large enough for a second one.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    keep_room_to_import()
    leave(main())


def leave(status: int) -> NoReturn:
    """Ends the process with ``status``; for good if OpenCL libraries are loaded."""
    if "pyopencl" not in sys.modules:
        sys.exit(status)
    try:
        for thread in threading.enumerate():  # as Python waits for them
            if thread is not threading.current_thread() and not thread.daemon:
                thread.join()
        atexit._run_exitfuncs()
    except BaseException:  # told on stderr; the work is done
        pass
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):  # nobody listens any more
            pass
    os._exit(status)
