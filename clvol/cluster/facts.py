"""What a worker must have in common with the client, so that it makes the same pictures."""

from __future__ import annotations

import glob
import hashlib
import os
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import Any

import clvol
from clvol.inputs import is_picture, is_zarr
from clvol.opencl.kernels_path import kernel_folder
from clvol.volume.digest import file_digest, folder_digest
from clvol.volume.parts import parts_of


@lru_cache(maxsize=1)
def kernels_digest() -> str:
    """A digest of all OpenCL sources of this installation."""
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(kernel_folder().iterdir()):
        if path.suffix in (".cl", ".h"):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def program_facts() -> dict[str, Any]:
    return {"version": clvol.__version__, "kernels": kernels_digest()}


def different_program(expected: dict[str, Any]) -> str | None:
    """What differs here from the ``expected`` ``program_facts``, in words; None if nothing does."""
    for name, here in program_facts().items():
        if here != expected.get(name):
            what = "clvol" if name == "version" else "OpenCL kernels"
            return f"it has {what} {here}, and the client {expected.get(name)}"
    return None


class Digests:
    """Digests of files and folders, each read once by a process as long as it does not change."""

    def __init__(self) -> None:
        self._folders: dict[str, tuple[object, str]] = {}

    def of(self, paths: Iterable[str | os.PathLike[str]]) -> dict[str, str]:
        """By name, for ``paths`` and the files that they consist of. "" for what cannot be read."""
        names = [str(each) for path in paths for one in _named(os.fspath(path)) for each in (one, *parts_of(one))]
        return {name: self._one(name) for name in dict.fromkeys(names)}

    def _one(self, path: str) -> str:
        try:
            if not os.path.isdir(path):
                return file_digest(path)
            fact = os.stat(path).st_mtime_ns
            known = self._folders.get(path)
            if known is None or known[0] != fact:
                known = self._folders[path] = fact, folder_digest(path) if is_zarr(path) else _slices_digest(path)
            return known[1]
        except (OSError, ValueError):
            return ""

    def difference(self, expected: dict[str, str]) -> str | None:
        """The first file that differs from what is ``expected``, in words; None if none does."""
        for path, digest in expected.items():
            here = self._one(path)
            if here == digest:
                continue
            if not here:
                return f"it cannot read {path}"
            return f"its {path} has the digest {here}, and the client's {digest}"
        return None


def _named(path: str) -> Iterator[str]:
    """``path``, or the files that it is a pattern of."""
    if glob.has_magic(path) and not os.path.lexists(path) and (found := sorted(glob.glob(path))):
        yield from found
    else:
        yield path


def _slices_digest(folder: str) -> str:
    """As ``folder_digest``, of a folder in which pictures may appear."""
    digest = hashlib.blake2b(digest_size=16)
    with os.scandir(folder) as entries:
        files = sorted(each.path for each in entries if each.is_file() and not each.name.startswith("."))
    for file in files:
        if not is_picture(file):
            digest.update(f"{os.path.basename(file)} {file_digest(file)}\n".encode("utf-8", "surrogateescape"))
    return digest.hexdigest()
