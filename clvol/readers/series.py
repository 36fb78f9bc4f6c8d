"""Series of volumes in files: a pattern or a list of files, or one file with an axis of times."""

from __future__ import annotations

import glob
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from clvol.errors import ClvolWarning, SceneError, VolumeError
from clvol.quietly import FILTERS
from clvol.readers import is_url, read_volume
from clvol.readers.file_stamp import Stamp, stamp_of
from clvol.readers.forward import ForwardReader, forward
from clvol.readers.options import ALL_TIMES, SeveralTimes
from clvol.readers.range_cache import RangeCache
from clvol.readers.slice_names import natural
from clvol.volume.series import VolumeSeries
from clvol.volume.series_checks import StepRange
from clvol.volume.series_steps import Step
from clvol.volume.volume import Volume

MOST_STEPS = 100_000
Finish = Callable[[Volume], Volume]


def is_pattern(file: str, folder: str | os.PathLike = "") -> bool:
    """Whether ``file`` is a pattern of names: it has ``*``, ``?`` or ``[``, and no file has exactly this name."""
    return glob.has_magic(file) and not is_url(file) and not os.path.lexists(os.path.join(folder, file))


def files_of(files: Sequence[str], folder: str | os.PathLike, where: str) -> list[str]:
    """The paths of the steps that ``files`` name, in order; those of a pattern in natural order (t_2 before t_10).

    SceneError, at the key ``where``, for a pattern that names no file, or one only.
    """
    found: list[str] = []
    for file in files:
        if is_url(file) or not is_pattern(file, folder):
            found.append(file if is_url(file) else os.path.join(folder, file))
            continue
        base = glob.escape(os.fspath(folder)) if os.fspath(folder) not in ("", ".") else ""
        matches = sorted(glob.glob(os.path.join(base, file), recursive=True), key=natural)
        if len(matches) < 2:
            said = "no file is" if not matches else f"only {matches[0]!r} is"
            raise SceneError(where, f"{said} named like {file!r}", "a pattern of two files or more, such as 't_*.nrrd'")
        found += matches
    if len(found) > MOST_STEPS:
        raise SceneError(where, f"{len(found)} files", f"at most {MOST_STEPS}")
    return found


def named_files(file: str | Sequence[str] | None, folder: str | os.PathLike) -> list[str]:
    """As ``files_of``, for what need not be there: a pattern that names nothing stands for itself."""
    found: list[str] = []
    for each in () if file is None else (file,) if isinstance(file, str) else file:
        try:
            found += files_of([each], folder, "")
        except SceneError:
            found.append(each)
    return found


def times_of(path: str, options: Mapping[str, Any]) -> list[tuple[int, str | None]]:
    """Number and name (or None) of each time in a file; nothing where it has no axis of times. ``options``: those of
    ``read_volume``. VolumeError for a file that cannot be read."""
    try:
        read_volume(path, **{**options, "time": ALL_TIMES})
    except SeveralTimes as several:
        return list(zip(several.numbers, several.names))
    return []


def file_series(
    files: Sequence[str],
    options: Mapping[str, Any],
    *,
    name: str | None = None,
    finish: tuple[str, Finish] | None = None,
    value_range: Sequence[float] | None = None,
) -> VolumeSeries:
    """The series of ``files``: paths or URLs, a step each. One file with ``options["time"]`` ``ALL_TIMES``: a step for
    each of its times. ``options``: those of ``read_volume``; ``finish``: a name that says what it does,
    and a function that is applied to each volume.

    VolumeError for a single file that cannot be read.
    """
    if options.get("time") == ALL_TIMES:
        (path,) = files
        times = times_of(path, options)
        sources = [_Source(path, {**options, "time": number}, number, name) for number, name in times]
        if len(times) < 2:
            sources = [_Source(path, {**options, "time": None}, None, None)]
    else:
        sources = [_Source(path, options, None, None) for path in files]
    cache = RangeCache(files, options, "" if finish is None else finish[0])
    files_read = _FilesRead(None if finish is None else finish[1])
    steps = [_step(source, files_read, cache) for source in sources]
    series = VolumeSeries.of_steps(steps, name, value_range)
    series.surveyed = cache.write
    return series


