"""Building a store: region by region, in memory that does not grow with the volume; whole or not
there at all.

A region is one shard of level 0. All its levels and statistics are made at once, written to
STORE.partial, and then noted in the journal there: a file a region, with the statistics. What is
noted need not be made again when the building is interrupted. At the end the statistics become
arrays, the group's metadata are written, and the folder gets its name.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import shutil
import threading
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clvol import __version__
from clvol.errors import ClvolError, RenderError, UsageError, VolumeError
from clvol.interrupts import held
from clvol.store.arrays import NOT_UTF8, cores, is_utf8, open_array, system_words
from clvol.store.codecs import CODECS, DEFAULT, one_of_codecs
from clvol.store.geometry import EDGE
from clvol.store.layout import (
    JOURNAL,
    PARTIAL,
    ROOT,
    StoreLayout,
    check_layout,
    partial_path,
    root_metadata,
)
from clvol.store.places import TABLE, part_checksum, region_checksums, statistics_checksums
from clvol.store.resolutions import describe_region, with_neighbours
from clvol.store.source import BlockStatistics
from clvol.store.voxel_source import VolumeSource, VoxelSource
from clvol.store.zarr_store import StoredBlocks, is_store
from clvol.volume.axis import ValueAxis
from clvol.volume.volume import Volume

_BUILD = "build.json"
_LOCK = "lock"
_REPLACED = ".replaced"
_IN_HAND = 1 << 30  # bytes that all regions in work may take
_WORKERS = 4

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Unfinished:
    """A store that is not whole: ``done`` of ``total`` regions are."""

    done: int
    total: int


def unfinished(path: str | os.PathLike) -> Unfinished | None:
    """How far the building of the store ``path`` has come, if it was begun and has not come to its
    end."""
    journal = partial_path(Path(path)) / JOURNAL
    try:
        total = int(json.loads((journal / _BUILD).read_text(encoding="utf-8"))["regions"])
        done = sum(name.endswith(".npz") for name in os.listdir(journal))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return Unfinished(min(done, total), total)


def build_store(
    source: VoxelSource | Volume,
    path: str | os.PathLike,
    *,
    edge: int = EDGE,
    shard: int | None = None,
    codec: str = DEFAULT,
    overwrite: bool = False,
    restart: bool = False,
    progress: Progress | None = None,
    workers: int | None = None,
) -> StoredBlocks:
    """Writes the store ``path`` and opens it.

    ``edge``: voxels an axis of a block; ``shard``: of a file, a multiple of it (None: 128, or 256
    for long volumes); ``codec``: a name in ``codecs.CODECS``. ``overwrite`` replaces a store that
    is there, once the new one is whole. What an interrupted call with the same source and settings
    has left in PATH.partial is gone on with; ``restart`` throws it away. ``progress(done, total)``
    counts regions; what it raises interrupts. ``workers``: threads.

    Raises UsageError where no store can be written as asked, VolumeError where the source cannot be
    read, and RenderError where writing fails (a full disk): then PATH.partial stays, and the same
    call goes on with it.
    """
    if isinstance(source, Volume):
        source = VolumeSource(source)
    if codec not in CODECS:
        raise UsageError("codec", f"got {codec!r}", one_of_codecs())
    layout = check_layout(source.shape, source.dtype, edge, shard, CODECS[codec])
    path = Path(path)
    check_place(path, overwrite)
    with _writing(path), _locked(partial_path(path)) as partial:
        build = _Build(source, layout, partial, codec)
        try:
            build.begin(path, restart)
            build.make_regions(progress, workers)
            build.finish(path, overwrite)
        except BaseException:
            if not build.anything_done():
                build.discard()
            raise
    return StoredBlocks(path)


def places_of(path: Path) -> tuple[Path, Path, Path]:
    """The folders that writing the store ``path`` makes or removes: the store, where it is built,
    and where a store that it replaces goes."""
    return path, partial_path(path), _replaced_path(path)


def _replaced_path(path: Path) -> Path:
    return path.with_name(path.name + _REPLACED)


def check_place(path: Path, overwrite: bool) -> None:
    """UsageError now, before the work, if the store could not be written to ``path``."""
    try:
        _check_place(path, overwrite)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        what = f"no folder can have this name: {why}"
        raise UsageError(str(path), what, "the name of a new folder") from None


def _check_place(path: Path, overwrite: bool) -> None:
    if not is_utf8(str(path.absolute())):
        raise UsageError(str(path), NOT_UTF8, "a name in UTF-8")
    if not path.name or path.name.endswith((PARTIAL, _REPLACED)):
        raise UsageError(str(path), "no name for a store", f"a name that does not end in {PARTIAL}")
    parent = path.parent
    if not parent.is_dir():
        what = "not a folder" if parent.exists() else "no such folder"
        raise UsageError(str(path), f"{parent}: {what}", "a place in a folder that exists")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise UsageError(str(path), f"{parent} cannot be written to", "a folder that can")
    for place in places_of(path):
        try:
            os.lstat(place)  # a name that is too long is known now
        except FileNotFoundError:
            pass
    partial, replaced = partial_path(path), _replaced_path(path)
    if os.path.lexists(replaced) and (replaced.is_symlink() or not is_store(replaced)):
        what = f"{replaced.name}, where a store that is replaced goes, is something else"
        raise UsageError(str(path), what, "another name")
    if os.path.lexists(partial) and not _is_ours(partial):
        what = f"{partial.name}, where it is built, is something else"
        raise UsageError(str(path), what, "another name")
    if not os.path.lexists(path):
        return
    if path.is_symlink() or not path.is_dir():
        raise UsageError(str(path), "got a file", "a name for a new folder")
    if not overwrite:
        raise UsageError(str(path), "exists already", "a new name, or --overwrite")
    if not is_store(path):
        raise UsageError(
            str(path), "a folder that is no store", "a store to overwrite, or a new name"
        )


def _is_ours(partial: Path) -> bool:
    """Whether ``partial`` is the folder of a building, or what one leaves that is killed as it begins or
    as it clears away: no more than empty folders and descriptions of levels."""
    if partial.is_symlink() or not partial.is_dir():
        return False
    if (partial / JOURNAL).is_dir():
        return True
    for entry in partial.rglob("*"):
        level, *inner = entry.relative_to(partial).parts
        if entry.is_symlink() or not re.fullmatch("[0-9]+|blocks", level):
            return False
        if not entry.is_dir() and not (len(inner) == 1 and re.match(rf"{ROOT}(\.__lock)?$", inner[0])):
            return False
    return True


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """What the system refuses while writing becomes one RenderError."""
    try:
        yield
    except ClvolError:
        raise
    except OSError as error:
        raise _not_written(path, error.strerror or str(error)) from error
    except ValueError as error:  # tensorstore's
        raise _not_written(path, system_words(str(error))) from error


def _not_written(path: Path, reason: str) -> RenderError:
    kept = partial_path(path)
    kept = f"; {kept.name} keeps what is done" if kept.exists() else ""
    expected = f"a disk that takes it{kept}"
    return RenderError(str(path), f"the store cannot be written: {reason}", expected)


@contextmanager
def _locked(partial: Path) -> Iterator[Path]:
    """The folder ``partial``, made if it is not there, and nobody else's for the time."""
    with held():
        (partial / JOURNAL).mkdir(parents=True, exist_ok=True)
    with (partial / JOURNAL / _LOCK).open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
                raise
            raise UsageError(
                str(partial), "another process is building it", "one at a time"
            ) from None
        yield partial


