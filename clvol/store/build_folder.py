"""The folder in which a store is built: checks of its path, and a lock so that only one process builds in it."""

from __future__ import annotations

import errno
import fcntl
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from clvol.errors import UsageError
from clvol.interrupts import held
from clvol.store.arrays import NOT_UTF8, is_utf8
from clvol.store.format import JOURNAL, PARTIAL, ROOT, partial_path
from clvol.store.journal import LOCK
from clvol.store.zarr_store import is_store

_REPLACED = ".replaced"


def places_of(path: Path) -> tuple[Path, Path, Path]:
    """The folders that building the store ``path`` creates or removes: the store, the folder in which it is built,
    and the one to which a replaced store is moved.
    """
    return path, partial_path(path), replaced_path(path)


def replaced_path(path: Path) -> Path:
    """The path to which a store ``path`` is moved while a new one takes its place."""
    return path.with_name(path.name + _REPLACED)


def check_place(path: Path, overwrite: bool) -> None:
    """UsageError, before any work, if the store could not be written to ``path``."""
    try:
        _check_place(path, overwrite)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        what = f"no folder can have this name: {why}"
        raise UsageError(str(path), what, "the name of a new folder") from None


def _check_place(path: Path, overwrite: bool) -> None:
    if not is_utf8(str(path.absolute())):
        raise UsageError(str(path), NOT_UTF8, "a name in UTF-8")
    if not path.name or path.name.endswith((PARTIAL, _REPLACED)):
        raise UsageError(str(path), "not a valid name for a store", f"a name that does not end in {PARTIAL}")
    parent = path.parent
    if not parent.is_dir():
        what = "not a folder" if parent.exists() else "no such folder"
        raise UsageError(str(path), f"{parent}: {what}", "a path in an existing folder")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise UsageError(str(path), f"{parent} cannot be written to", "a writable folder")
    for place in places_of(path):
        try:
            os.lstat(place)  # reports a name that is too long
        except FileNotFoundError:
            pass
    partial, replaced = partial_path(path), replaced_path(path)
    if os.path.lexists(replaced) and (replaced.is_symlink() or not is_store(replaced)):
        what = f"{replaced.name}, where a store that is replaced goes, is something else"
        raise UsageError(str(path), what, "another name")
    if os.path.lexists(partial) and not _is_ours(partial):
        what = f"{partial.name}, where it is built, is something else"
        raise UsageError(str(path), what, "another name")
    if not os.path.lexists(path):
        return
    if path.is_symlink() or not path.is_dir():
        raise UsageError(str(path), "got a file", "a name for a new folder")
    if not overwrite:
        raise UsageError(str(path), "exists already", "a new name, or --overwrite")
    if not is_store(path):
        raise UsageError(
            str(path), "a folder that is not a store", "a store to overwrite, or a new name"
        )


def _is_ours(partial: Path) -> bool:
    """Whether ``partial`` is a folder in which a store is or was built. A build that was killed while it began or
    cleaned up leaves only empty folders and the metadata of levels.
    """
    if partial.is_symlink() or not partial.is_dir():
        return False
    if (partial / JOURNAL).is_dir():
        return True
    for entry in partial.rglob("*"):
        level, *inner = entry.relative_to(partial).parts
        if entry.is_symlink() or not re.fullmatch("[0-9]+|blocks|codebooks", level):
            return False
        if not entry.is_dir() and not (len(inner) == 1 and re.match(rf"{ROOT}(\.__lock)?$", inner[0])):
            return False
    return True


@contextmanager
def locked(partial: Path) -> Iterator[Path]:
    """A context that holds the lock on the folder ``partial``, which is created if needed, and yields it."""
    with held():
        (partial / JOURNAL).mkdir(parents=True, exist_ok=True)
    with (partial / JOURNAL / LOCK).open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
                raise
            raise UsageError(
                str(partial), "another process is building it", "one process at a time"
            ) from None
        yield partial
