"""The files and folders that a command reads, which nothing that it writes may replace.

A file is identified by its device and inode number, so links, other spellings and other mounts of a file are
recognised as that file. A folder counts as an input if it contains one.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from clvol.errors import UsageError
from clvol.volume.parts import parts_of

_ZARR = ("zarr.json", ".zgroup", ".zarray", ".zattrs")
# The first bytes of files that clvol writes. A file in a folder of slices that begins like this is not a slice.
_PICTURES = (b"\x89PNG", b"\x76\x2f\x31\x01", b"\x93NUMPY", b"GIF8", b"RIFF", b"\xff\xd8\xff", b"{")

Identity = tuple[int, int]


class Inputs:
    """Files and folders that are read.

    In a Zarr store every file is protected, and no file may be added. In any other folder every existing file is
    protected except pictures of the kinds that clvol writes.
    """

    def __init__(self, paths: Iterable[str | os.PathLike] = ()) -> None:
        self._paths = [os.fspath(path) for path in paths]
        self._files: dict[Identity, str] = {}
        self._folders: dict[Identity, str] = {}  # every folder inside an input folder
        self._closed: set[Identity] = set()  # those of them to which no file may be added
        self._roots: list[str] = []  # real paths
        self._is_known = False

    def check_file(self, path: str | os.PathLike) -> None:
        """Raises UsageError if writing the file ``path`` would change an input."""
        if "\0" in os.fspath(path):  # no file can have this name, which is reported elsewhere
            return
        self._look()
        real = os.path.realpath(path)
        here = _identity(real)
        if real in self._roots or here in self._files:
            raise UsageError(str(path), "is also an input", "a different output file")
        for folder in Path(real).parents:
            identity = _identity(folder)
            if identity in self._closed:
                what = f"lies in the input {self._folders[identity]}"
                raise UsageError(str(path), what, "a path outside it")

    def check_folder(self, path: str | os.PathLike) -> None:
        """Raises UsageError if creating or removing the folder ``path`` would change an input."""
        self._look()
        real = os.path.realpath(path)
        here = _identity(real)
        if real in self._roots or here in self._files or here in self._folders:
            raise UsageError(str(path), "is also an input", "a different folder")
        for root in self._roots:
            above = Path(root).parents
            if any(str(up) == real or (here and _identity(up) == here) for up in above):
                raise UsageError(str(path), f"contains the input {root}", "a different folder")
        for up in Path(real).parents:
            identity = _identity(up)
            if identity is not None and identity in self._folders:
                what = f"lies in the input {self._folders[identity]}"
                raise UsageError(str(path), what, "a path outside it")
        if here is not None and not self._files.keys().isdisjoint(_files_in(real)):
            raise UsageError(str(path), "contains a link to an input", "a different folder")

    def _look(self) -> None:
        """Finds the files and folders that the paths stand for, on the first call."""
        if self._is_known:
            return
        self._is_known = True
        for path in self._paths:
            if "\0" in path:
                continue
            for one in (path, *parts_of(path)):
                real = os.path.realpath(one)
                self._roots.append(real)
                if os.path.isdir(real):
                    self._add_folder(_outermost_store(real), path)
                elif (identity := _identity(real)) is not None:
                    self._files[identity] = path

    def _add_folder(self, top: str, source: str) -> None:
        zarr = is_zarr(top)
        self._roots.append(top)
        for folder, entries in _walk(top) if zarr else _level(top):
            identity = _identity(folder)
            if identity is not None:
                self._folders[identity] = source
                if zarr:
                    self._closed.add(identity)
            for entry in entries:
                if zarr or not is_picture(entry.path):
                    if (found := _identity(entry.path)) is not None:
                        self._files.setdefault(found, source)


_protected: list[Inputs] = []


@contextmanager
def protected(inputs: Inputs) -> Iterator[Inputs]:
    """Inside the block, ``clvol.image`` refuses to write to any of ``inputs``."""
    _protected.append(inputs)
    try:
        yield inputs
    finally:
        _protected.remove(inputs)


def check_not_read(path: str | os.PathLike) -> None:
    """Raises UsageError if ``path`` is protected."""
    for inputs in _protected:
        inputs.check_file(path)


def _identity(path: str | os.PathLike) -> Identity | None:
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino


def _walk(top: str) -> Iterator[tuple[str, list[os.DirEntry]]]:
    """Yields each folder below ``top`` once, following links, with its entries that are not folders."""
    seen: set[Identity | None] = set()
    waiting = [top]
    while waiting:
        folder = waiting.pop()
        if (identity := _identity(folder)) in seen:
            continue
        seen.add(identity)
        for _, entries in _level(folder):
            folders = {entry.path for entry in entries if _is_folder(entry)}
            waiting += folders
            yield folder, [entry for entry in entries if entry.path not in folders]


def _level(folder: str) -> Iterator[tuple[str, list[os.DirEntry]]]:
    """Yields the folder alone with all its entries; nothing if it cannot be read."""
    try:
        with os.scandir(folder) as found:
            entries = list(found)
    except OSError:
        return
    yield folder, entries


def _is_folder(entry: os.DirEntry) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False


def _files_in(top: str) -> Iterator[Identity]:
    for _, entries in _walk(top):
        for entry in entries:
            if (identity := _identity(entry.path)) is not None:
                yield identity


def is_zarr(folder: str) -> bool:
    return any(os.path.lexists(os.path.join(folder, name)) for name in _ZARR)


def _outermost_store(folder: str) -> str:
    """The store that ``folder`` is a group or an array of, or ``folder`` itself."""
    while (up := os.path.dirname(folder)) != folder and is_zarr(folder) and is_zarr(up):
        folder = up
    return folder


def is_picture(path: str) -> bool:
    """Whether a file in a folder of slices is not a slice but a picture or JSON of the kinds that clvol writes."""
    try:
        if not os.path.isfile(path):
            return True
        with open(path, "rb") as file:
            head = file.read(132)
    except OSError:
        return False
    return head[128:] != b"DICM" and (head.startswith(_PICTURES) or head[4:8] == b"ftyp")
