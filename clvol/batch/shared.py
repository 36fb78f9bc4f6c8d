"""Work on files that several processes make together in a shared folder."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from clvol.batch.claims import Claims

_PAUSE = 0.25  # seconds between looks at what others are making, at first,
_LONGEST_PAUSE = 4.0  # and later

T = TypeVar("T")


def unmade(
    items: Sequence[T],
    claims: Claims,
    files: Callable[[T], Sequence[str]],
    is_made: Callable[[T], bool],
    waiting: Callable[[int], None] | None = None,
    releases: bool = True,
) -> Iterator[T]:
    """Yields the items that this process is to make, each claimed until the next one is requested, or, without
    ``releases``, until the caller releases the claim; ends when all ``items`` are made, whoever made them. Those that
    others are making are waited for, and made here if the others end before they have: ``waiting(number of them)`` is
    called meanwhile.

    ``files(item)``: what is made of it; the first one is claimed. ``is_made(item)`` reads them, which takes a while, so
    it is not called again unless they have changed.
    """
    seen: dict[int, list[object]] = {}

    def made(number: int) -> bool:
        signature = [_signature(path) for path in files(items[number])]
        if seen.get(number) == signature:
            return False
        if None not in signature and is_made(items[number]):
            return True
        seen[number] = signature
        return False

    left, pause = list(range(len(items))), _PAUSE
    while left:
        busy = []
        for number in left:
            if made(number):
                continue
            first, is_left = files(items[number])[0], False
            if not claims.claim(first):
                busy.append(number)
                continue
            try:
                if is_left := not made(number):
                    yield items[number]
            finally:
                if releases or not is_left:
                    claims.release(first)
        if len(busy) == len(left):
            if waiting is not None:
                waiting(len(left))
            time.sleep(pause)
            pause = min(2 * pause, _LONGEST_PAUSE)
        else:
            pause = _PAUSE
        left = busy


def _signature(path: str) -> object:
    """Differs where the file does. It is opened, since NFS may know its attributes from before."""
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except OSError:
        return None
    try:
        found = os.fstat(descriptor)
    finally:
        os.close(descriptor)
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns
