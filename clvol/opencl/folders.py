"""Folders on the user's machine: one that lasts, for caches, and one for this process alone.

Neither is certain to be there: a container may have no HOME, a disk may be full, and /tmp may forbid
that code is run from it.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path

from clvol.cache_folder import cache_folder
from clvol.errors import DeviceError

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]  # a module that is missing has no type

_ROOM = 64 * 2**20  # bytes that compilers may need for what they write
_PREFIX = "clvol-scratch-"
_MARK = "belongs-to-a-running-clvol"


def why_no_cache() -> str:
    """Why :func:`cache_folder` gives None, in words."""
    return "HOME is not set, and the user has no home folder"


_scratch: Path | None = None
_scratch_owner = 0
_scratch_lock = -1


def scratch_folder() -> Path:
    """A folder of this process alone, for files that compilers write and load; it is removed when the process ends.

    It lies in the first folder for temporary files that has room and allows code to be run from it. DeviceError
    where nothing can be written at all.
    """
    global _scratch, _scratch_owner, _scratch_lock
    if _scratch is not None and _scratch_owner == os.getpid() and _scratch.is_dir():
        return _scratch
    tried = []
    for base in _by_room(_bases()):
        try:
            folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=base))
        except OSError as error:
            tried.append(f"{base}: {error.strerror}")
            continue
        try:
            _scratch_lock = _hold(folder)
        except OSError as error:
            tried.append(f"{base}: {error.strerror}")
            shutil.rmtree(folder, ignore_errors=True)
            continue
        _scratch, _scratch_owner = folder, os.getpid()
        _sweep(base)
        return folder
    what = "no folder for temporary files can be written" + (f" ({'; '.join(tried)})" if tried else "")
    raise DeviceError("TMPDIR", what, "a folder with 64 MiB of room")


def _bases() -> list[str]:
    """Folders for temporary files: those of tempfile, and some others."""
    named = [os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP")]
    usual = ["/tmp", "/var/tmp", "/usr/tmp"] if os.name == "posix" else [tempfile.gettempdir()]
    bases = [*named, *usual, "/dev/shm", os.environ.get("XDG_RUNTIME_DIR")]
    cache = cache_folder()
    if cache is not None:
        try:
            cache.mkdir(parents=True, exist_ok=True)
            bases.append(str(cache))
        except OSError:
            pass
    bases.append(os.getcwd() if _has_cwd() else None)
    return list(dict.fromkeys(os.path.abspath(b) for b in bases if b and os.path.isdir(b)))


def _has_cwd() -> bool:
    try:
        return os.path.isdir(os.getcwd())
    except OSError:
        return False


def _by_room(bases: list[str]) -> list[str]:
    """Those with room and the right to run code first, in their order; then the others."""
    return sorted(bases, key=lambda base: not _is_roomy(base))


def _is_roomy(base: str) -> bool:
    if not os.access(base, os.W_OK | os.X_OK):
        return False
    if not hasattr(os, "statvfs"):
        return shutil.disk_usage(base).free >= _ROOM
    try:
        status = os.statvfs(base)
    except OSError:
        return False
    no_code = bool(status.f_flag & getattr(os, "ST_NOEXEC", 8))
    files = status.f_files == 0 or status.f_favail > 1000  # some file systems count no files
    return not no_code and files and status.f_bavail * status.f_frsize >= _ROOM


def _hold(folder: Path) -> int:
    """Locks ``folder`` until this process ends, however it ends: against our own sweeping, and against
    systemd's, which removes what is old from /tmp."""
    if fcntl is None:
        return -1
    number = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # a file system without locks
        pass
    (folder / _MARK).touch()
    return number


def _sweep(base: str) -> None:
    """Removes the folders of processes that were killed, whose locks are free."""
    if fcntl is None:
        return
    try:
        with os.scandir(base) as entries:
            found = [e.path for e in entries if e.name.startswith(_PREFIX) and e.is_dir(follow_symlinks=False)]
    except OSError:
        return
    for path in found:
        folder = Path(path)
        try:
            if folder == _scratch or folder.stat().st_uid != os.geteuid() or not (folder / _MARK).exists():
                continue
            number = os.open(folder, os.O_RDONLY)
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(number)
        except OSError:  # locked, or removed meanwhile
            continue


@atexit.register
def _remove_scratch() -> None:
    if _scratch is not None and _scratch_owner == os.getpid():  # a forked child must not remove it
        shutil.rmtree(_scratch, ignore_errors=True)
