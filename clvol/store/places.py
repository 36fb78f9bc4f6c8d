"""Checksums bound to positions, which prove that data were read from where they were written.

Every chunk ends with a checksum of its bytes. It detects damage, but not an intact chunk in another position: a shard
or a file of statistics that was copied, moved or swapped. A store therefore has a table of the checksums at the ends
of its chunks, STORE/blocks/checksums [region, chunk] (uint32; chunks in the order of ``chunk_offset``, 0 for missing
ones). The root's metadata hold a checksum of each part of that table and those of the files of statistics. Only a few
bytes are read for this.
"""

from __future__ import annotations

import math
import os
import threading
import zlib
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.store.arrays import what_failed
from clvol.store.format import StoreLayout

TABLE = "checksums"  # in STORE/blocks
_ABSENT = np.uint64(0xFFFFFFFFFFFFFFFF)  # the offset of a missing chunk in a shard's index
_PARTS_KEPT = 64  # parts of the table, each of 256 KB or one region
_READ_WHOLE = 1 / 4  # share of a shard's chunks above which one read is faster than one per chunk
_LARGEST_WHOLE = 16 << 20  # largest shard in bytes that is read whole


class ShardFile:
    """A shard of ``count`` chunks on disk, and the checksums of its chunks. OSError if it cannot be read.

    ``buffer`` is used for reads of whole files, and is shared by the reads of one thread.
    """

    def __init__(self, path: Path, count: int, buffer: bytearray) -> None:
        self._buffer = buffer
        self._file = os.open(path, os.O_RDONLY)
        try:
            self._size = os.fstat(self._file).st_size
            index = os.pread(self._file, 16 * count, max(self._size - 16 * count - 4, 0))
        except BaseException:
            self.close()
            raise
        if len(index) < 16 * count:
            index = b"\xff" * 16 * count
        self._index = np.frombuffer(index, "<u8").reshape(count, 2)

    def close(self) -> None:
        os.close(self._file)

    def checksums(self, chunks: np.ndarray) -> np.ndarray:
        """The checksums, uint32 [k], of ``chunks`` (numbers in C order, int64 [k]); 0 for missing ones."""
        first, size = self._index[chunks].T
        there = (first != _ABSENT) & (size >= 4) & (first < self._size) & (size <= self._size)
        ends = np.where(there, first + size, 4).astype(np.int64)
        there &= ends <= self._size
        found = np.zeros(len(ends), np.uint32)
        if len(chunks) >= _READ_WHOLE * len(self._index) and self._size <= _LARGEST_WHOLE:
            content = self._whole()
            found[there] = content[ends[there, None] + np.arange(-4, 0)].view("<u4").ravel()
        else:
            words = [os.pread(self._file, 4, end - 4) for end in ends[there].tolist()]
            found[there] = np.frombuffer(b"".join(word.ljust(4, b"\0") for word in words), "<u4")
        return found

    def _whole(self) -> np.ndarray:
        if len(self._buffer) < self._size:
            self._buffer.extend(bytes(self._size - len(self._buffer)))
        view = memoryview(self._buffer)[: self._size]
        done = 0
        while done < self._size and (more := os.preadv(self._file, [view[done:]], done)):
            done += more
        return np.frombuffer(view, np.uint8)


def chunk_offset(layout: StoreLayout, level: int) -> int:
    """The index in a row of the table at which the chunks of a level begin, in C order."""
    return sum(layout.chunks(k) ** 3 for k in range(level))


def region_checksums(folder: Path, layout: StoreLayout, index: int) -> np.ndarray:
    """The row of the table, uint32 [chunks of all levels], for region ``index`` as it is on disk."""
    found = []
    for level in range(layout.blocks.levels):
        side = layout.chunks(level)
        try:
            shard = ShardFile(folder / layout.shard_file(index, level), side**3, bytearray())
        except OSError:
            found.append(np.zeros(side**3, np.uint32))
            continue
        try:
            found.append(shard.checksums(np.arange(side**3)))
        finally:
            shard.close()
    return np.concatenate(found)


def file_checksum(path: Path) -> int:
    """The checksum at the end of a file with one chunk; -1 if there is no such file."""
    try:
        with path.open("rb") as file:
            file.seek(-4, os.SEEK_END)
            return int.from_bytes(file.read(4), "little")
    except OSError:
        return -1


