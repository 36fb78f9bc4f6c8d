"""Launches of one kernel by several queues, kept in an order that PoCL survives.

PoCL keeps the machine code of a kernel once per width of its grids: code made for one grid serves narrower ones, and a
wider one adds code, which is found first from then on. When a launch ends, PoCL (3.1 to 5.0) looks for its code by
kernel and size of groups alone, so that launches of older code give back the new one's: with two of them still running,
an assertion ends the process. Launches of one queue follow each other. Those of several queues are kept apart here
where one is wider than any before: it starts when the others are done, and others start when its code is there.
"""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any
from weakref import WeakKeyDictionary, ref

from clvol.opencl.binding import cl

_POLL_SECONDS = 1e-4


class LaunchOrder:
    """The order of the launches of one kernel with one size of groups, for all queues of this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._widest: dict[int, int] = {}  # by device
        # The last launch of each queue, which is the last to end, and the last that was wider than any before.
        self._last: WeakKeyDictionary[Any, Any] = WeakKeyDictionary()
        self._wider: WeakKeyDictionary[Any, Any] = WeakKeyDictionary()

    def launch(self, owner: Any, device: int, width: int, enqueue: Callable[[], Any]) -> Any:
        """The event of ``enqueue()``, called when that is safe. ``owner`` stands for an in-order queue on ``device``
        (a number), and may be forgotten when the queue is; ``width``: work-items of the grid's widest dimension."""
        with self._lock:
            for other, event in list(self._wider.items()):
                if other is not owner:
                    _wait(event, cl.command_execution_status.RUNNING)
                    del self._wider[other]
            wider = width > self._widest.get(device, 0)
            if wider:
                for other, event in list(self._last.items()):
                    if other is not owner:
                        _wait(event, cl.command_execution_status.COMPLETE)
            event = enqueue()
            self._last[owner] = event
            if wider:
                self._widest[device] = width
                self._wider[owner] = event
            return event


def _wait(event: Any, status: int) -> None:
    """Waits for ``event`` to be that far, or to fail, which is for those to report who wait for its results."""
    while event.command_execution_status > status:
        time.sleep(_POLL_SECONDS)


_orders: dict[tuple, LaunchOrder] = {}
_orders_lock = threading.Lock()


class SafeLaunches:
    """Launches of one kernel of a ``program`` on ``owner``'s queue, in the order that all queues of this process keep
    to. ``owner``: see ``LaunchOrder.launch``."""

    def __init__(self, program: Any, name: str, owner: Any) -> None:
        # PoCL tells kernels apart by what they are compiled from, whatever context they are in.
        (device,) = program.get_info(cl.program_info.DEVICES)
        options = program.get_build_info(device, cl.program_build_info.OPTIONS)
        source = program.get_info(cl.program_info.SOURCE)
        self._key = (hashlib.blake2b(source.encode()).digest(), options, name)
        self._device = device.int_ptr
        self._owner = ref(owner)

    def launch(self, size: Sequence[int], groups: Sequence[int] | None, enqueue: Callable[[], Any]) -> Any:
        """The event of ``enqueue()``: a launch of ``size`` work-items in ``groups``."""
        key = (*self._key, None if groups is None else tuple(groups))
        with _orders_lock:
            order = _orders.setdefault(key, LaunchOrder())
        return order.launch(self._owner(), self._device, max(size), enqueue)
