"""An orderly end when the process is told to stop, and no temporary file left whatever ends it.

The command (``clvol.cli``) turns the signals that ask a process to stop into an exception of the
main thread (``stoppable``), so that every ``finally`` runs. Python's callers keep the handlers that
they have. Temporary files are known here from before they exist (``expect_temporary``).

Imports little: a signal that comes before ``stoppable`` is Python's own affair.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Any

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU", "SIGUSR1", "SIGUSR2")
SIGNALS = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))
_GRACE = 20.0  # seconds for an orderly end; then the process ends at once
_AGAIN = 0.05  # seconds until a signal that got lost comes again
_SAME = 1.0  # seconds within which a second signal is the first one once more, sent twice

_temporaries: dict[str, int] = {}  # path to the process that made it


class Stopped(KeyboardInterrupt):
    """A signal asked the process to stop. ``status`` is 128 plus its number, as shells have it:
    130 for an interrupt, 143 for SIGTERM, 129 for SIGHUP."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.status = 128 + number
        super().__init__(self.line)

    @property
    def line(self) -> str:
        name = signal.Signals(self.number).name
        return "interrupted" if name == "SIGINT" else f"interrupted by {name}"


class _State:
    """What has been asked of this process, while ``stoppable`` is at work."""

    def __init__(self, finished: bool) -> None:
        self.held = 0  # blocks of ``held`` that the main thread is in
        self.first: int | None = None  # the signal that came first
        self.since = 0.0  # and when
        self.raised = False
        self.finished = finished


_state = _State(finished=True)


@contextmanager
def stoppable(for_good: bool = False) -> Iterator[None]:
    """Raises Stopped in the block, once, when the process is told to stop. A second signal, a second
    or more after the first, ends the process at once, and so does a block that has not come to its
    end 20 s after the first; temporary files are removed even then. Signals that are ignored
    (nohup) stay so.

    ``for_good``: the process ends after the block, and signals come too late from then on. Outside
    the main thread, where no signal arrives, nothing is done.
    """
    global _state
    if not _is_main():
        yield
        return
    _state = state = _State(finished=False)
    before = {}
    watched, watch = os.pipe()
    os.set_blocking(watch, False)
    wakeup = signal.set_wakeup_fd(watch, warn_on_full_buffer=False)
    hook, sys.unraisablehook = sys.unraisablehook, _unraisable
    try:
        for number in SIGNALS:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, _stop)
        threading.Thread(target=_watch, args=(watched, state), daemon=True).start()
        yield
    finally:
        state.finished = True
        discard_temporaries()
        signal.set_wakeup_fd(wakeup)
        os.close(watch)  # which ends the thread
        if not for_good:
            sys.unraisablehook = hook
        for number, handler in () if for_good else before.items():
            signal.signal(number, handler)


def check_stopped() -> None:
    """Raises Stopped again, if it was raised and something has made another exception of it: the
    import of a library written in C, for one."""
    if _state.raised and not _state.finished and _state.first is not None:
        raise Stopped(_state.first)


@contextmanager
def held() -> Iterator[None]:
    """A signal that arrives in the block takes effect at its end: for what must not be done by
    halves, and is quick."""
    if not _is_main():
        yield
        return
    _state.held += 1
    try:
        yield
    finally:
        _state.held -= 1
        _raise()


def expect_temporary(path: str | os.PathLike) -> None:
    """``path`` is about to be made, and must not outlive this process."""
    _temporaries[os.fspath(path)] = os.getpid()


def forget_temporary(path: str | os.PathLike) -> None:
    """``path`` is gone, or has its own name."""
    _temporaries.pop(os.fspath(path), None)


def discard_temporaries() -> None:
    """Removes those that this process (not its parent) has made and are still there."""
    for path, process in list(_temporaries.items()):
        if process == os.getpid():
            try:
                os.unlink(path)
            except OSError:
                pass
            _temporaries.pop(path, None)


def _is_main() -> bool:
    return threading.current_thread() is threading.main_thread()


def _stop(number: int, _frame: object) -> None:
    now = time.monotonic()
    if _state.finished:
        return
    if _state.first is None:
        _state.first, _state.since = number, now
    elif _state.raised and now - _state.since > _SAME:
        _end_at_once(_state.first)
    _raise()


def _unraisable(told: Any) -> None:
    """Where Python cannot raise (in a destructor, say) it would print Stopped and forget it: instead
    it is raised again a moment later."""
    if not isinstance(told.exc_value, Stopped):
        sys.__unraisablehook__(told)
    elif not _state.finished:
        _state.raised = False
        main = threading.main_thread().ident
        threading.Timer(_AGAIN, signal.pthread_kill, (main, told.exc_value.number)).start()


def _raise() -> None:
    if _state.first is not None and not (_state.held or _state.raised or _state.finished):
        _state.raised = True
        raise Stopped(_state.first)


def _watch(descriptor: int, state: _State) -> None:
    """Ends the process where the main thread does not: in a library that does not return."""
    try:
        while told := os.read(descriptor, 1):
            deadline = time.monotonic() + _GRACE
            while told[0] in SIGNALS and not state.finished:
                time.sleep(0.1)
                if time.monotonic() > deadline:
                    _end_at_once(told[0])
    finally:
        os.close(descriptor)


def _end_at_once(number: int) -> None:
    discard_temporaries()
    try:
        os.write(2, f"clvol: error: {Stopped(number).line}\n".encode())
    except OSError:
        pass
    os._exit(128 + number)
