"""Programs that are kept: whole or not used, and never the reason of a failure."""

from __future__ import annotations

import os
import random

import pytest

from clvol.errors import ClvolWarning
from clvol.opencl import notices, program_store
from clvol.opencl.cache_report import report_caches
from clvol.opencl.program_store import is_whole, read_program, write_program

FILES = {"AB/x/program.bc": b"code" * 100, "AB/x/f/1-1-1/f.so": bytes(range(256)), "empty": b""}


@pytest.fixture
def store(tmp_path, monkeypatch):
    """An empty folder for programs, in which a process finds what it has not yet told of."""
    monkeypatch.setattr(notices, "_told", {})
    monkeypatch.setattr(program_store, "_pruned", set())
    return tmp_path / "cache" / "programs"


def test_what_was_written_is_read(store):
    assert read_program(store, "key") is None
    write_program(store, "key", FILES)
    assert read_program(store, "key") == FILES
    assert read_program(store, "other") is None
    write_program(store, "key", {"": b"new"})
    assert read_program(store, "key") == {"": b"new"}
    assert [path.name for path in store.iterdir()] == ["key.program"]


def damage(content: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(content))
    return rng.choice([
        content[:at], content + b"x", content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :],
        content[:at] + content[at + 1 :], b"", bytes(len(content)), rng.randbytes(len(content)),
    ])  # fmt: skip


def test_no_damage_is_handed_out(store):
    write_program(store, "key", FILES)
    (path,) = store.iterdir()
    whole = path.read_bytes()
    rng = random.Random(1)
    for _ in range(500):
        damaged = damage(whole, rng)
        if damaged != whole:
            path.write_bytes(damaged)
            with pytest.warns(ClvolWarning, match="damaged") if not notices.told() else _quiet():
                assert read_program(store, "key") is None
            assert not is_whole(path)


class _quiet:
    def __enter__(self):
        return None

    def __exit__(self, *stop):
        return None


def test_a_folder_that_cannot_be_written_is_told_once(store, recwarn):
    store.parent.write_text("a file where the folder should be")
    for _ in range(3):
        write_program(store, "key", FILES)
        assert read_program(store, "key") is None
    (told,) = recwarn.list
    assert told.category is ClvolWarning and str(store.parent) in str(told.message)


def test_no_folder_is_told_once(store, recwarn):
    for _ in range(2):
        write_program(None, "key", FILES)
        assert read_program(None, "key") is None
    (told,) = recwarn.list
    assert "HOME is not set" in str(told.message)


def test_code_that_others_may_write_is_not_run(store):
    write_program(store, "key", FILES)
    (path,) = store.iterdir()
    os.chmod(path, 0o666)
    with pytest.warns(ClvolWarning, match="others may write"):
        assert read_program(store, "key") is None


def test_what_is_no_file_keeps_nobody_waiting(store):
    store.mkdir(parents=True)
    os.mkfifo(store / "key.program")
    with pytest.warns(ClvolWarning, match="cannot be read"):
        assert read_program(store, "key") is None
    write_program(store, "key", FILES)
    assert read_program(store, "key") == FILES


def test_what_one_user_kept_another_may_read(store):
    umask = os.umask(0o002)  # as many distributions set it: files that the group may write
    try:
        write_program(store, "key", FILES)
    finally:
        os.umask(umask)
    assert (store / "key.program").stat().st_mode & 0o777 == 0o644 and read_program(store, "key") == FILES


def test_the_oldest_go_where_all_take_too_much(store, monkeypatch):
    for number in range(10):
        write_program(store, f"key{number}", FILES)
        os.utime(store / f"key{number}.program", (number, number))
    (store / ".left.part").write_bytes(b"of a process that was killed")
    os.utime(store / ".left.part", (1, 1))
    size = (store / "key0.program").stat().st_size
    monkeypatch.setattr(program_store, "_MOST", 5 * size)
    monkeypatch.setattr(program_store, "_pruned", set())
    write_program(store, "new", FILES)
    kept = {path.name for path in store.iterdir()}
    assert kept == {"new.program", *(f"key{number}.program" for number in (6, 7, 8, 9))}


def test_the_report_counts_what_is_whole_and_removes_the_rest(store, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(store.parent))
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    place = store.parent / "clvol" / "programs"
    for number in range(3):
        write_program(place, f"key{number}", FILES)
    (place / "key1.program").write_bytes(b"garbage")
    report = report_caches()
    assert report.folder == str(place.parent) and report.programs == 2 and report.size > 0
    assert [p for p in report.problems if "1 program damaged" in p]
    assert not (place / "key1.program").exists() and report_caches().problems == []


def test_the_report_tells_of_a_folder_that_cannot_be_written(store, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(store.parent / "file"))
    store.parent.mkdir()
    (store.parent / "file").write_text("")
    (problem,) = report_caches().problems
    assert "cannot be written" in problem and str(store.parent) in problem
