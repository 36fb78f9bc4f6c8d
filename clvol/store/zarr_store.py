"""A store on disk as a source of blocks. It is checked when it is opened, and again with every chunk that is read."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.store.arrays import open_array, read_json, what_failed
from clvol.store.codecs.coded_blocks import Codebooks, CodedBlocks
from clvol.store.format import JOURNAL, PARTIAL, ROOT, StoreFacts, parse_root, partial_path
from clvol.store.packs import unpacked
from clvol.store.places import TABLE, Places
from clvol.store.resolutions import whole_blocks
from clvol.store.source import BlockStatistics
from clvol.store.stored_codes import BlockCodes, CodesFacts, parse_codes, read_codebooks

_FLYING = 64 << 20  # bytes of samples in concurrent reads
_FLYING_READS = 256
_SHARD_SHARE = 0.25  # share of the chunks in a box above which reading the whole box is faster
_WANTED = "an undamaged store (clvol store --overwrite rebuilds it)"


def open_store(path: str | os.PathLike) -> StoredBlocks:
    """Opens the store in the folder ``path``; VolumeError if it is not a store, is incomplete, or has another
    version.
    """
    return StoredBlocks(path)


def is_store(path: str | os.PathLike) -> bool:
    """Whether the folder is a clvol store, complete or not, of any version."""
    path = Path(path)
    try:
        root = read_json(path / ROOT, str(path))
    except (OSError, ValueError, VolumeError):
        return is_unfinished(path)
    attributes = root.get("attributes") if isinstance(root, dict) else None
    return isinstance(attributes, dict) and "clvol" in attributes


def is_unfinished(path: Path) -> bool:
    """Whether the folder is an incomplete store."""
    return os.path.isdir(path / JOURNAL) and (
        path.name.endswith(PARTIAL) or not os.path.exists(path / ROOT)
    )


def check_finished(path: Path) -> None:
    """VolumeError if a store is incomplete, or if only its partial folder exists."""
    expected = "a whole store; the same 'clvol store' command again finishes it"
    if os.path.isdir(path):
        if is_unfinished(path):
            raise VolumeError(str(path), "an unfinished store", expected)
    elif path.name and not os.path.exists(path) and os.path.isdir(partial_path(path)):
        raise VolumeError(str(path), f"an unfinished store ({partial_path(path).name})", expected)


class StoredBlocks:
    """A store as a ``BlockSource``. Only some checksums are kept in memory.

    ``facts`` holds its metadata. ``checks_places``: whether data are proved to be in their positions (older stores
    cannot do so). ``codes`` is what the metadata say of codes, and ``codebooks`` are what decoding them needs (None for
    stores of samples); ``value_range``, counts and statistics are those of decoded samples.
    """

    def __init__(self, path: str | os.PathLike) -> None:
        self.path = Path(path)
        self._where = os.fspath(path)
        self.facts = self._checked_facts()
        facts = self.facts
        self.layout, self.blocks = facts.layout, facts.layout.blocks
        self.name = facts.name or self.path.resolve().name
        self.grid, self.dtype = facts.grid, facts.layout.dtype
        self.value_range = facts.value_range
        self.nan_count, self.inf_count = facts.nan_count, facts.inf_count
        self._levels = [self._array(str(level), level) for level in range(self.blocks.levels)]
        self.checks_places = facts.checksums is not None
        self._places: Places | None = None
        if facts.checksums is not None:
            table = self._array(f"blocks/{TABLE}")
            self._places = Places(
                self.path, self.layout, facts.checksums, lambda: table, self._where, _WANTED
            )
        self.codes: CodesFacts | None = None
        self.codebooks: Codebooks | None = None
        if self.layout.coded:
            self.codes = self._checked_codes(facts.codes)
            self.codebooks = read_codebooks(self.path, self.codes, self.dtype, self._where, _WANTED)
            self._decoder = BlockCodes(self.codebooks)

    def _checked_facts(self) -> StoreFacts:
        check_finished(self.path)
        try:
            root = read_json(self.path / ROOT, self._where)
        except FileNotFoundError:
            what = f"no {ROOT}" if os.path.isdir(self.path) else "no such folder"
            raise VolumeError(self._where, what, "a folder that clvol store has written") from None
        except OSError as error:
            raise VolumeError(self._where, error.strerror or str(error), "a store") from None
        return parse_root(root, self._where)

    def _checked_codes(self, own: Any) -> CodesFacts:
        try:
            return parse_codes(own, self.layout, self._where)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            detail = f"no {error.args[0]}" if isinstance(error, KeyError) else str(error)[:100]
            raise VolumeError(self._where, f"damaged zarr.json (codes: {detail})", _WANTED) from None

    def _array(self, name: str, level: int | None = None) -> Any:
        """The array of level ``level``, or the array ``name`` of statistics or checksums."""
        if name == f"blocks/{TABLE}":
            wanted = self.layout.table_metadata()
        elif level is None:
            wanted = self.layout.statistics_metadata(name.rpartition("/")[2])
        else:
            wanted = self.layout.level_metadata(level)
        try:
            array = open_array(self.path / name)
        except ValueError as error:
            raise VolumeError(
                self._where, f"array {name!r} {what_failed(error)}", _WANTED
            ) from None
        found = list(array.shape), array.dtype.name, list(array.chunk_layout.write_chunk.shape)
        expected = (
            wanted["shape"],
            wanted["data_type"],
            wanted["chunk_grid"]["configuration"]["chunk_shape"],
        )
        if list(found) != list(expected):
            shape = " x ".join(map(str, expected[0]))
            what = f"array {name!r} is {' x '.join(map(str, found[0]))} {found[1]}"
            raise VolumeError(
                self._where, what, f"{shape} {expected[1]} in shards as zarr.json says"
            )
        return array

    # ---- samples ----

    def read(self, level: int, blocks: np.ndarray) -> np.ndarray:
        """As ``BlockSource.read``: [k, s, s, s]. May be called by several threads."""
        s = self.blocks.samples(level)
        places = self.blocks.places(np.atleast_1d(np.asarray(blocks, np.int64)))
        out = np.empty((len(places), s, s, s), self.dtype)
        if self.layout.codecs[level].coded:
            for members, coded in self._coded(level, places):
                out[members] = self._decoder.decode(coded, s)
                self._repeat_last(level, places, members, out)
            return out
        for first, samples, members in self._boxes(level, places):
            if samples.shape == (s, s, s):
                out[members] = samples
                continue
            samples = whole_blocks(samples, s)
            z, y, x = (n // s for n in samples.shape)
            by_block = samples.reshape(z, s, y, s, x, s).transpose(0, 2, 4, 1, 3, 5)
            within = places[members] - first
            out[members] = by_block[within[:, 0], within[:, 1], within[:, 2]]
        return out

    def read_codes(self, level: int, blocks: np.ndarray) -> CodedBlocks:
        """The bytes of ``blocks`` (numbers, int64 [k]) at ``level``, one after the other in that order. They are
        possible codes. May be called by several threads. VolumeError names the block that cannot be read.

        Samples beyond the volume are what their codes say there, while ``read`` repeats the volume's last ones. Levels
        that hold samples (``layout.codecs[level].coded`` is false) have no codes: ValueError.
        """
        if not self.layout.codecs[level].coded:
            raise ValueError(f"level {level} holds samples")
        places = self.blocks.places(np.atleast_1d(np.asarray(blocks, np.int64)))
        parts: list = [None] * len(places)
        size = np.zeros(len(places), np.int64)
        for members, coded in self._coded(level, places):
            size[members] = coded.size
            for k, first, length in zip(members.tolist(), coded.start.tolist(), coded.size.tolist()):
                parts[k] = coded.data[first : first + length]
        data = np.concatenate(parts) if parts else np.empty(0, np.uint8)
        return CodedBlocks(data, np.cumsum(size) - size, size)

    def volume_level(self, level: int = 0) -> np.ndarray:
        """All samples [z, y, x] of a level: level 0 is the volume."""
        bounds = [n for end in self.blocks.level_shape(level) for n in (0, end)]
        return self._samples(level, *bounds)

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        """Voxels [z0:z1, y0:y1, x0:x1]."""
        return self._samples(0, z0, z1, y0, y1, x0, x1)

    def _samples(self, level: int, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        s = self.blocks.samples(level)
        low, high = np.array([z0, y0, x0]), np.array([z1, y1, x1])
        first, last = low // s, -(-high // s)
        within = np.stack(np.meshgrid(*map(np.arange, first, last), indexing="ij"), -1).reshape(
            -1, 3
        )
        out = np.empty(tuple(high - low), self.dtype)
        pieces: Iterator = (
            (place, samples)
            for members, coded in self._coded(level, within)
            for place, samples in zip(within[members], self._decoder.decode(coded, s))
        )
        if not self.layout.codecs[level].coded:
            pieces = ((place, samples) for place, samples, _ in self._boxes(level, within))
        for place, samples in pieces:
            start = place * s
            a = np.maximum(start, low)
            b = np.minimum(start + samples.shape, high)
            if (a < b).all():
                out[tuple(map(slice, a - low, b - low))] = samples[
                    tuple(map(slice, a - start, b - start))
                ]
        return out

    def _coded(self, level: int, places: np.ndarray) -> Iterator[tuple[np.ndarray, CodedBlocks]]:
        """The possible codes of blocks at ``places`` [k, 3], and which of these they are."""
        side, s = self.layout.pack, self.blocks.samples(level)
        for low, high, packs, members in self._chunks(level, places):
            own = places[members]
            pack = np.ravel_multi_index(tuple((own // side - low).T), tuple(high - low))
            slot = np.ravel_multi_index(tuple((own % side).T), (side,) * 3)
            coded = unpacked(packs.reshape(-1, self.layout.capacity(level)), pack, slot, side)
            impossible = self._decoder.impossible(coded, s)
            if len(impossible):
                block = tuple(own[impossible[0]].tolist())
                raise VolumeError(self._where, f"block {block} at level {level}: impossible codes", _WANTED)
            yield members, coded

    def _repeat_last(self, level: int, places: np.ndarray, members: np.ndarray, out: np.ndarray) -> None:
        """Repeats the volume's last samples beyond it in the blocks ``out[members]``."""
        s = self.blocks.samples(level)
        for axis, end in enumerate(self.blocks.level_shape(level)):
            if end % s:
                last = members[places[members, axis] == end // s]
                samples = np.moveaxis(out, axis + 1, 1)
                samples[last, end % s :] = samples[last, end % s - 1][:, None]

    def _boxes(
        self, level: int, places: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Boxes of samples that hold all blocks at ``places`` [k, 3]: the first block of each box, its samples (none
        beyond the array), and which of ``places`` are inside.
        """
        side = self.layout.chunk_blocks(level)
        for low, _, samples, members in self._chunks(level, places):
            yield low * side, samples, members

    def _chunks(
        self, level: int, places: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Boxes of chunks that hold all blocks at ``places`` [k, 3]: the first and last + 1 chunk of each box, what the
        level's array holds there, and which of ``places`` are inside. As many are read at a time as fit into _FLYING.
        """
        flying: deque = deque()
        size = 0
        for low, high, members, misplaced in self._plan(level, places):
            future, nbytes = self._start(level, low, high)
            flying.append((low, high, members, misplaced, future, nbytes))
            size += nbytes
            while flying and (size > _FLYING or len(flying) > _FLYING_READS):
                size -= flying[0][-1]
                yield from self._finish(level, places, *flying.popleft()[:-1])
        while flying:
            yield from self._finish(level, places, *flying.popleft()[:-1])

    def _plan(
        self, level: int, places: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Boxes of chunks to read: their first and last + 1 chunk, members as in ``_boxes``, and the chunks [n, 3] of
        these members that belong elsewhere. A box stays within a shard.
        """
        if not len(places):
            return
        per_chunk, per_shard = self.layout.chunk_blocks(level), self.layout.chunks(level)
        chunks = places // per_chunk
        counts = chunks.max(axis=0) + 1
        shards = chunks // per_shard
        # In the order of shards, then of chunks inside a shard.
        key = np.ravel_multi_index(tuple(shards.T), tuple(shards.max(axis=0) + 1)) * int(
            np.prod(counts)
        )
        key += np.ravel_multi_index(tuple(chunks.T), tuple(counts))
        order = np.argsort(key, kind="stable")
        same_shard = np.flatnonzero(np.diff(shards[order], axis=0).any(axis=1)) + 1
        buffer = bytearray()
        for members in np.split(order, same_shard):
            inside = chunks[members]
            misplaced = inside[:0]
            if self._places is not None:
                misplaced = inside[self._places.wrong(level, shards[members[0]], inside, buffer)]
            change = np.flatnonzero(np.diff(inside, axis=0).any(axis=1)) + 1
            low, high = inside.min(axis=0), inside.max(axis=0) + 1
            if len(change) + 1 >= _SHARD_SHARE * np.prod(high - low):
                yield low, high, members, misplaced
                continue
            for part in np.split(members, change):
                yield chunks[part[0]], chunks[part[0]] + 1, part, misplaced

    def _start(self, level: int, low: np.ndarray, high: np.ndarray) -> tuple[Any, int]:
        box: tuple[slice, ...]
        if self.layout.codecs[level].coded:
            box = self.layout.packs_region(level, low, high)
            return self._levels[level][box].read(), self.layout.capacity(level) * int(np.prod(high - low))
        side = self.layout.chunk(level)
        ends = self.blocks.level_shape(level)
        bounds = zip(low.tolist(), high.tolist(), ends)
        box = tuple(slice(a * side, min(b * side, n)) for a, b, n in bounds)
        nbytes = self.dtype.itemsize * math.prod(s.stop - s.start for s in box)
        return self._levels[level][box].read(), nbytes

    def _finish(
        self,
        level: int,
        places: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        members: np.ndarray,
        misplaced: np.ndarray,
        future: Any,
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        per_chunk = self.layout.chunk_blocks(level)
        try:
            stored = future.result()
            self._check_places(level, low, high, misplaced)
            yield low, high, stored, members
            return
        except ValueError as error:
            failure = error
        if (high - low == 1).all():
            block = tuple(int(n) for n in places[members[0]])
            what = f"block {block} at level {level}: {what_failed(failure)}"
            raise VolumeError(self._where, what, _WANTED) from None
        # A chunk of the box cannot be read. Reading chunks one by one shows which, and whether it is needed.
        chunks = places[members] // per_chunk
        for chunk in np.unique(chunks, axis=0):
            inside = members[(chunks == chunk).all(axis=1)]
            again = self._start(level, chunk, chunk + 1)[0]
            yield from self._finish(level, places, chunk, chunk + 1, inside, misplaced, again)

    def _check_places(
        self, level: int, low: np.ndarray, high: np.ndarray, misplaced: np.ndarray
    ) -> None:
        """VolumeError if any of the chunks ``misplaced`` [n, 3] lies between ``low`` and ``high`` [3]."""
        within = ((misplaced >= low) & (misplaced < high)).all(axis=1)
        if within.any():
            side = self.layout.chunk_blocks(level)
            block = tuple(int(n) for n in misplaced[within][0] * side)
            what = f"block {block} at level {level}: its data belong to another place"
            raise VolumeError(self._where, what, _WANTED)

    # ---- statistics ----

    @cached_property
    def _statistics(self) -> dict[str, Any]:
        return {name: self._array(f"blocks/{name}") for name in self.layout.statistics_types}

    def statistics(self) -> Iterator[BlockStatistics]:
        """As ``BlockSource.statistics``, with some planes of blocks at a time."""
        nz, ny, nx = self.blocks.counts
        rows = self.layout.statistics_rows
        for z in range(0, nz, rows):
            end = min(z + rows, nz)
            found = {name: self._plane(name, z, end) for name in self._statistics}
            if self._places is not None:
                for name in found:
                    self._places.check_statistics(name, z // rows)
            yield BlockStatistics(z * ny * nx, **found)

    def _plane(self, name: str, z: int, end: int) -> np.ndarray:
        array = self._statistics[name]
        by_level = array.rank > 3
        try:
            values = (array[:, z:end] if by_level else array[z:end]).read().result()
        except ValueError as error:
            what = f"{name} of the blocks {z} to {end - 1} along z: {what_failed(error)}"
            raise VolumeError(self._where, what, _WANTED) from None
        if name == "quantiles":
            return values.reshape(values.shape[0], -1, values.shape[-1])
        values = values.reshape(values.shape[0], -1) if by_level else values.reshape(-1)
        return values if name == "holes" else values.astype(np.float64)

    # ---- information for users ----

    @cached_property
    def bytes_on_disk(self) -> int:
        """The size of all files of the store in bytes."""
        folders = (Path(folder, name) for folder, _, names in os.walk(self.path) for name in names)
        return sum(file.stat().st_size for file in folders)

    def __repr__(self) -> str:
        nx, ny, nz = self.grid.size
        size = f"{nx} x {ny} x {nz}"
        return f"<StoredBlocks {self.name!r} {size} {self.dtype}, blocks of {self.blocks.edge}>"


__all__ = ["StoredBlocks", "check_finished", "is_store", "is_unfinished", "open_store"]
