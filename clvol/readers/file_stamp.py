"""By what a file is recognised as unchanged without reading it: its size and its time of change."""

from __future__ import annotations

import os
from collections.abc import Sequence

from clvol.readers.remote import is_url

Stamp = tuple[tuple[int, int], ...]
_MOST_FILES = 4096  # of a folder; more take too long to look at for every step


def stamp_of(path: str, beside: Sequence[str] = ()) -> Stamp | None:
    """Sizes and times (ns) of the file, or of those in the folder, ``path``, and of the files ``beside`` it. None where
    they cannot be told: for a URL, a file that is missing, and a folder of very many files."""
    if is_url(path):
        return None
    found: list[tuple[int, int]] = []
    try:
        for each in (path, *beside):
            if os.path.isdir(each):
                if not _add_folder(each, found):
                    return None
            else:
                fact = os.stat(each)
                found.append((fact.st_size, fact.st_mtime_ns))
    except OSError:
        return None
    return tuple(found)


def _add_folder(folder: str, found: list[tuple[int, int]]) -> bool:
    """Adds what is in ``folder``, in the order of names; False if there are too many files."""
    for place, folders, names in os.walk(folder):
        folders.sort()
        if len(found) + len(names) > _MOST_FILES:
            return False
        for name in sorted(names):
            fact = os.stat(os.path.join(place, name))
            found.append((fact.st_size, fact.st_mtime_ns))
    return True
