"""Folders that the machine offers, or does not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clvol.errors import DeviceError
from clvol.opencl import folders


@pytest.fixture
def bases(tmp_path, monkeypatch):
    """Folders for temporary files, and a process that has chosen none yet."""
    places = [tmp_path / name for name in ("first", "second")]
    for place in places:
        place.mkdir()
    monkeypatch.setattr(folders, "_bases", lambda: [str(place) for place in places])
    monkeypatch.setattr(folders, "_scratch", None)
    return places


def test_the_first_folder_with_room_is_taken(bases, monkeypatch):
    scratch = folders.scratch_folder()
    assert scratch.parent == bases[0] and scratch == folders.scratch_folder()
    assert scratch.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize("flaw", ["full", "no code", "no files", "gone", "a file"])
def test_a_folder_that_is_of_no_use_is_passed_over(bases, monkeypatch, flaw):
    real = os.statvfs
    flaws = {"full": {"f_bavail": 10}, "no code": {"f_flag": os.ST_NOEXEC}, "no files": {"f_favail": 3, "f_files": 9}}

    def statvfs(path):
        status = real(path)
        if Path(path) != bases[0]:
            return status
        names = ("f_flag", "f_files", "f_favail", "f_bavail", "f_frsize")
        return type("Status", (), {n: getattr(status, n) for n in names} | flaws.get(flaw, {}))

    monkeypatch.setattr(os, "statvfs", statvfs)
    if flaw in ("gone", "a file"):
        bases[0].rmdir()
        if flaw == "a file":
            bases[0].write_text("")
    assert folders.scratch_folder().parent == bases[1]


def test_a_folder_with_little_room_is_better_than_none(bases, monkeypatch):
    monkeypatch.setattr(folders, "_is_roomy", lambda base: False)
    assert folders.scratch_folder().parent == bases[0]


def test_no_folder_at_all_is_one_error(bases, monkeypatch):
    for base in bases:
        base.rmdir()
    with pytest.raises(DeviceError, match="TMPDIR: no folder for temporary files"):
        folders.scratch_folder()


def test_what_a_killed_process_left_is_swept_and_nothing_else(bases, monkeypatch):
    code = ("import os, sys; from clvol.opencl import folders; folders._bases = lambda: [sys.argv[1]]; "
            "print(folders.scratch_folder(), flush=True); sys.stdin.read()")
    others = [subprocess.Popen([sys.executable, "-c", code, bases[0]], stdin=subprocess.PIPE,
                               stdout=subprocess.PIPE, text=True) for _ in range(2)]
    places = [Path(other.stdout.readline().strip()) for other in others]
    others[0].kill()
    others[0].wait()
    for name in ("clvol-of-mine", "clvol-scratch-of-mine"):
        (bases[0] / name).mkdir()
    mine = folders.scratch_folder()
    assert not places[0].exists() and places[1].is_dir() and mine.is_dir()
    assert (bases[0] / "clvol-of-mine").is_dir() and (bases[0] / "clvol-scratch-of-mine").is_dir()
    others[1].communicate("")
    assert not places[1].exists()  # it ended as it should


@pytest.mark.parametrize("variables, expected", [
    ({"XDG_CACHE_HOME": "/x", "HOME": "/h"}, "/x/clvol"),
    ({"HOME": "/h"}, "/h/.cache/clvol"),
    ({"XDG_CACHE_HOME": "", "HOME": "/h"}, "/h/.cache/clvol"),
    ({"XDG_CACHE_HOME": "not/absolute", "HOME": "/h"}, "/h/.cache/clvol"),
])
def test_the_cache_is_never_beside_the_data(monkeypatch, variables, expected):
    for name in ("XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert str(folders.cache_folder()) == expected


@pytest.mark.parametrize("home", ["not/absolute", "~", ".", ""])
def test_a_home_that_is_no_path_puts_nothing_beside_the_data(monkeypatch, home):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", home)
    found = folders.cache_folder()
    assert found is None or (found.is_absolute() and not found.is_relative_to(Path.cwd()))


def test_a_user_without_a_name_or_a_home_has_no_cache(monkeypatch):
    pwd = pytest.importorskip("pwd")

    def unknown(uid):
        raise KeyError(uid)

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    for name in ("XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    assert folders.cache_folder() is None
