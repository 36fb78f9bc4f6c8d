"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from clvol.errors import ClvolError, RenderError, UsageError


def check_output_folder(path: str | os.PathLike[str]) -> Path:
    """``path`` resolved, if a file can be created there; an existing file is left untouched.

    Worth calling before hours of work. Raises :class:`clvol.errors.UsageError` when the folder does
    not exist or cannot be written to, or when ``path`` is a folder.
    """
    target, temporary = _begin(path)
    _remove(temporary)
    return target


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path beside ``path`` (same folder, same ending) to write to.

    After the block its content is flushed to the disk and put in the place of ``path`` in one step.
    Whatever ends the block early (an error, a full disk, an interrupt) leaves the folder as it was.
    Raises :class:`clvol.errors.UsageError` for an impossible place and
    :class:`clvol.errors.RenderError`, which names ``path``, when writing fails.
    """
    target, temporary = _begin(path)
    try:
        yield temporary
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except ClvolError:
        raise
    except OSError as error:
        raise RenderError(str(path), f"the file cannot be written: {_why(error)}") from error
    finally:
        _remove(temporary)
    _sync_folder(target.parent)


def _begin(path: str | os.PathLike[str]) -> tuple[Path, Path]:
    """The real target (links followed) and a new empty file beside it."""
    try:
        target = Path(os.path.realpath(path))
        folder = target.parent
        if os.path.isdir(target):
            raise UsageError(str(path), "this is a folder", "the name of a file")
        if os.path.isdir(folder) and not os.path.lexists(target):
            os.lstat(target)  # a name that is too long is known now, not after the work
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:
        raise UsageError(str(path), f"no file can have this name: {_why(error)}",
                         "the name of a file") from error
    if not os.path.isdir(folder):
        what = "is no folder" if os.path.exists(folder) else "does not exist"
        raise UsageError(str(path), f'the folder "{folder}" {what}', "an existing folder")
    temporary = folder / f".{secrets.token_hex(6)}.part{target.suffix}"
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
            raise RenderError(str(path), f"the file cannot be written: {error.strerror}") from error
        raise UsageError(str(path), f'no file can be created in "{folder}": {error.strerror}',
                         "a folder that can be written to") from error
    return target, temporary


def _why(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _remove(temporary: Path) -> None:
    try:
        temporary.unlink(missing_ok=True)
    except OSError:
        pass


def _sync_folder(folder: Path) -> None:
    """Make the new name survive a power cut; not every file system can."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(descriptor)
    except OSError:
        pass
    finally:
        os.close(descriptor)