def statistics_file(layout: StoreLayout, name: str, z: int) -> str:
    """The path, relative to the store, of row ``z`` of chunks of the statistics ``name``."""
    rank = len(layout.statistics_shape(name, layout.blocks.counts))
    place = ["0"] * rank
    place[0 if rank == 3 else 1] = str(z)
    return "/".join(["blocks", name, "c", *place])


def statistics_checksums(folder: Path, layout: StoreLayout) -> dict[str, list[int]]:
    """The checksums of the files of each array of statistics."""
    rows = -(-layout.blocks.counts[0] // layout.statistics_rows)
    return {
        name: [file_checksum(folder / statistics_file(layout, name, z)) for z in range(rows)]
        for name in layout.statistics_types
    }


def part_checksum(rows: np.ndarray) -> int:
    """The checksum of a part of the table, for the root's metadata."""
    return zlib.crc32(np.ascontiguousarray(rows, "<u4").tobytes())


class Places:
    """Checks that the files of a store are in their positions. ``expected``: the checksums in the root's metadata.

    ``open_table`` opens the table's array. VolumeError, with ``where`` and ``wanted``, for data that belong
    elsewhere. May be used by several threads.
    """

    def __init__(
        self, folder: Path, layout: StoreLayout, expected: dict, open_table: Callable[[], Any],
        where: str, wanted: str,
    ) -> None:  # fmt: skip
        self._folder, self._layout, self._expected = folder, layout, expected
        self._open_table, self._where, self._wanted = open_table, where, wanted
        self._parts: OrderedDict[int, np.ndarray] = OrderedDict()
        self._lock = threading.Lock()
        parts = -(-math.prod(layout.regions) // layout.table_rows)
        rows = -(-layout.blocks.counts[0] // layout.statistics_rows)
        found = [len(expected["table"]), *map(len, expected["statistics"].values())]
        if found != [parts, *(rows for _ in expected["statistics"])]:
            raise VolumeError(where, "damaged zarr.json (checksums)", wanted)

    def wrong(self, level: int, shard: np.ndarray, chunks: np.ndarray, buffer: bytearray) -> np.ndarray:
        """Which of ``chunks`` (int64 [k, 3], all in ``shard`` [3] of ``level``) hold data that belong elsewhere: bool
        [k]. ``buffer``: memory that the caller's next call may reuse.
        """
        layout = self._layout
        side = layout.chunks(level)
        index = int(np.ravel_multi_index(tuple(shard.tolist()), layout.regions))
        z, y, x = (chunks - shard * side).T
        numbers = (z * side + y) * side + x
        expected = self.region(index)[chunk_offset(layout, level) + numbers]
        try:
            file = ShardFile(self._folder / layout.shard_file(index, level), side**3, buffer)
        except OSError:  # reading the chunks reports the reason
            return np.ones(len(chunks), bool)
        try:
            return file.checksums(numbers) != expected
        finally:
            file.close()

    def region(self, index: int) -> np.ndarray:
        """The row of the table for region ``index``."""
        rows = self._layout.table_rows
        part = index // rows
        with self._lock:
            if part not in self._parts:
                self._parts[part] = self._read_part(part, rows)
                if len(self._parts) > _PARTS_KEPT:
                    self._parts.popitem(last=False)
            return self._parts[part][index % rows]

    def _read_part(self, part: int, rows: int) -> np.ndarray:
        try:
            table = self._open_table()
            count = math.prod(self._layout.regions)
            found = table[part * rows : min((part + 1) * rows, count)].read().result()
        except ValueError as error:
            what = f"the table of checksums {what_failed(error)}"
            raise VolumeError(self._where, what, self._wanted) from None
        if self._expected["table"][part] != part_checksum(found):
            raise VolumeError(self._where, "the table of checksums belongs to another store", self._wanted)
        return found

    def check_statistics(self, name: str, z: int) -> None:
        """VolumeError if row ``z`` of chunks of the statistics ``name`` belongs elsewhere."""
        path = self._folder / statistics_file(self._layout, name, z)
        if file_checksum(path) != self._expected["statistics"][name][z]:
            raise VolumeError(self._where, f"{name} of the blocks belong to another place", self._wanted)

