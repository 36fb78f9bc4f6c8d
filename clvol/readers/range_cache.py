"""The ranges of the steps of series, kept in the user's cache folder: finding them takes reading every voxel.

A step is found again by its path, its time, the settings with which it is read, and the size and time of its files.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clvol import cache_folder as folders
from clvol.readers.file_stamp import Stamp
from clvol.volume.axis import ValueAxis
from clvol.volume.grid import Grid
from clvol.volume.series_checks import StepRange
from clvol.volume.volume import ACCEPTED_TYPES, Volume

_FORMAT = 1
_LARGEST_FILE = 64 << 20
_EVERY = 10.0  # seconds between writes while a long series is read
_KEPT_DAYS = 90
Found = tuple[Volume, StepRange, Stamp, tuple[str, ...]]


class RangeCache:
    """The file of one series, by its first file and the settings; steps that are added later are looked for there, too.
    Nothing is raised where it cannot be read or written."""

    def __init__(self, files: Sequence[str], options: Mapping[str, Any], more: str = "") -> None:
        settings = sorted((key, repr(value)) for key, value in options.items() if key != "memory_cap")
        said = json.dumps([_FORMAT, os.path.dirname(os.path.abspath(files[0])), settings, more])
        self._name = f"{hashlib.blake2b(said.encode('utf-8', 'surrogatepass'), digest_size=16).hexdigest()}.json"
        self._entries: dict[str, Any] | None = None
        self._is_new = False
        self._written = time.monotonic()

    @property
    def file(self) -> Path | None:
        folder = folders.cache_folder()
        return None if folder is None else folder / "series" / self._name

    def find(self, path: str, number: int | None) -> Found | None:
        """What is known of a step; the caller compares the stamp."""
        entry = self._all().get(_key(path, number))
        try:
            return None if entry is None else _found(entry)
        except (KeyError, TypeError, ValueError):
            return None

    def add(
        self, path: str, number: int | None, volume: Volume, span: StepRange, stamp: Stamp, files: tuple[str, ...]
    ) -> None:
        grid = volume.grid
        self._all()[_key(path, number)] = {
            "shape": list(volume.shape), "dtype": volume.dtype.name, "spacing": list(grid.spacing),
            "origin": list(grid.origin), "direction": grid.direction.tolist(), "frame": volume.frame,
            "unit": volume.unit, "format": volume.format, "labels": volume.labels, "narrowed": volume.narrowed,
            "axis": [volume.slope, volume.offset],
            "span": None if span.span is None else list(span.span), "counts": [span.nans, span.infs],
            "stamp": [list(each) for each in stamp], "files": list(files),
        }  # fmt: skip
        self._is_new = True
        if time.monotonic() - self._written > _EVERY:
            self.write()

    def write(self) -> None:
        """Writes what was added."""
        file = self.file
        if not self._is_new or file is None:
            return
        self._is_new, self._written = False, time.monotonic()
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            _remove_old(file.parent)
            number, temporary = tempfile.mkstemp(prefix=".", suffix=".tmp", dir=file.parent)
            try:
                with open(number, "w", encoding="ascii") as out:
                    json.dump(self._all(), out)
                os.replace(temporary, file)
            except BaseException:
                os.unlink(temporary)
                raise
        except OSError:
            pass

    def _all(self) -> dict[str, Any]:
        if self._entries is None:
            self._entries = _read(self.file)
        return self._entries


def _key(path: str, number: int | None) -> str:
    return f"{os.path.abspath(path)}:{'' if number is None else number}"


def _read(file: Path | None) -> dict[str, Any]:
    try:
        if file is not None and file.stat().st_size <= _LARGEST_FILE:
            found = json.loads(file.read_text(encoding="ascii"))
            return found if isinstance(found, dict) else {}
    except (OSError, ValueError, RecursionError):
        pass
    return {}


def _found(entry: dict[str, Any]) -> Found:
    shape = tuple(int(n) for n in entry["shape"])
    if len(shape) != 3 or min(shape) < 1 or entry["dtype"] not in ACCEPTED_TYPES:
        raise ValueError(entry["dtype"])
    voxels = np.broadcast_to(np.zeros((), entry["dtype"]), shape)
    shell = Volume.__new__(Volume)
    vars(shell).update(
        data=voxels, name=None, path=None, format=entry["format"], frame=str(entry["frame"]), unit=entry["unit"],
        labels=bool(entry["labels"]), narrowed=bool(entry["narrowed"]), axis=ValueAxis(*entry["axis"]),
        grid=Grid(shape, entry["spacing"], entry["origin"], np.array(entry["direction"], float)),
    )  # fmt: skip
    span = None if entry["span"] is None else (float(entry["span"][0]), float(entry["span"][1]))
    nans, infs = (int(n) for n in entry["counts"])
    stamp = tuple((int(size), int(when)) for size, when in entry["stamp"])
    files = tuple(str(each) for each in entry["files"])
    return shell, StepRange(span, nans, infs, entry["dtype"]), stamp, files


def _remove_old(folder: Path) -> None:
    """Removes files that no series has written for long."""
    before = time.time() - _KEPT_DAYS * 86400
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.stat(follow_symlinks=False).st_mtime < before:
                os.unlink(entry.path)
