"""The journal of a store that is being built: which regions are complete, with their statistics.

It is a folder inside the one in which the store is built. One file per region holds its statistics, and the sizes and
checksums of its files; "build.json" holds the plan. Recorded regions need not be made again after an interruption.
"""

from __future__ import annotations

import json
import os
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clvol.store.format import JOURNAL, StoreLayout, partial_path
from clvol.store.places import region_checksums
from clvol.store.source import BlockStatistics

LOCK = "lock"
_BUILD = "build.json"


@dataclass(frozen=True)
class Unfinished:
    """An incomplete store: ``done`` of its ``total`` regions are on disk."""

    done: int
    total: int


def unfinished(path: str | os.PathLike) -> Unfinished | None:
    """The progress of building the store ``path``; None if it has not begun, or is complete."""
    journal = partial_path(Path(path)) / JOURNAL
    try:
        total = int(json.loads((journal / _BUILD).read_text(encoding="utf-8"))["regions"])
        done = sum(name.endswith(".npz") and name[:-4].isdigit() for name in os.listdir(journal))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return Unfinished(min(done, total), total)


class Journal:
    """The journal of a store of ``layout`` that is built in the folder ``partial``."""

    def __init__(self, partial: Path, layout: StoreLayout) -> None:
        self.path, self._partial, self._layout = partial / JOURNAL, partial, layout

    def plan(self) -> dict | None:
        """The plan of an earlier call, if it exists and can be read."""
        try:
            before = json.loads((self.path / _BUILD).read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError):
            return None
        return before if isinstance(before, dict) else None

    def begin(self, plan: dict) -> None:
        """Removes all records, and records the plan."""
        for entry in self.path.iterdir():
            if entry.name != LOCK:
                entry.unlink()
        write_whole(self.path / _BUILD, json.dumps(plan, indent=2))

    def anything_done(self) -> bool:
        return any(self.path.glob("*.npz"))

    def note(
        self, index: int, statistics: BlockStatistics, census: np.ndarray, more: dict[str, Any] | None = None
    ) -> None:
        """Records in one step that the region is on disk, with the sizes and checksums of its files.

        ``census`` float64 [4]: smallest and largest finite voxel, numbers of NaN and infinite voxels. ``more``: further
        records, by name.
        """
        region = [-(-(s.stop - s.start) // self._layout.edge) for s in self._layout.region(index)]
        members: dict[str, Any] = {
            name: getattr(statistics, name)
            .astype(dtype)
            .reshape(self._layout.statistics_shape(name, tuple(region)))
            for name, dtype in self._layout.statistics_types.items()
        }
        file = self.path / f"{index}.npz"
        temporary = file.with_suffix(".writing")
        with temporary.open("wb") as stream:
            members["sizes"], members["checksums"] = self._sizes(index), self._checksums(index)
            np.savez(stream, place=index, census=census, **members, **(more or {}))
        os.replace(temporary, file)

    def forget_regions(self) -> None:
        """Removes the records of all regions."""
        for file in self.path.glob("*.npz"):
            if file.stem.isdigit():
                file.unlink()

    def keep(self, name: str, **arrays: Any) -> None:
        """Records in one step what is known of the whole volume."""
        file = self.path / f"{name}.npz"
        with (temporary := file.with_suffix(".writing")).open("wb") as stream:
            np.savez(stream, **arrays)
        os.replace(temporary, file)

    def kept(self, name: str) -> dict[str, np.ndarray] | None:
        """What ``keep`` has recorded, if it can be read."""
        try:
            with np.load(self.path / f"{name}.npz") as found:
                return {key: found[key] for key in found.files}
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def census(self, index: int, read: bool = False) -> np.ndarray | None:
        """The census of a region if it is recorded and its files are unchanged; else None.

        ``read``: contents are compared, not only sizes.
        """
        try:
            with np.load(self.path / f"{index}.npz") as noted:
                same = noted["place"] == index and np.array_equal(noted["sizes"], self._sizes(index))
                if same and read:
                    same = np.array_equal(noted["checksums"], self._checksums(index))
                return noted["census"] if same else None
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def read(self, index: int, name: str) -> np.ndarray:
        """The record ``name`` of a region: a statistic, or "checksums"."""
        with np.load(self.path / f"{index}.npz") as noted:
            return noted[name]

    def _sizes(self, index: int) -> np.ndarray:
        files = [
            self._partial / self._layout.shard_file(index, n)
            for n in range(self._layout.blocks.levels)
        ]
        return np.array([file.stat().st_size if file.exists() else -1 for file in files], np.int64)

    def _checksums(self, index: int) -> np.ndarray:
        return region_checksums(self._partial, self._layout, index)


def write_whole(path: Path, text: str) -> None:
    """Writes the file in one step: it has its old or its new content, never a part."""
    temporary = path.with_name(path.name + ".writing")
    with temporary.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)
