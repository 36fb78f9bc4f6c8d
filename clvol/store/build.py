"""Building a store region by region, in memory that does not grow with the volume. A store appears complete or not at
all.

A region is one shard of level 0. All its levels and statistics are made at once, written to STORE.partial, and then
recorded in the journal there, so that an interrupted build does not repeat them. At the end the statistics become
arrays, the group's metadata are written, and the folder is renamed.
"""

from __future__ import annotations

import json
import os
import shutil
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clvol import __version__
from clvol.errors import ClvolError, ClvolWarning, RenderError, UsageError, VolumeError
from clvol.interrupts import held
from clvol.store.arrays import cores, open_array, system_words
from clvol.store.build_folder import check_place, locked, replaced_path
from clvol.store.codecs import CODECS, CODES, DEFAULT, one_of_codecs
from clvol.store.codecs.coded_blocks import RateTarget
from clvol.store.codecs.encoding import Trainer
from clvol.store.coding import REACH, Coding, check_target, merged_reach
from clvol.store.format import JOURNAL, ROOT, StoreLayout, check_layout, partial_path, root_metadata
from clvol.store.geometry import EDGE
from clvol.store.journal import Journal, write_whole
from clvol.store.places import TABLE, part_checksum, statistics_checksums
from clvol.store.resolutions import describe_region, finite_range, with_neighbours
from clvol.store.source import BlockStatistics
from clvol.store.steps import Progress, Steps
from clvol.store.stored_codes import CodesFacts, codebooks_json, codes_json, sizes_on_disk, write_codebooks
from clvol.store.voxel_source import VolumeSource, VoxelSource
from clvol.store.zarr_store import StoredBlocks
from clvol.volume.axis import ValueAxis
from clvol.volume.volume import Volume

_IN_HAND = 1 << 30  # bytes that all regions being made may take
_WORKERS = 4


def build_store(
    source: VoxelSource | Volume,
    path: str | os.PathLike,
    *,
    edge: int = EDGE,
    shard: int | None = None,
    codec: str = DEFAULT,
    target: RateTarget | None = None,
    trainer: Trainer | None = None,
    seed: int = 0,
    overwrite: bool = False,
    restart: bool = False,
    progress: Progress | None = None,
    on_phase: Callable[[str], None] | None = None,
    workers: int | None = None,
) -> StoredBlocks:
    """Builds the store ``path`` and opens it.

    ``edge``: voxels per axis of a block; ``shard``: voxels per axis of a file, a multiple of ``edge`` (None: 128, or
    256 for long volumes); ``codec``: a name in ``codecs.CODECS`` or ``codecs.CODES``. Of the latter, those that know
    a ``target`` need a ``trainer`` and take ``seed``; they hold float64 as float32 (a ClvolWarning), and refuse labels.
    ``overwrite`` replaces an existing store once the new one is complete. Work that an interrupted call with the same
    source and settings has left in PATH.partial is resumed; ``restart`` discards it. ``progress(done, total)`` counts
    regions, or with codes steps of all phases; an exception that it raises interrupts the build. ``on_phase`` is called
    with the name of each phase of making codes, when it begins: "measuring", "training", "encoding", "describing".
    ``workers``: number of threads.

    Raises UsageError if such a store cannot be written, VolumeError if the source cannot be read, and RenderError if
    writing fails (a full disk), or if decoded voxels break the bound of ``target``. In the former case PATH.partial is
    kept, and the same call resumes. Warns (ClvolWarning) if what was measured misses the ``target``.
    """
    voxels = VolumeSource(source) if isinstance(source, Volume) else source
    chosen = CODECS.get(codec) or CODES.get(codec)
    if chosen is None:
        raise UsageError("codec", f"got {codec!r}", one_of_codecs())
    target = check_target(chosen, target)
    layout = check_layout(voxels.shape, voxels.dtype, edge, shard, chosen)
    coding = Coding(voxels, layout, target, trainer, seed) if chosen.coded else None
    path = Path(path)
    check_place(path, overwrite)
    with _writing(path), locked(partial_path(path)) as partial:
        build = _Build(voxels, layout, partial, codec, coding)
        steps = Steps(build.count, coding is not None, progress, on_phase)
        try:
            build.begin(path, restart)
            if coding is not None:
                build.prepare_codes(steps, workers)
            build.make_regions(steps, workers)
            build.finish(path, overwrite, steps)
        except BaseException:
            if build.is_hopeless or not build.journal.anything_done():
                build.discard()
            raise
    store = StoredBlocks(path)
    if store.codes is not None and (missed := store.codes.missed_target) is not None:
        warnings.warn(ClvolWarning(str(path), *missed), stacklevel=2)
    return store


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """A context that turns errors of the system while writing into one RenderError."""
    try:
        yield
    except ClvolError:
        raise
    except OSError as error:
        raise _not_written(path, error.strerror or str(error)) from error
    except ValueError as error:  # tensorstore's
        raise _not_written(path, system_words(str(error))) from error


