"""Messages between a Renderer and the processes of its devices: JSON objects, each after its length, over a socket of
this machine. Descriptors of files travel beside them. Nothing that is received is ever executed."""

from __future__ import annotations

import array
import json
import select
import socket
import struct
import threading
import time
from collections.abc import Sequence
from typing import Any

_HEADER = struct.Struct(">I")
_LONGEST = 1 << 28  # bytes of a message
_PIECE = 1 << 16
_DESCRIPTORS = 16  # at most, in a message

Message = dict[str, Any]


class ChannelClosed(Exception):
    """The process at the other end has gone."""


class Garbled(Exception):
    """What was received is no message."""


class Channel:
    """One end of a socket. Several threads may send, one at a time receives."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._sends = threading.Lock()
        self._rest = bytearray()
        self._descriptors: list[int] = []

    def close(self) -> None:
        self._end.close()

    def send(self, message: Message, descriptors: Sequence[int] = ()) -> None:
        """Raises ChannelClosed. ``descriptors`` stay open here."""
        text = json.dumps(message).encode()
        data = memoryview(_HEADER.pack(len(text)) + text)
        with self._sends:
            try:
                sent = socket.send_fds(self._end, [data], list(descriptors)) if descriptors else 0
                self._end.sendall(data[sent:])
            except OSError as error:
                raise ChannelClosed from error

    def receive(self, seconds: float | None = None) -> tuple[Message, list[int]]:
        """The next message, and the descriptors that came with it. Raises ChannelClosed, Garbled, and TimeoutError if
        none arrives within ``seconds``."""
        end = None if seconds is None else time.monotonic() + seconds
        while (text := self._complete()) is None:
            self._read(end)
        found, self._descriptors = self._descriptors, []
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            raise Garbled from None
        if not isinstance(message, dict):
            raise Garbled
        return message, found

    def _complete(self) -> bytes | None:
        if len(self._rest) < _HEADER.size:
            return None
        (length,) = _HEADER.unpack_from(self._rest)
        if length > _LONGEST:
            raise Garbled
        if len(self._rest) < _HEADER.size + length:
            return None
        text = bytes(self._rest[_HEADER.size : _HEADER.size + length])
        del self._rest[: _HEADER.size + length]
        return text

    def _read(self, end: float | None) -> None:
        poll = select.poll()
        try:
            poll.register(self._end, select.POLLIN)
            while not poll.poll(None if end is None else max(1e3 * (end - time.monotonic()), 0.0)):
                if end is not None and time.monotonic() >= end:
                    raise TimeoutError
            space = socket.CMSG_SPACE(_DESCRIPTORS * array.array("i").itemsize)
            data, more, *_ = self._end.recvmsg(_PIECE, space, getattr(socket, "MSG_CMSG_CLOEXEC", 0))
        except TimeoutError:
            raise
        except (OSError, ValueError) as error:
            raise ChannelClosed from error
        if not data:
            raise ChannelClosed
        self._rest += data
        for level, kind, content in more:
            if (level, kind) == (socket.SOL_SOCKET, socket.SCM_RIGHTS):
                numbers = array.array("i")
                numbers.frombytes(content[: len(content) - len(content) % numbers.itemsize])
                self._descriptors += numbers
