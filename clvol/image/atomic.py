"""Writes files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from clvol.errors import ClvolError, RenderError, UsageError
from clvol.inputs import check_not_read
from clvol.interrupts import expect_temporary, forget_temporary, held
from clvol.temporaries import remove_leftovers, temporary_name

_NO_FILE = ((stat.S_ISDIR, "this is a folder"), (stat.S_ISCHR, "this is a device"),
            (stat.S_ISBLK, "this is a device"), (stat.S_ISFIFO, "this is a pipe"),
            (stat.S_ISSOCK, "this is a socket"))  # fmt: skip


def check_output_folder(path: str | os.PathLike[str]) -> Path:
    """Checks that a file can be created at ``path``, and returns the resolved path. An existing file is left untouched.
    What killed processes have left in the folder is removed.

    Call it before long work. Raises :class:`clvol.errors.UsageError` when the folder does not exist or cannot be
    written to, and when ``path`` is a folder, a device, a pipe, a socket, or an input (``clvol.inputs.protected``).
    """
    target, temporary = _begin(path)
    _remove(temporary)
    remove_leftovers(target.parent)
    return target


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path in the folder of ``path``, with the same ending, to write to.

    After the block the file is flushed to disk and renamed to ``path`` in one step. If the block ends early (by an
    error, a full disk, an interrupt), the folder stays as it was. Raises :class:`clvol.errors.UsageError` if no file
    can be created there, and :class:`clvol.errors.RenderError`, which names ``path``, when writing fails.
    """
    with atomic_paths([path]) as temporaries:
        yield temporaries[0]


@contextmanager
def atomic_paths(paths: Sequence[str | os.PathLike[str]]) -> Iterator[list[Path]]:
    """Like ``atomic_path`` for several files: after the block either all of them appear, or none does.

    If renaming one of them fails, those that were renamed before are removed; files that they had replaced are lost.
    """
    drafts: list[tuple[str, Path, Path]] = []
    try:
        for path in paths:
            drafts.append((str(path), *_begin(path)))
        yield [temporary for _, _, temporary in drafts]
        for given, _, temporary in drafts:
            with _writing(given):
                _flush(temporary)
        with held():
            _move(drafts)
    except OSError as error:
        known = [given for given, _, temporary in drafts if str(error.filename) == str(temporary)]
        raise _not_written(", ".join(known or [given for given, _, _ in drafts]), error) from error
    finally:
        for _, _, temporary in drafts:
            _remove(temporary)
    for folder in dict.fromkeys(target.parent for _, target, _ in drafts):
        _sync_folder(folder)


def _move(drafts: list[tuple[str, Path, Path]]) -> None:
    moved: list[Path] = []
    try:
        for given, target, temporary in drafts:
            _check_target(given, target)  # again: the target may have been created meanwhile
        for given, target, temporary in drafts:
            with _writing(given):
                os.replace(temporary, target)
            forget_temporary(temporary)
            moved.append(target)
    except BaseException:
        for target in moved:
            _remove(target)
        raise


@contextmanager
def _writing(given: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise _not_written(given, error) from error


def _not_written(given: str, error: OSError) -> ClvolError:
    return RenderError(given, f"the file cannot be written: {_why(error)}")


def _begin(path: str | os.PathLike[str]) -> tuple[Path, Path]:
    """The target, with links resolved, and a new empty file in the same folder."""
    try:
        target = Path(os.path.realpath(path))
        folder = target.parent
        _check_target(str(path), target)
    except (OSError, ValueError) as error:
        raise UsageError(str(path), f"no file can have this name: {_why(error)}",
                         "the name of a file") from error
    if not os.path.isdir(folder):
        what = "is not a folder" if os.path.exists(folder) else "does not exist"
        raise UsageError(str(path), f'the folder "{folder}" {what}', "an existing folder")
    temporary = folder / temporary_name(target.suffix)
    expect_temporary(temporary)
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        forget_temporary(temporary)
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
            raise RenderError(str(path), f"the file cannot be written: {error.strerror}") from error
        raise UsageError(str(path), f'no file can be created in "{folder}": {error.strerror}',
                         "a folder that can be written to") from error
    except BaseException:
        _remove(temporary)
        raise
    return target, temporary


def _check_target(given: str, target: Path) -> None:
    """Raises UsageError for a target that must not be replaced, and OSError for a name that is too long, before the
    work and not after it."""
    try:
        mode = os.lstat(target).st_mode
    except (FileNotFoundError, NotADirectoryError):
        mode = 0
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG and not os.path.isdir(target.parent):
            mode = 0  # the folder does not exist, which is reported later
        else:
            raise
    for is_kind, what in _NO_FILE:
        if is_kind(mode):
            raise UsageError(given, what, "the name of a file")
    if mode:
        _check_not_standard(given, target)
    check_not_read(given)


def _check_not_standard(given: str, target: Path) -> None:
    """Raises UsageError if standard output or standard error is redirected to ``target``."""
    for descriptor, name in ((1, "standard output"), (2, "standard error")):
        try:
            same = os.path.samestat(os.fstat(descriptor), os.stat(target))
        except OSError:
            continue
        if same:
            raise UsageError(given, f"{name} is redirected to it", "a different output file")


def _flush(temporary: Path) -> None:
    with open(temporary, "rb+") as file:
        os.fsync(file.fileno())


def _why(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _remove(temporary: Path) -> None:
    try:
        os.unlink(temporary)
    except OSError:
        pass
    forget_temporary(temporary)


def _sync_folder(folder: Path) -> None:
    """Makes the new name survive a power failure, on file systems that support it."""
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
