"""PoCL's compiled programs: a folder of this process alone, filled from and kept in the program store.

PoCL keeps what it compiles in a folder that all processes of a user share. It aborts the process where
that folder cannot be written, is full, lies where no code may be loaded from, or holds a damaged file.
So it gets a fresh folder each time, into which only files that the store has checked are copied.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from clvol.opencl.folders import scratch_folder
from clvol.opencl.program_store import ENDING, Files, program_folder, read_program, write_program

_VARIABLE = "POCL_CACHE_DIR"

_opening = threading.Lock()
_folder: Path | None = None
_owner = 0
_store: Path | None = None
_places: dict[str, str] = {}  # of programs, by key: PoCL's folder, relative to ours
_kept: dict[str, dict[str, int]] = {}  # by key: sizes of the files that the store has
_asked: set[str] = set()  # keys of programs built since `keep` was last called
_seen: set[str] = set()  # PoCL's folders of programs so far
_foreseen: dict[str, str] = {}  # of programs built by the process which looked for devices, by token: PoCL's folder


@contextmanager
def own_pocl_folder() -> Iterator[None]:
    """The first OpenCL call of a process belongs in here: PoCL reads its environment just once."""
    global _folder, _owner, _store
    with _opening:  # the environment is shared by all threads
        before = os.environ.get(_VARIABLE)
        if _folder is None or _owner != os.getpid():
            _store = program_folder(pocl=True)
            _folder, _owner = scratch_folder() / "pocl", os.getpid()
            _folder.mkdir(exist_ok=True)
            for known in (_places, _kept, _asked, _seen):
                known.clear()
        os.environ[_VARIABLE] = str(_folder)
        try:
            yield
        finally:  # children of this process have folders of their own
            if before is None:
                os.environ.pop(_VARIABLE, None)
            else:
                os.environ[_VARIABLE] = before


def restore(key: str) -> bool:
    """Gives PoCL the program of this key, if the store has it intact; returns whether PoCL has it now."""
    if _folder is None:
        return False
    _asked.add(key)
    if key in _places:
        return True
    try:
        _folder.mkdir(parents=True, exist_ok=True)  # it may have been cleaned up meanwhile
    except OSError:
        return False
    files = read_program(_store, key)
    if not files:
        return False
    place = "/".join(next(iter(files)).split("/")[:2])
    if (_folder / place).exists():  # compiled, under another key, from the same text
        _places[key] = place
        return True
    try:
        for name, content in files.items():
            path = _folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    except OSError:  # there is no room here; PoCL may need less
        return False
    _places[key] = place
    _seen.add(place)
    _kept[key] = {name: len(content) for name, content in files.items()}
    return True


def foreseen_folder() -> Path:
    """Where the process that looks for devices leaves the programs that it builds."""
    return scratch_folder() / "foreseen"


def foresee(token: str, place: str) -> None:
    """Records that the program of this token is in PoCL's folder ``place`` of ``foreseen_folder``."""
    _foreseen[token] = place


def adopt(key: str, token: str) -> bool:
    """Gives PoCL the program of this key, if it was foreseen as that of ``token``; returns whether PoCL has it now."""
    place = _foreseen.pop(token, None)
    if place is None or _folder is None:
        return False
    try:
        (_folder / place).parent.mkdir(parents=True, exist_ok=True)
        os.rename(foreseen_folder() / place, _folder / place)
    except OSError:
        return False
    _places[key] = place
    _seen.add(place)
    return True


def is_empty() -> bool:
    """Whether no process has stored a program of PoCL yet."""
    folder = program_folder(pocl=True)
    try:
        return folder is None or not any(entry.name.endswith(ENDING) for entry in os.scandir(folder))
    except OSError:
        return True


def built(key: str) -> None:
    """Records that the program of this key has just been built."""
    if _folder is None:
        return
    new = {f"{a.name}/{b.name}" for a in _folders_in(_folder) for b in _folders_in(a)} - _seen
    _seen.update(new)
    if len(new) == 1 and new != {_places.get(key)}:
        (_places[key],) = new
        _kept.pop(key, None)


def keep(everything: bool = False) -> None:
    """Writes the compiled code of the programs built since the last call, or of all programs, to the store."""
    if _folder is None or _owner != os.getpid() or os.environ.get("POCL_KERNEL_CACHE") == "0":
        return
    keys = list(_places) if everything else [key for key in _asked if key in _places]
    _asked.clear()
    for key in keys:
        sizes = _sizes(_folder, _folder / _places[key])
        if sizes and sizes != _kept.get(key):
            files: Files = {}
            try:
                for name in sizes:
                    files[name] = (_folder / name).read_bytes()
            except OSError:
                continue
            _kept[key] = sizes
            write_program(_store, key, files)


def _folders_in(folder: str | os.PathLike[str]) -> list[os.DirEntry[str]]:
    try:
        with os.scandir(folder) as entries:
            return [entry for entry in entries if entry.is_dir(follow_symlinks=False)]
    except OSError:
        return []


def _sizes(cache: Path, folder: Path) -> dict[str, int]:
    """The sizes of all files of a program in ``folder``, except its time stamp, by their paths within ``cache``."""
    sizes = {}
    for parent, _, names in os.walk(folder):
        for name in names:
            path = Path(parent, name)
            if name != "last_accessed" and not name.startswith("tempfile"):
                try:
                    sizes[path.relative_to(cache).as_posix()] = path.stat().st_size
                except OSError:
                    pass
    return sizes
