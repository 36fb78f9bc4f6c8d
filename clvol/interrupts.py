"""Ends the process in an orderly way when a signal arrives, and removes its temporary files however it ends.

The command (``clvol.cli``) turns the signals that request a process to stop into an exception of the main thread
(``stoppable``), so that every ``finally`` runs. When clvol is used as a library, the caller's signal handlers stay.
Temporary files are registered before they are created (``expect_temporary``).

This module imports little, because Python's own handlers apply until ``stoppable`` is entered.
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
_AGAIN = 0.05  # seconds until a lost signal is sent again
_SAME = 1.0  # seconds within which a second signal counts as a duplicate of the first
_CAN_WAIT = hasattr(signal, "sigtimedwait") and hasattr(signal, "SIGURG")
_WAKE = signal.SIGURG if _CAN_WAIT else None  # tells a thread of this process to look; ignored by default

_temporaries: dict[str, int] = {}  # path -> id of the process that created it


class Stopped(KeyboardInterrupt):
    """A signal requested that the process stop. ``status`` is 128 plus the signal's number, as in shells:
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
    """The signals that this process has received inside ``stoppable``."""

    def __init__(self, finished: bool) -> None:
        self.held = 0  # number of ``held`` blocks that the main thread is in
        self.first: int | None = None  # the first signal
        self.since = 0.0  # when it arrived (time.monotonic)
        self.raised = False
        self.finished = finished
        self.watcher: int | None = None  # the thread that waits for signals


_state = _State(finished=True)


@contextmanager
def stoppable(for_good: bool = False) -> Iterator[None]:
    """Raises Stopped in the block, once, when a signal requests that the process stop.

    A second signal that arrives at least a second after the first ends the process at once, and so does a block that
    is still running 20 s after the first signal; temporary files are removed even then. Signals that are ignored
    (nohup) stay ignored.

    The signals are blocked, and a thread waits for them: compilers inside drivers (LLVM) install handlers of their
    own while they run, which reset themselves to the default action when called, so that a second signal could end
    the process on the spot. Threads that were started before do not block the signals; for them there are handlers.

    ``for_good``: the process ends after the block, so handlers and mask are not restored. Outside the main thread,
    which receives all signals, this does nothing.
    """
    global _state
    if not _is_main():
        yield
        return
    _state = state = _State(finished=False)
    before: dict[int, Any] = {}
    hook, sys.unraisablehook = sys.unraisablehook, _unraisable
    watcher = None
    try:
        numbers = [number for number in SIGNALS if signal.getsignal(number) not in (signal.SIG_IGN, None)]
        if _WAKE is not None:
            before[_WAKE] = signal.signal(_WAKE, _woken)
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, [*numbers, _WAKE])
        for number in numbers:
            before[number] = signal.signal(number, _stop)
        if _WAKE is not None:
            watcher = threading.Thread(target=_watch, args=(numbers, state), daemon=True)
            watcher.start()  # with _WAKE blocked
            state.watcher = watcher.ident
            signal.pthread_sigmask(signal.SIG_UNBLOCK, [_WAKE])
        yield
    finally:
        state.finished = True
        discard_temporaries()
        if watcher is not None and state.watcher is not None:
            signal.pthread_kill(state.watcher, signal.SIGURG)
            watcher.join()
        if not for_good:
            sys.unraisablehook = hook
            if _WAKE is not None:
                _discard_pending(numbers)
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            for number, handler in before.items():
                signal.signal(number, handler)


def check_stopped() -> None:
    """Raises Stopped again if it was raised but replaced by another exception, as importing a C extension may do."""
    if _state.raised and not _state.finished and _state.first is not None:
        raise Stopped(_state.first)


@contextmanager
def held() -> Iterator[None]:
    """Delays signals that arrive in the block until its end. Use it for short work that must not be interrupted."""
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
    """Registers ``path``, which is about to be created and must not outlive this process."""
    _temporaries[os.fspath(path)] = os.getpid()


def forget_temporary(path: str | os.PathLike) -> None:
    """Unregisters ``path``, which was removed or renamed to its final name."""
    _temporaries.pop(os.fspath(path), None)


def discard_temporaries() -> None:
    """Removes the registered files that this process (not its parent) created and that still exist."""
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
    """Handles a signal that reached a thread that does not block it."""
    _arrived(_state, number)
    if _state.watcher is not None and not _state.finished:
        signal.pthread_kill(_state.watcher, signal.SIGURG)  # so that it begins to count
    _raise()


def _woken(_number: int, _frame: object) -> None:
    _raise()


def _arrived(state: _State, number: int) -> None:
    now = time.monotonic()
    if state.finished:
        return
    if state.first is None:
        state.first, state.since = number, now
    elif state.raised and now - state.since > _SAME:
        _end_at_once(state.first)


def _unraisable(report: Any) -> None:
    """Sends the signal again a moment later if Stopped occurred where Python cannot raise (in a destructor, say),
    where it would only be printed."""
    if not isinstance(report.exc_value, Stopped):
        sys.__unraisablehook__(report)
    elif not _state.finished:
        _state.raised = False
        threading.Timer(_AGAIN, os.kill, (os.getpid(), report.exc_value.number)).start()


def _raise() -> None:
    if _state.first is not None and not (_state.held or _state.raised or _state.finished):
        _state.raised = True
        raise Stopped(_state.first)


def _watch(numbers: list[int], state: _State) -> None:
    """Waits for signals and tells the main thread; ends the process if the main thread cannot, because it is in a
    library that does not return."""
    main = threading.main_thread().ident
    assert main is not None
    while not state.finished:
        left = 3600.0 if state.first is None else state.since + _GRACE - time.monotonic()
        if left <= 0:
            _end_at_once(state.first or signal.SIGTERM)
        report = signal.sigtimedwait([*numbers, signal.SIGURG], left)
        if report is None or report.si_signo == signal.SIGURG:
            continue
        _arrived(state, report.si_signo)
        if not state.finished:
            signal.pthread_kill(main, signal.SIGURG)


def _discard_pending(numbers: list[int]) -> None:
    """Signals that arrived too late to stop anything must not reach the caller's handlers as new ones."""
    while signal.sigtimedwait(numbers, 0) is not None:
        pass


def _end_at_once(number: int) -> None:
    discard_temporaries()
    try:
        os.write(2, f"clvol: error: {Stopped(number).line}\n".encode())
    except OSError:
        pass
    os._exit(128 + number)