def _not_written(path: Path, reason: str) -> RenderError:
    partial = partial_path(path)
    kept = f"; {partial.name} keeps what is done" if partial.exists() else ""
    expected = f"a disk that takes it{kept}"
    return RenderError(str(path), f"the store cannot be written: {reason}", expected)


class _Build:
    """The state of building a store in the folder ``partial``."""

    def __init__(
        self, source: VoxelSource, layout: StoreLayout, partial: Path, codec: str, coding: Coding | None
    ) -> None:
        self.source, self.layout, self.partial, self.coding = source, layout, partial, coding
        self.journal = Journal(partial, layout)
        self.codec = codec
        self.count = int(np.prod(layout.regions))
        self.levels: list = []
        self._stop = threading.Event()
        self.is_hopeless = False  # the same call would fail again

    # ---- beginning ----

    def begin(self, path: Path, restart: bool) -> None:
        """Resumes the work in ``partial``, or begins; UsageError if it is of another source or has other settings."""
        plan = self._plan()
        before = None if restart else self.journal.plan()
        if before is not None and before != plan:
            differing = [key for key in plan if before.get(key) != plan[key]]
            other = "another volume" if "source" in differing else "other settings"
            what = f"{self.partial.name} is an unfinished store of {other} ({', '.join(differing)})"
            raise UsageError(str(path), what, "the same as before, or --restart to begin anew")
        if before is None:
            self._clear()
            self.journal.begin(plan)
        for left in self.partial.rglob("*.__lock"):  # left by tensorstore after killed writes
            left.unlink()
        layout = self.layout
        for level in range(layout.blocks.levels):
            metadata = layout.level_metadata(level)
            with held():  # otherwise tensorstore may create the folder again after its removal
                self.levels.append(open_array(self.partial / str(level), metadata))

    def _plan(self) -> dict:
        layout, grid = self.layout, self.source.grid
        plan = {
            "clvol": __version__, "source": self.source.identity, "name": self.source.name,
            "shape": layout.shape, "dtype": layout.dtype.name,
            "spacing": grid.spacing, "origin": grid.origin, "direction": grid.direction.tolist(),
            "edge": layout.edge, "shard": layout.shard, "codec": self.codec, "regions": self.count,
        }  # fmt: skip
        if self.coding is not None:
            plan |= self.coding.plan()
        return json.loads(json.dumps(plan))

    def _clear(self) -> None:
        for entry in self.partial.iterdir():
            if entry.name != JOURNAL:
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()

    # ---- regions ----

    def prepare_codes(self, steps: Steps, workers: int | None) -> None:
        """Finds the range of the voxels, and trains, unless the journal has both."""
        coding = self.coding
        assert coding is not None
        steps.begin("measuring")
        if not coding.known_range(self.journal):
            lows, highs = [np.inf], [-np.inf]

            def measure(index: int) -> None:
                low, high = finite_range(self._voxels(self.layout.region(index)))
                lows.append(low)
                highs.append(high)

            self._each(range(self.count), measure, steps, workers)
            coding.note_range(self.journal, min(lows), max(highs))
        steps.begin("training")
        try:
            coding.train(self.journal, steps.part)
        except UsageError:
            self.is_hopeless = True
            raise

    def make_regions(self, steps: Steps, workers: int | None) -> None:
        """Makes all regions that are not in the journal."""
        steps.begin("encoding")
        left = [index for index in range(self.count) if self.journal.census(index, read=True) is None]
        steps.add(self.count - len(left))
        self._each(left, self._make_region, steps, workers)
        if self.coding is not None and self.coding.gives_up(self._size_of_codes(self.coding), self.journal):
            self.make_regions(steps, workers)

    def _size_of_codes(self, coding: Coding) -> int:
        """Bytes of codes of level 0 and of codebooks."""
        assert coding.training is not None
        write_codebooks(self.partial, coding.training.codebooks)
        sizes = sizes_on_disk(self.partial)
        return sizes["codes"] + sizes["codebooks"]

    def _each(
        self, indices: Sequence[int], make: Callable[[int], None], steps: Steps, workers: int | None
    ) -> None:
        """Calls ``make`` with ``indices`` on several threads."""
        workers = self._workers() if workers is None else workers
        executor = ThreadPoolExecutor(workers, "store")
        pending: set[Future] = set()

        def unless_stopped(index: int) -> None:
            if not self._stop.is_set():
                make(index)

        try:
            for index in indices:
                pending.add(executor.submit(unless_stopped, index))
                if len(pending) > workers:
                    self._finished(pending, steps)
            while pending:
                self._finished(pending, steps)
        except BaseException:
            self._stop.set()
            raise
        finally:
            executor.shutdown(wait=True, cancel_futures=True)

    def _finished(self, pending: set[Future], steps: Steps) -> None:
        """Waits until some of ``pending`` are done."""
        ready, _ = wait(pending, return_when=FIRST_COMPLETED)
        pending -= ready
        for future in ready:
            future.result()
            steps.add(1)
        if hasattr(self.source, "forget"):
            self.source.forget()

    def _workers(self) -> int:
        """The largest number of threads that keeps the memory of all regions being made bounded."""
        region = (self.layout.shard + 2) ** 3 * self.layout.dtype.itemsize
        copies = 3 if self.coding is None else 8
        return int(np.clip(_IN_HAND // (copies * region), 1, min(cores(), _WORKERS)))

    def _make_region(self, index: int) -> None:
        layout = self.layout
        box = layout.region(index)
        more = None
        if self.coding is None:
            around, inner = with_neighbours(layout.shape, box)
            levels, statistics = describe_region(self._voxels(around), inner, layout.edge)
            voxels = levels[0]
        else:
            made = self.coding.make(self._voxels(box), tuple(s.start for s in box))
            levels, statistics, voxels, more = made.stored, made.statistics, made.decoded, made.more
        for level in range(len(levels)):  # left by an interrupted call, possibly incomplete
            (self.partial / layout.shard_file(index, level)).unlink(missing_ok=True)
        futures = [self._write(index, level, samples) for level, samples in enumerate(levels)]
        census = _census(voxels, statistics)
        for future in futures:
            future.result()
        self.journal.note(index, statistics, census, more)

    def _write(self, index: int, level: int, stored: np.ndarray) -> Any:
        return self.levels[level][self.layout.stored_region(index, level)].write(stored)

    def _voxels(self, around: tuple[slice, slice, slice]) -> np.ndarray:
        bounds = [n for s in around for n in (s.start, s.stop)]
        voxels = self.source.box(*bounds)
        wanted = tuple(s.stop - s.start for s in around)
        if voxels.shape != wanted or voxels.dtype != self.source.dtype:
            what = f"a box of {voxels.shape} {voxels.dtype}"
            raise VolumeError(self.source.name or "source", what, f"{wanted} {self.source.dtype}")
        return voxels

    # ---- the end ----

    def discard(self) -> None:
        """Removes the folder. The journal goes last, so that after a crash the folder is still recognised."""
        for entry in self.partial.iterdir():
            if entry.name != JOURNAL:
                _remove(entry) if entry.is_dir() else entry.unlink(missing_ok=True)
        _remove(self.partial)

    # ---- the end ----

    def finish(self, path: Path, overwrite: bool, steps: Steps) -> None:
        """Writes statistics and metadata, and renames the store to its final name."""
        steps.begin("describing")
        for name in self.layout.statistics_types:
            self._write_statistics(name)
        group = {"zarr_format": 3, "node_type": "group", "attributes": {}}
        write_whole(self.partial / "blocks" / ROOT, json.dumps(group, indent=2))
        axis = getattr(self.source, "axis", ValueAxis())
        facts = {**self._facts(), "slope": axis.slope, "offset": axis.offset}
        facts["unit"] = getattr(self.source, "unit", None)
        facts["checksums"] = self._write_table()
        if self.coding is not None:
            facts["codes"] = self._facts_of_codes(self.coding)
        root = root_metadata(
            self.layout,
            self.source.grid,
            self.source.name,
            self.source.frame,
            facts,
            f"clvol {__version__}",
        )
        write_whole(self.partial / ROOT, json.dumps(root, indent=2))
        steps.finish()
        replaced = replaced_path(path)
        check_place(path, overwrite)  # once more, since it may have appeared meanwhile
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
            if self.coding is not None and name in REACH:
                plane[...] = merged_reach(layout, self.journal.read, name, z)
                array[z * rows : z * rows + depth].write(plane).result()
                continue
            for index in range(z * ny * nx, (z + 1) * ny * nx):
                _, y, x = (slice(s.start // edge, -(-s.stop // edge)) for s in layout.region(index))
                plane[(slice(None),) * (2 if by_level else 1) + (y, x)] = self.journal.read(index, name)
            here = slice(z * rows, z * rows + depth)
            (array[:, here] if by_level else array[here]).write(plane).result()

    def _write_table(self) -> dict:
        """Writes the table of checksums; returns the checksums of it and of the statistics for the root."""
        layout, parts = self.layout, []
        array = open_array(self.partial / "blocks" / TABLE, layout.table_metadata())
        for first in range(0, self.count, layout.table_rows):
            last = min(first + layout.table_rows, self.count)
            rows = [self.journal.read(index, "checksums") for index in range(first, last)]
            array[first:last].write(np.stack(rows)).result()
            parts.append(part_checksum(np.stack(rows)))
        return {"table": parts, "statistics": statistics_checksums(self.partial, layout)}

    def _facts_of_codes(self, coding: Coding) -> dict:
        """Writes the codebooks; returns what the root says of codes."""
        training = coding.training
        assert training is not None
        errors = np.stack([self.journal.read(index, "errors") for index in range(self.count)])
        checksum = write_codebooks(self.partial, training.codebooks)
        measured = coding.measured(errors, sizes_on_disk(self.partial))
        return codes_json(
            CodesFacts(
                coding.codec, codebooks_json(training.codebooks), checksum, coding.seed, coding.target,
                training.policy, coding.original_dtype, coding.range, measured,
            )
        )  # fmt: skip

    def _facts(self) -> dict:
        """Range and counts of all voxels."""
        noted = [census for index in range(self.count) if (census := self.journal.census(index)) is not None]
        if len(noted) < self.count:
            raise RenderError(
                str(self.partial), "changed by another process during the build", "no other changes to it"
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
    """float64 [4]: smallest and largest finite voxel (inf, -inf if there is none), numbers of NaN and infinite
    voxels.
    """
    low, high = statistics.minimum[0], statistics.maximum[0]
    known = ~np.isnan(low)
    range_ = (low[known].min(), high[known].max()) if known.any() else (np.inf, -np.inf)
    if not statistics.holes.any():
        return np.array([*range_, 0, 0], np.float64)
    return np.array([*range_, np.isnan(voxels).sum(), np.isinf(voxels).sum()], np.float64)


def _sync_folder(path: Path) -> None:
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _remove(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)