class _Build:
    """One building of a store, in the folder ``partial``."""

    def __init__(self, source: VoxelSource, layout: StoreLayout, partial: Path, codec: str) -> None:
        self.source, self.layout, self.partial = source, layout, partial
        self.journal = partial / JOURNAL
        self.codec = codec
        self.count = int(np.prod(layout.regions))
        self.levels: list = []
        self._stop = threading.Event()

    # ---- beginning ----

    def begin(self, path: Path, restart: bool) -> None:
        """Goes on with what ``partial`` holds, or begins; UsageError if it is of something else."""
        plan = self._plan()
        before = None if restart else self._plan_before()
        if before is not None and before != plan:
            differing = [key for key in plan if before.get(key) != plan[key]]
            other = "another volume" if "source" in differing else "other settings"
            what = f"{self.partial.name} is an unfinished store of {other} ({', '.join(differing)})"
            raise UsageError(str(path), what, "the same as before, or --restart to begin anew")
        if before is None:
            self._clear()
            _write_whole(self.journal / _BUILD, json.dumps(plan, indent=2))
        for left in self.partial.rglob("*.__lock"):  # tensorstore's, of writes that were killed
            left.unlink()
        layout = self.layout
        for level in range(layout.blocks.levels):
            metadata = layout.level_metadata(level)
            with held():  # else tensorstore goes on making the folder that is removed
                self.levels.append(open_array(self.partial / str(level), metadata))

    def _plan(self) -> dict:
        layout, grid = self.layout, self.source.grid
        plan = {
            "clvol": __version__, "source": self.source.identity, "name": self.source.name,
            "shape": layout.shape, "dtype": layout.dtype.name,
            "spacing": grid.spacing, "origin": grid.origin, "direction": grid.direction.tolist(),
            "edge": layout.edge, "shard": layout.shard, "codec": self.codec, "regions": self.count,
        }  # fmt: skip
        return json.loads(json.dumps(plan))

    def _plan_before(self) -> dict | None:
        try:
            before = json.loads((self.journal / _BUILD).read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError):
            return None
        return before if isinstance(before, dict) else None

    def _clear(self) -> None:
        for entry in self.partial.iterdir():
            if entry.name != JOURNAL:
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
        for entry in self.journal.iterdir():
            if entry.name != _LOCK:
                entry.unlink()

    # ---- regions ----

    def make_regions(self, progress: Progress | None, workers: int | None) -> None:
        """All regions that the journal does not have, by several threads."""
        left = [index for index in range(self.count) if self._noted(index, read=True) is None]
        done = self.count - len(left)
        if progress is not None:
            progress(done, self.count)
        workers = self._workers() if workers is None else workers
        executor = ThreadPoolExecutor(workers, "store")
        pending: set[Future] = set()
        queue = iter(left)
        try:
            for index in queue:
                pending.add(executor.submit(self._make_region, index))
                if len(pending) > workers:
                    done += self._finished(pending, progress, done)
            while pending:
                done += self._finished(pending, progress, done)
        finally:
            self._stop.set()
            executor.shutdown(wait=True, cancel_futures=True)

    def _finished(self, pending: set[Future], progress: Progress | None, done: int) -> int:
        """Waits for one or more of ``pending``; how many."""
        ready, _ = wait(pending, return_when=FIRST_COMPLETED)
        pending -= ready
        for k, future in enumerate(ready, 1):
            future.result()
            if progress is not None:
                progress(done + k, self.count)
        if hasattr(self.source, "forget"):
            self.source.forget()
        return len(ready)

    def _workers(self) -> int:
        """Threads, so many that what they have in hand stays bounded."""
        region = (self.layout.shard + 2) ** 3 * self.layout.dtype.itemsize
        return int(np.clip(_IN_HAND // (3 * region), 1, min(cores(), _WORKERS)))

    def _make_region(self, index: int) -> None:
        if self._stop.is_set():
            return
        layout = self.layout
        box = layout.region(index)
        around, inner = with_neighbours(layout.shape, box)
        voxels = self._voxels(around)
        levels, statistics = describe_region(voxels, inner, layout.edge)
        for level in range(len(levels)):  # left by an interrupted call, and perhaps not whole
            (self.partial / layout.shard_file(index, level)).unlink(missing_ok=True)
        futures = [
            array[layout.region(index, level)].write(self._stored(level, samples))
            for level, (array, samples) in enumerate(zip(self.levels, levels))
        ]
        census = _census(levels[0], statistics)
        for future in futures:
            future.result()
        self._note(index, statistics, census)

    def _voxels(self, around: tuple[slice, slice, slice]) -> np.ndarray:
        bounds = [n for s in around for n in (s.start, s.stop)]
        voxels = self.source.box(*bounds)
        wanted = tuple(s.stop - s.start for s in around)
        if voxels.shape != wanted or voxels.dtype != self.layout.dtype:
            what = f"a box of {voxels.shape} {voxels.dtype}"
            raise VolumeError(self.source.name or "source", what, f"{wanted} {self.layout.dtype}")
        return voxels

    def _stored(self, level: int, samples: np.ndarray) -> np.ndarray:
        payload = self.layout.codecs[level].payload
        if payload is None:
            return samples
        return payload.encode(samples, self.layout.parameters[level])

    # ---- the journal ----

    def discard(self) -> None:
        """Removes the folder; what tells that it is ours last, so that one that is killed here is known again."""
        for entry in self.partial.iterdir():
            if entry.name != JOURNAL:
                _remove(entry) if entry.is_dir() else entry.unlink(missing_ok=True)
        _remove(self.partial)

    def anything_done(self) -> bool:
        return any(self.journal.glob("*.npz"))

    def _note(self, index: int, statistics: BlockStatistics, census: np.ndarray) -> None:
        """In one step: the region is on the disk, with these sizes and checksums of files."""
        region = [-(-(s.stop - s.start) // self.layout.edge) for s in self.layout.region(index)]
        members = {
            name: getattr(statistics, name)
            .astype(dtype)
            .reshape(self.layout.statistics_shape(name, tuple(region)))
            for name, dtype in self.layout.statistics_types.items()
        }
        file = self.journal / f"{index}.npz"
        temporary = file.with_suffix(".writing")
        with temporary.open("wb") as stream:
            known = {"place": index, "sizes": self._sizes(index), "checksums": self._checksums(index)}
            np.savez(stream, census=census, **known, **members)
        os.replace(temporary, file)

    def _sizes(self, index: int) -> np.ndarray:
        files = [
            self.partial / self.layout.shard_file(index, n)
            for n in range(self.layout.blocks.levels)
        ]
        return np.array([file.stat().st_size if file.exists() else -1 for file in files], np.int64)

    def _checksums(self, index: int) -> np.ndarray:
        return region_checksums(self.partial, self.layout, index)

    def _noted(self, index: int, read: bool = False) -> np.ndarray | None:
        """The census of a region that is done, its files as they were then. ``read``: by what they hold, too, not
        by their sizes alone."""
        try:
            with np.load(self.journal / f"{index}.npz") as noted:
                same = noted["place"] == index and np.array_equal(noted["sizes"], self._sizes(index))
                if same and read:
                    same = np.array_equal(noted["checksums"], self._checksums(index))
                return noted["census"] if same else None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    # ---- the end ----

    def finish(self, path: Path, overwrite: bool) -> None:
        """Statistics, metadata, and the store's name."""
        for name in self.layout.statistics_types:
            self._write_statistics(name)
        group = {"zarr_format": 3, "node_type": "group", "attributes": {}}
        _write_whole(self.partial / "blocks" / ROOT, json.dumps(group, indent=2))
        axis = getattr(self.source, "axis", ValueAxis())
        facts = {**self._facts(), "slope": axis.slope, "offset": axis.offset}
        facts["unit"] = getattr(self.source, "unit", None)
        facts["checksums"] = self._write_table()
        root = root_metadata(
            self.layout,
            self.source.grid,
            self.source.name,
            self.source.frame,
            facts,
            f"clvol {__version__}",
        )
        _write_whole(self.partial / ROOT, json.dumps(root, indent=2))
        replaced = _replaced_path(path)
        check_place(path, overwrite)  # again: it may have appeared meanwhile
        _remove(replaced)
        if path.exists():
            os.rename(path, replaced)
        try:
            os.rename(self.partial, path)
        except BaseException:
            if replaced.exists() and not path.exists():
                os.rename(replaced, path)
            raise
        _sync_folder(path.parent)
        _remove(path / JOURNAL)
        _remove(replaced)

    def _write_statistics(self, name: str) -> None:
        layout = self.layout
        array = open_array(self.partial / "blocks" / name, layout.statistics_metadata(name))
        nz, ny, nx = layout.regions
        edge, (bz, by, bx) = layout.edge, layout.blocks.counts
        rows = layout.shard // edge
        by_level = array.rank > 3
        for z in range(nz):
            depth = min(rows, bz - z * rows)
            plane = np.empty(
                layout.statistics_shape(name, (depth, by, bx)), layout.statistics_types[name]
            )
            for index in range(z * ny * nx, (z + 1) * ny * nx):
                _, y, x = (slice(s.start // edge, -(-s.stop // edge)) for s in layout.region(index))
                with np.load(self.journal / f"{index}.npz") as noted:
                    plane[(slice(None),) * (2 if by_level else 1) + (y, x)] = noted[name]
            here = slice(z * rows, z * rows + depth)
            (array[:, here] if by_level else array[here]).write(plane).result()

    def _write_table(self) -> dict:
        """The table of checksums; what the root says of it, and of the statistics."""
        layout, parts = self.layout, []
        array = open_array(self.partial / "blocks" / TABLE, layout.table_metadata())
        for first in range(0, self.count, layout.table_rows):
            last = min(first + layout.table_rows, self.count)
            rows = []
            for index in range(first, last):
                with np.load(self.journal / f"{index}.npz") as noted:
                    rows.append(noted["checksums"])
            array[first:last].write(np.stack(rows)).result()
            parts.append(part_checksum(np.stack(rows)))
        return {"table": parts, "statistics": statistics_checksums(self.partial, layout)}

    def _facts(self) -> dict:
        """Range and counts of all voxels."""
        noted = [self._noted(index) for index in range(self.count)]
        if any(census is None for census in noted):
            raise RenderError(
                str(self.partial), "changed by another while it was built", "left alone"
            )
        census = np.stack(noted)
        low, high = float(census[:, 0].min()), float(census[:, 1].max())
        if low > high:
            low = high = 0.0
        return {
            "value_range": [low, high],
            "nan_count": int(census[:, 2].sum()),
            "inf_count": int(census[:, 3].sum()),
        }


def _census(voxels: np.ndarray, statistics: BlockStatistics) -> np.ndarray:
    """float64 [4]: smallest and largest finite voxel (inf, -inf if there is none), how many are
    NaN, and infinite."""
    low, high = statistics.minimum[0], statistics.maximum[0]
    known = ~np.isnan(low)
    range_ = (low[known].min(), high[known].max()) if known.any() else (np.inf, -np.inf)
    if not statistics.holes.any():
        return np.array([*range_, 0, 0], np.float64)
    return np.array([*range_, np.isnan(voxels).sum(), np.isinf(voxels).sum()], np.float64)


def _write_whole(path: Path, text: str) -> None:
    """In one step."""
    temporary = path.with_name(path.name + ".writing")
    with temporary.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def _sync_folder(path: Path) -> None:
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _remove(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)