@dataclass(frozen=True)
class _Source:
    """Where a step is: a file, and the number and the name of its time, if it has several."""

    path: str
    options: Mapping[str, Any]
    time: int | None
    time_name: str | None

    @property
    def name(self) -> str:
        """For messages: the path where no other says more."""
        if self.time is None:
            return self.path
        return f"{self.path}: time {self.time}" + (f" ({self.time_name})" if self.time_name else "")

    @property
    def spellings(self) -> tuple[str, ...]:
        if self.time is not None:
            return () if self.time_name is None else (self.time_name,)
        base = os.path.basename(self.path.rstrip("/"))
        return tuple(dict.fromkeys((self.path, base, base.partition(".")[0], os.path.splitext(base)[0])))


def _step(source: _Source, files_read: _FilesRead, cache: RangeCache) -> Step:
    name = source.name
    return Step(
        name,
        partial(files_read.read, source, name),
        None if is_url(source.path) else source.path,
        spellings=source.spellings,
        # Integers are narrowed, and get a type for holes, by their values: those of one file are one type.
        may_convert=source.time is not None,
        known=partial(_known, source, files_read, cache),
        remember=partial(_remember, source, files_read, cache),
    )


@dataclass
class _FilesRead:
    """The files of a series, as they were when they were first looked at."""

    finish: Finish | None
    stamps: dict[str, Stamp | None] = field(default_factory=dict)
    beside: dict[str, tuple[str, ...]] = field(default_factory=dict)  # further files with the voxels of one
    told: set[str] = field(default_factory=set)
    forward: ForwardReader = field(default_factory=ForwardReader)

    def read(self, source: _Source, name: str) -> Volume:
        """VolumeError, which names the step, if the file cannot be read, or has changed."""
        path = source.path
        before = stamp_of(path, self.beside.get(path, ()))
        seen = self.stamps.get(path)
        if seen is not None and before != seen:
            raise VolumeError(name, "has changed since it was read first", "files that stay as they are")
        try:
            with forward(self.forward):
                volume, notes = read_volume(path, **source.options)
        except VolumeError as error:
            own = error.where in (path, name)
            raise VolumeError(name, error.what if own else f"{error.where}: {error.what}", error.expected) from error
        if self.finish is not None:
            volume = self.finish(volume)
        files = tuple(volume.files)
        if files and path not in self.beside:
            self.beside[path] = files
            before = stamp_of(path, files)
        if stamp_of(path, self.beside.get(path, ())) != before:
            raise VolumeError(name, "has changed while it was read", "files that stay as they are")
        self.stamps[path] = before
        for text in notes:
            if text not in self.told:
                self.told.add(text)
                with FILTERS:
                    warnings.warn(ClvolWarning(path, text), stacklevel=2)
        return volume


def _known(source: _Source, files_read: _FilesRead, cache: RangeCache) -> tuple[Volume, StepRange] | None:
    found = cache.find(source.path, source.time)
    if found is None:
        return None
    volume, span, stamp, files = found
    if stamp_of(source.path, files) != stamp or files_read.stamps.get(source.path) not in (None, stamp):
        return None
    files_read.stamps[source.path], files_read.beside[source.path] = stamp, files
    return volume, span


def _remember(source: _Source, files_read: _FilesRead, cache: RangeCache, volume: Volume, span: StepRange) -> None:
    stamp = files_read.stamps.get(source.path)
    if stamp is not None and getattr(volume, "blocks_source", None) is None:
        cache.add(source.path, source.time, volume, span, stamp, files_read.beside.get(source.path, ()))


def series_name(files: Sequence[str]) -> str | None:
    """What the names of ``files`` have in common, without the number at the end."""
    names = [Path(file).name for file in files]
    common = os.path.commonprefix(names) if len(names) > 1 else names[0]
    return common.rstrip("0123456789").rstrip("_-. ") or None
