"""The process of a device, as its Renderer sees it: started, asked one thing at a time, and ended."""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import tempfile
import threading
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import clvol.errors
from clvol.errors import ClvolError, ClvolWarning, DeviceError, RenderError
from clvol.integrators.base import Progress
from clvol.opencl import failures
from clvol.opencl.children import child_command, child_environment, end_child
from clvol.opencl.probe import first_meaningful_line
from clvol.render.isolation.channel import Channel, ChannelClosed, Garbled, Message

_WORKER = Path(__file__).with_name("worker.py")
_START_SECONDS = 120.0  # within which a process has to open its device
_END_SECONDS = 5.0  # that it has to end in an orderly way
_PENDING_SECONDS = 20.0  # that it has to end what it did when its Renderer was interrupted
_ERRORS: dict[str, type[BaseException]] = {
    name: kind
    for module in (clvol.errors, failures)
    for name, kind in vars(module).items()
    if isinstance(kind, type) and issubclass(kind, ClvolError)
} | {"MemoryError": MemoryError}

_log = logging.getLogger(__name__)


class DeviceProcess:
    """A process that renders on ``device`` (a name), and ends with this one, however that ends.

    ``request`` raises RenderError once it has died. For one thread at a time, but for ``kill``.
    """

    def __init__(self, device: str) -> None:
        if not hasattr(socket, "send_fds"):
            raise DeviceError("isolate", "this system cannot give memory to another process", "devices in this process")
        self.device = device
        self._owner = os.getpid()
        self._lock = threading.Lock()
        self._number = 0
        self._pending = False  # a request was given up before its answer
        self._reason = ""  # why it was killed
        self._stderr = tempfile.TemporaryFile()
        ours, theirs = socket.socketpair()
        watched, self._lifeline = os.pipe()
        command = child_command(str(_WORKER), str(theirs.fileno()), str(watched), str(os.getpid()))
        try:
            self._process = subprocess.Popen(
                command, env=child_environment(), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=self._stderr, pass_fds=(theirs.fileno(), watched), start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            os.close(self._lifeline)
            ours.close()
            raise DeviceError(device, f"its process cannot be started: {error.strerror}") from None
        finally:
            theirs.close()
            os.close(watched)
        self._channel = Channel(ours)

    @property
    def pid(self) -> int:
        return self._process.pid

    def request(
        self,
        what: str,
        arguments: Message | None = None,
        descriptors: Sequence[int] = (),
        progress: Progress | None = None,
        seconds: float | None = None,
    ) -> Message:
        """The answer to a request. ``progress`` is called as long as it takes, and may end the work by an exception.

        Raises what the request raised there, and RenderError if the process has died, sends what cannot be read, or
        does not answer within ``seconds``.
        """
        if os.getpid() != self._owner:
            raise DeviceError(self.device, "its process belongs to the parent of this one", "a Renderer of its own")
        with self._lock:
            try:
                self._catch_up()
                self._number += 1
                how = {"number": self._number, "log": _log.getEffectiveLevel(), "progress": progress is not None}
                self._channel.send({"request": what, **how, **(arguments or {})}, descriptors)
                self._pending = True
                answer = self._answer(progress, seconds)
                self._pending = False
            except (ChannelClosed, Garbled, TimeoutError) as error:
                self._pending = False
                raise self._death(error, seconds) from None
        return self._checked(answer)

    def _answer(self, progress: Progress | None, seconds: float | None) -> Message:
        """The answer to the last request; what comes before it is passed on."""
        stopped: BaseException | None = None
        while True:
            message, _ = self._channel.receive(seconds)
            if self._pass_on(message):
                continue
            if message.get("number") != self._number:
                raise Garbled
            if "progress" in message:
                done, total = _two_numbers(message["progress"])
                try:
                    if progress is not None and stopped is None:
                        progress(done, total)
                except BaseException as error:
                    stopped = error
                self._channel.send({"go_on": stopped is None})
                continue
            if stopped is not None:
                self._pending = False
                raise stopped
            return message

    def _pass_on(self, message: Message) -> bool:
        """Whether ``message`` was a line of the log or a warning."""
        try:
            if "log" in message:
                name, level, text = message["log"]
                logging.getLogger(str(name)).log(int(level), "%s", f"{self.device}: {text}")
                return True
            if "warning" in message:
                where, what, advice = message["warning"]
                warnings.warn(ClvolWarning(str(where), str(what), _text(advice)), stacklevel=5)
                return True
        except (TypeError, ValueError, IndexError):
            raise Garbled from None
        return False

    def _catch_up(self) -> None:
        """Waits for the answer to a request that was given up."""
        end = time.monotonic() + _PENDING_SECONDS
        while self._pending:
            message, _ = self._channel.receive(max(end - time.monotonic(), 0.0))
            if self._pass_on(message):
                continue
            if "progress" in message:
                self._channel.send({"go_on": False})
            else:
                self._pending = False

    def _checked(self, answer: Message) -> Message:
        if "error" in answer:
            name, (where, what, expected) = answer["error"]
            kind = _ERRORS.get(name, RenderError)
            raise kind(str(where), str(what), _text(expected)) if issubclass(kind, ClvolError) else kind()
        if "fault" in answer:
            raise RuntimeError(f"in the process of {self.device}:\n{answer['fault']}")
        return answer

    def _death(self, error: BaseException, seconds: float | None) -> RenderError:
        """The error that says how the process has ended; it is ended if it has not."""
        if isinstance(error, TimeoutError):
            self._reason = self._reason or f"no answer within {seconds:g} s"
        elif isinstance(error, Garbled):
            self._reason = self._reason or "it sent what cannot be read"
        else:
            try:
                self._process.wait(_END_SECONDS)
            except subprocess.TimeoutExpired:
                self._reason = self._reason or "it closed its connection"
        end_child(self._process)
        return RenderError(self.device, f"its process {self._reason or self._end()}", "a driver that works")

    def _end(self) -> str:
        status = self._process.returncode
        self._stderr.seek(0)
        text = self._stderr.read()[-20000:].decode("utf-8", "replace")
        if status >= 0:  # an uncaught exception: its message is the last line
            line = first_meaningful_line(text.rstrip().rpartition("\n")[2])
            return f"ended with status {status}" + (f": {line}" if line else "")
        try:
            name = signal.Signals(-status).name
        except ValueError:
            name = f"signal {-status}"
        if name in ("SIGKILL", "SIGTERM"):
            return f"was killed ({name})"
        line = first_meaningful_line(text)
        return f"crashed ({name})" + (f": {line}" if line else "")

    def kill(self, reason: str) -> None:
        """Ends the process at once; a request that waits for it raises RenderError with ``reason``."""
        self._reason = self._reason or f"was ended: {reason}"
        if self._owner == os.getpid():
            end_child(self._process)

    def start(self) -> Message:
        """Waits until the device is open; what is known of it. DeviceError if it cannot be used."""
        try:
            return self.request("open", {"device": self.device}, seconds=_START_SECONDS)
        except RenderError as error:
            raise DeviceError(error.where, error.what, error.expected) from None

    def close(self) -> None:
        """Ends the process, in an orderly way if it is not busy."""
        if os.getpid() != self._owner or self._lifeline < 0:
            return
        if not self._pending and self._process.poll() is None and self._lock.acquire(timeout=0.1):
            try:
                self._channel.send({"request": "close", "number": 0, "log": logging.WARNING, "progress": False})
                self._process.wait(_END_SECONDS)
            except (ChannelClosed, subprocess.TimeoutExpired):
                pass
            finally:
                self._lock.release()
        os.close(self._lifeline)
        self._lifeline = -1
        end_child(self._process)
        self._channel.close()
        self._stderr.close()

    def __del__(self) -> None:
        lifeline: Any = getattr(self, "_lifeline", -1)
        if lifeline >= 0 and os.getpid() == self._owner:
            os.close(lifeline)  # which ends the process
            self._lifeline = -1


def _two_numbers(value: Any) -> tuple[int, int]:
    try:
        done, total = map(int, value)
    except (TypeError, ValueError):
        raise Garbled from None
    return done, total


def _text(value: Any) -> str | None:
    return None if value is None else str(value)
