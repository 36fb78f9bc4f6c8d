"""Compiled programs kept for later processes, each file with a digest of its contents.

An OpenCL implementation crashes on a damaged program (PoCL aborts the process), so it is only given programs that are,
byte for byte, as they were written. A problem with the folder costs time, never a
picture: it is reported once, and the program is compiled anew.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
import struct
import tempfile
import time
from pathlib import Path
from typing import IO

from clvol.opencl.folders import cache_folder, why_no_cache
from clvol.opencl.notices import notice

_MAGIC = b"clvolprogram1\n"
_DIGEST = 32
_MOST = 512 * 2**20  # bytes of one folder; the oldest programs are removed first
_TOUCHED = 24 * 3600.0  # seconds after which a file that is read counts as new again
ENDING = ".program"
EACH_TIME = "devices are probed and programs compiled each time"

Files = dict[str, bytes]  # by their path within the program's folder, "" for a program in one piece


def program_folder(pocl: bool = False) -> Path | None:
    """Where programs are kept: in the user's cache folder; PoCL's in POCL_CACHE_DIR if that is set."""
    named = os.environ.get("POCL_CACHE_DIR") if pocl else None
    if named:
        return Path(named).absolute() / "clvol"
    folder = cache_folder()
    return None if folder is None else folder / "programs"


def read_program(folder: Path | None, key: str) -> Files | None:
    """The files that :func:`write_program` stored under ``key``, or None if they are missing or damaged."""
    path = _path(folder, key)
    if path is None:
        return None
    try:
        with _open(path) as file:
            # A file that others may write to could hold anybody's code.
            status = os.fstat(file.fileno())
            if hasattr(os, "geteuid") and (
                status.st_uid not in (os.geteuid(), 0) or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
            ):
                notice(_where(path), "files that others may write are not used; programs are compiled anew")
                return None
            content = file.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        notice(_where(path), f"cannot be read ({error.strerror}); programs are compiled anew")
        return None
    files = _unpacked(content)
    if files is None:
        notice(_where(path), "damaged; what is damaged is compiled anew")
    elif time.time() - status.st_mtime > _TOUCHED:
        try:
            os.utime(path)
        except OSError:
            pass
    return files


def write_program(folder: Path | None, key: str, files: Files) -> None:
    """Stores ``files`` under ``key``. Failure raises nothing."""
    path = _path(folder, key)
    if path is None:
        notice("cache", f"there is none ({why_no_cache()}); {EACH_TIME}")
        return
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        number, temporary = tempfile.mkstemp(prefix=".", suffix=".part", dir=path.parent)
        with os.fdopen(number, "wb") as file:
            if hasattr(os, "fchmod"):
                os.fchmod(number, 0o644)  # a cache may be filled by one user for others to read
            file.write(_packed(files))
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        notice(_where(path), f"cannot be written ({error.strerror}); {EACH_TIME}")
    finally:
        if temporary is not None:
            try:
                os.unlink(temporary)
            except OSError:
                pass
    try:
        _prune(path.parent)
    except OSError:  # another process did the same
        pass


def is_whole(path: str | os.PathLike) -> bool:
    """Whether a file of the store is intact. Raises OSError."""
    with _open(path) as file:
        return _unpacked(file.read()) is not None


def _open(path: str | os.PathLike) -> IO[bytes]:
    """Opens a file to read; OSError for anything else, since a pipe, for example, would block."""
    number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise OSError(errno.EINVAL, "not a file")
    return os.fdopen(number, "rb")


def _where(path: Path) -> str:
    """The cache of a program's ``path`` in messages: it is named by the folder above clvol's own."""
    return f"cache {path.parent.parent}"


def _path(folder: Path | None, key: str) -> Path | None:
    return None if folder is None else folder / f"{key}{ENDING}"


def _packed(files: Files) -> bytes:
    header = json.dumps([[name, len(content)] for name, content in files.items()]).encode()
    body = struct.pack("<Q", len(header)) + header + b"".join(files.values())
    return _MAGIC + hashlib.blake2b(body, digest_size=_DIGEST).digest() + body


def _unpacked(content: bytes) -> Files | None:
    """The files, or None if the bytes are not exactly as :func:`_packed` made them."""
    start = len(_MAGIC) + _DIGEST
    body = memoryview(content)[start:]
    if not content.startswith(_MAGIC) or len(body) < 8:
        return None
    if hashlib.blake2b(body, digest_size=_DIGEST).digest() != content[len(_MAGIC) : start]:
        return None
    (size,) = struct.unpack("<Q", body[:8])
    at = 8 + size
    files = {}
    for name, length in json.loads(bytes(body[8:at])):
        files[name] = bytes(body[at : at + length])
        at += length
    return files


_pruned: set[Path] = set()


def _prune(folder: Path) -> None:
    """Removes the oldest programs where all together take too much; once per process and folder."""
    if folder in _pruned:
        return
    _pruned.add(folder)
    found = []
    now = time.time()
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith((ENDING, ".part")):
                status = entry.stat(follow_symlinks=False)
                if entry.name.endswith(".part") and now - status.st_mtime > _TOUCHED:
                    os.unlink(entry.path)  # left by a process that was killed
                else:
                    found.append((status.st_mtime, status.st_size, entry.path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total <= _MOST:
            break
        os.unlink(path)
        total -= size
