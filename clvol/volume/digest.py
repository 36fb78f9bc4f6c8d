"""Digests of the inputs of a picture: of their contents, not of names or times."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np

from clvol.volume.volume import Volume

_PIECE = 32 << 20  # bytes hashed by one thread at a time
_READ = 1 << 20
LARGEST_WHOLE = 1 << 30
"""Size in bytes above which the digest of a store uses the sizes and times of files with samples, and the contents of
metadata and statistics only, since reading everything would take longer than rendering."""

_known: WeakKeyDictionary[Volume, dict[bool, str]] = WeakKeyDictionary()


def volume_digest(volume: Volume, by_blocks: bool = False) -> str:
    """A digest (32 hexadecimal digits) of the voxels, their type and the grid.

    ``by_blocks``: a store is read file by file, without its voxels in memory. The digest is cached for the lifetime of
    the volume, whose voxels do not change.
    """
    known = _known.setdefault(volume, {})
    if by_blocks not in known:
        store = getattr(volume, "blocks_source", None) if by_blocks else None
        grid = volume.grid
        facts = [str(volume.dtype), volume.shape, grid.spacing, grid.origin, grid.direction.tolist()]
        contents = folder_digest(store.path) if store is not None else _array_digest(volume.data)
        known[by_blocks] = _joined([repr(facts), contents])
    return known[by_blocks]


def file_digest(path: str | os.PathLike) -> str:
    """A digest of the content of one file, cached while its inode, size and times stay the same."""
    fact = os.stat(path)
    identity = fact.st_dev, fact.st_ino, fact.st_size, fact.st_mtime_ns, fact.st_ctime_ns
    return _content_digest(os.fspath(path), identity)


@lru_cache(maxsize=64)
def _content_digest(path: str, identity: tuple) -> str:
    digest = hashlib.blake2b(digest_size=16)
    with open(path, "rb") as file:
        while piece := file.read(_READ):
            digest.update(piece)
    return digest.hexdigest()


def folder_digest(path: str | os.PathLike) -> str:
    """A digest of a store: of the names and contents of all its files. See LARGEST_WHOLE for large ones."""
    top = Path(path)
    files = sorted(
        (os.path.relpath(os.path.join(folder, name), top), os.path.join(folder, name))
        for folder, _, names in os.walk(top, followlinks=True)
        for name in names
    )
    facts = [os.stat(place) for _, place in files]
    is_whole = sum(fact.st_size for fact in facts) <= LARGEST_WHOLE

    def line(name: str, place: str, fact: os.stat_result) -> str:
        if not stat.S_ISREG(fact.st_mode):
            return f"{name} is no file"
        if is_whole or name.endswith("zarr.json") or name.startswith("blocks"):
            return f"{name} {_content_digest.__wrapped__(place, ())}"
        return f"{name} {fact.st_size} {fact.st_mtime_ns}"

    with ThreadPoolExecutor() as pool:
        names, places = zip(*files) if files else ((), ())
        return _joined(pool.map(line, names, places, facts))


def _array_digest(array: np.ndarray) -> str:
    flat = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
    pieces = [flat[start : start + _PIECE] for start in range(0, flat.size, _PIECE)]
    with ThreadPoolExecutor() as pool:
        return _joined(pool.map(lambda p: hashlib.blake2b(p.data, digest_size=16).hexdigest(), pieces))


def _joined(parts: Iterable[str]) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        digest.update(part.encode("utf-8", "surrogateescape") + b"\n")
    return digest.hexdigest()
