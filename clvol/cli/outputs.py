"""Several output files that appear together or not at all."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from clvol.errors import ClvolError, UsageError


def check_outputs(
    pictures: Sequence[str], others: Sequence[str], inputs: Iterable[str | os.PathLike]
) -> None:
    """UsageError now, before the work, if one of the files could not be written later.

    ``pictures`` must end as a picture does, ``others`` as they like; none may be the same file as
    another or as one of ``inputs``.
    """
    from clvol.image import check_output, check_output_folder

    taken = {os.path.realpath(path): "that is read" for path in inputs}
    for path in [*pictures, *others]:
        real = os.path.realpath(path) if "\0" not in path else path
        if real in taken:
            raise UsageError(path, f"got a file {taken[real]}", "a file of its own")
        taken[real] = "that is written already"
    for path in pictures:
        check_output(path)
    for path in others:
        check_output_folder(path)


_NUMBER = re.compile(r"%(?:0([1-9]))?d")


def numbered(path: str, index: int) -> str:
    """``path`` with frame ``index`` in the place of its name's %d, or of its %04d as four digits or
    more; a name with no such place, or with several, stays as it is."""
    folder, name = os.path.split(path)
    found = _NUMBER.findall(name)
    if len(found) != 1:
        return path
    digits = int(found[0] or 1)
    return os.path.join(folder, _NUMBER.sub(f"{index:0{digits}d}", name))


def check_frames(
    stills: Sequence[str],
    videos: Sequence[str],
    others: Sequence[str],
    inputs: Iterable[str | os.PathLike],
    count: int,
) -> None:
    """``check_outputs`` for an animation of ``count`` frames: every still has a number in its
    name, and no two of all files are the same."""
    from clvol.image import ENDINGS, VIDEO_ENDINGS

    for path in stills:
        if Path(path).suffix.lower() not in ENDINGS:
            what = f'neither pictures nor videos have the ending "{Path(path).suffix}"'
            raise UsageError(path, what, " or ".join([*ENDINGS, *VIDEO_ENDINGS]))
        if numbered(path, 0) == path:
            stem, ending = os.path.splitext(path)
            known = ", ".join(VIDEO_ENDINGS)
            expected = f"a name with a number such as {stem}_%04d{ending}, or one of {known}"
            raise UsageError(path, f"one name for {count} frames", expected)
    inputs = list(inputs)
    check_outputs([numbered(path, 0) for path in stills], [*videos, *others], inputs)
    taken = {os.path.realpath(path) for path in [*inputs, *videos, *others]}
    for path in stills:
        folder, name = os.path.split(path)
        folder = os.path.realpath(folder)
        for index in range(count):
            place = os.path.join(folder, numbered(name, index))
            real = os.path.realpath(place) if os.path.islink(place) else place
            if real in taken:
                raise UsageError(path, f"frame {index} is a file that is used already", "its own")
            taken.add(real)


def check_folder(folder: str) -> None:
    """UsageError now, before the work, if files could not be written to ``folder`` later."""
    from clvol.image import check_output_folder

    if os.path.lexists(folder) and not os.path.isdir(folder):
        raise UsageError(folder, "got a file", "a folder, or a name for a new one")
    check_output_folder(os.path.join(folder, "x") if os.path.isdir(folder) else folder)


@contextmanager
def together(paths: Sequence[str]) -> Iterator[list[Path]]:
    """Temporary files to write in place of ``paths``; after the block all take their places.

    If the block or any of the moves fails, none of ``paths`` is left as written here, and files
    that were there before the block stay if it is the block that fails.
    """
    from clvol.image import atomic_path

    before = {path: _identity(path) for path in paths}
    moving = False
    try:
        with ExitStack() as stack:
            yield [stack.enter_context(atomic_path(path)) for path in paths]
            moving = True
    except BaseException:
        if moving:
            for path in paths:
                if _identity(path) != before[path]:
                    Path(path).unlink(missing_ok=True)
        raise


def save_picture(frame: Any, temporary: Path, path: str) -> None:
    """Write ``frame`` to ``temporary``; errors name ``path``, which it stands for."""
    from clvol.image import save_frame

    try:
        save_frame(frame, temporary)
    except ClvolError as error:
        where = path if error.where == str(temporary) else error.where
        raise type(error)(where, error.what, error.expected) from error


def _identity(path: str) -> tuple[int, int] | None:
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino
