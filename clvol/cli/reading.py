"""How much of its input files a process has read: what a bar for reading shows, whatever library reads them."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

_INTERVAL = 0.25  # seconds
_LARGEST_COUNT = 100_000  # files of a folder that are added up


@contextmanager
def reported(paths: Iterable[str | os.PathLike], report: Callable[[int, int], None]) -> Iterator[None]:
    """Inside the block, ``report(read, total)`` is called a few times a second with the bytes that this process has
    read since the block began, and the size of ``paths``.

    The counter is that of the system (/proc/self/io), which counts what passes through read(): of mapped files, and on
    other systems, nothing is reported.
    """
    start, total = bytes_read(), sum(_size(Path(path)) for path in paths)
    if start is None or not total:
        yield
        return
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(_INTERVAL):
            now = bytes_read()
            if now is not None and now > start:
                report(min(now - start, total), total)

    thread = threading.Thread(target=watch, name="clvol-reading", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def bytes_read() -> int | None:
    """Bytes that this process has read from files and pipes; None where the system does not say."""
    try:
        with open("/proc/self/io", encoding="ascii") as file:
            return int(file.readline().removeprefix("rchar:"))
    except (OSError, ValueError):
        return None


def _size(path: Path) -> int:
    """Bytes of a file, or of the files of a folder."""
    try:
        if path.is_dir():
            found = (entry.stat().st_size for entry, _ in zip(os.scandir(path), range(_LARGEST_COUNT)))
            return sum(found)
        return path.stat().st_size
    except OSError:
        return 0
