"""Checks and writes output files, which appear together or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from clvol.batch.names import numbered
from clvol.errors import UsageError
from clvol.inputs import Inputs, check_not_read

if TYPE_CHECKING:
    from clvol.scene import Scene


def scene_inputs(path: str, scene: Scene) -> Inputs:
    """All files that rendering ``scene``, loaded from the scene file or volume ``path``, reads."""
    return Inputs([path, *scene.input_paths])


def check_outputs(pictures: Sequence[str], others: Sequence[str]) -> None:
    """Raises UsageError, before the work, if one of the files could not be written later.

    ``pictures`` must have the ending of a picture, ``others`` may have any. No two may be the same file. Inside
    ``clvol.inputs.protected`` none may be an input.
    """
    from clvol.image import check_output, check_output_folder

    _check_apart([*pictures, *others])
    for path in pictures:
        check_output(path)
    for path in others:
        check_output_folder(path)


def _check_apart(paths: Iterable[str]) -> None:
    taken: set[object] = set()
    for path in paths:
        check_not_read(path)
        marks = _marks(path)
        if not taken.isdisjoint(marks):
            raise UsageError(path, "is given twice as an output", "a different file for each output")
        taken |= marks


def _marks(path: str) -> set[object]:
    """The real path of a file and, if it exists, its identity. Two names of one file share at least one of them."""
    if "\0" in path:
        return {path}
    identity = _identity(path)
    return {os.path.realpath(path)} if identity is None else {os.path.realpath(path), identity}


def check_frames(
    stills: Sequence[str], videos: Sequence[str], others: Sequence[str], count: int
) -> None:
    """Like ``check_outputs``, for an animation of ``count`` frames: every still must have the place of a number in its
    name, and no two of all files may be the same."""
    from clvol.image import ENDINGS, VIDEO_ENDINGS, check_output_folder

    for path in stills:
        if Path(path).suffix.lower() not in ENDINGS:
            what = f'unknown ending "{Path(path).suffix}"'
            raise UsageError(path, what, " or ".join([*ENDINGS, *VIDEO_ENDINGS]))
        if numbered(path, 0) == path:
            stem, ending = os.path.splitext(path)
            known = ", ".join(VIDEO_ENDINGS)
            expected = f"a name with a number such as {stem}_%04d{ending}, or one of {known}"
            raise UsageError(path, f"one name for {count} frames", expected)
    check_outputs([numbered(path, 0) for path in stills], [*videos, *others])
    taken = set().union(*(_marks(path) for path in [*videos, *others]))
    for path in stills:
        check_output_folder(numbered(path, count - 1))  # the longest name
        folder, name = os.path.split(path)
        folder = os.path.realpath(folder)
        for index in range(count):
            place = os.path.join(folder, numbered(name, index))
            is_there = os.path.lexists(place)
            marks = _marks(place) if is_there else {place}
            if not taken.isdisjoint(marks):
                raise UsageError(path, f"frame {index} is a file that is used already", "a different output file")
            if is_there:
                check_not_read(place)
            taken |= marks


REPORT = ("index.html", "tradeoff.json", "tradeoff.png")


def check_folder(folder: str) -> None:
    """Raises UsageError, before the work, if a report could not be written to ``folder`` later."""
    from clvol.image import check_output_folder

    if os.path.lexists(folder) and not os.path.isdir(folder):
        raise UsageError(folder, "is a file", "a folder, or the name of a new one")
    if not os.path.isdir(folder):
        check_output_folder(folder)
        return
    images = os.path.join(folder, "images")
    there = os.listdir(images) if os.path.isdir(images) else []
    for name in [*REPORT, *(f"images/{name}" for name in there if name.endswith(".png"))]:
        check_output_folder(os.path.join(folder, name))


def _identity(path: str) -> tuple[int, int] | None:
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino
