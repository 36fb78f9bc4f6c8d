"""Claims of files: one owner at a time, whatever ends when."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from clvol.batch import claims as claims_module
from clvol.batch.claims import Claims
from clvol.errors import RenderError
from clvol.image import check_output_folder
from clvol.temporaries import Process, remove_leftovers, temporary_name, this_process


@pytest.fixture
def claims():
    with Claims() as made:
        yield made


@pytest.fixture
def others():
    with Claims() as made:
        yield made


def hidden(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name.startswith("."))


def test_one_owner_at_a_time(tmp_path, claims, others):
    path = tmp_path / "a.png"
    assert claims.claim(path) and claims.owns(path)
    assert claims.claim(path)  # again
    assert not others.claim(path) and not others.owns(path)
    assert others.claim(tmp_path / "b.png")
    claims.release(path)
    assert not claims.owns(path)
    assert others.claim(path)


def test_nothing_stays(tmp_path, claims):
    with claims.of(tmp_path / "a.png") as claimed:
        assert claimed and hidden(tmp_path)
    claims.claim(tmp_path / "b.png")
    claims.close()
    assert not hidden(tmp_path)


def test_names_of_one_file_are_one_claim(tmp_path, claims, others, monkeypatch):
    (tmp_path / "link").symlink_to(tmp_path)
    assert claims.claim(tmp_path / "link" / "a.png")
    monkeypatch.chdir(tmp_path)
    assert not others.claim("a.png")


def foreign(path: Path, age: float, token: str = "0" * 16, **changed) -> Path:
    """A claim of another machine, last touched ``age`` seconds ago."""
    owner = {"host": "elsewhere", "boot": "x", "pid": 7, "begun": 1, "token": token} | changed
    claim = claims_module._place(path, "")
    claim.write_text(json.dumps(owner), encoding="utf-8")
    os.utime(claim, (time.time() - age,) * 2)
    return claim


def test_a_claim_of_another_machine_counts_while_it_is_touched(tmp_path, claims, others):
    path = tmp_path / "a.png"
    foreign(path, age=30.0)
    assert not claims.claim(path)
    foreign(path, age=90.0)
    assert claims.claim(path) and not others.claim(path)
    claims.release(path)
    assert not hidden(tmp_path)


def test_a_process_that_has_ended_loses_its_claims_at_once(tmp_path, claims):
    code = "import sys, os; from clvol.batch.claims import Claims; Claims().claim(sys.argv[1]); os._exit(0)"
    path = tmp_path / "a.png"
    subprocess.run([sys.executable, "-c", code, str(path)], check=True)
    assert hidden(tmp_path)
    assert claims.claim(path)


def killed_while_it_writes(path: Path) -> None:
    """A process that has claimed ``path`` and has begun to write it, and to claim another file."""
    code = """
import os, signal, sys
from clvol.batch.claims import Claims
from clvol.image import atomic_path
from clvol.temporaries import temporary_name
Claims().claim(sys.argv[1])
with atomic_path(sys.argv[1]) as part:
    part.write_bytes(b"half")
    open(os.path.join(os.path.dirname(sys.argv[1]), temporary_name()), "x").close()
    os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code, str(path)]).returncode == -signal.SIGKILL


@pytest.mark.parametrize("way", ["claim", "check", "remove"])
def test_what_a_killed_process_has_left_is_removed(tmp_path, claims, way):
    path = tmp_path / "a.png"
    killed_while_it_writes(path)
    assert sorted(name[-9:] for name in hidden(tmp_path) if ".part" in name)[0] == ".part.png"
    assert len(hidden(tmp_path)) == 3  # with the claim
    if way == "claim":
        assert claims.claim(path)
        claims.release(path)
        assert not hidden(tmp_path)
    elif way == "check":
        check_output_folder(tmp_path / "b.png")
    else:
        remove_leftovers(tmp_path)
    assert not [name for name in hidden(tmp_path) if ".part" in name]


def test_what_others_are_writing_stays(tmp_path):
    """A process that runs, one of another machine, and files that are not ours."""
    process = this_process()
    elsewhere = Process("elsewhere", "x", process.pid, process.begun)
    kept = [temporary_name(".png"), temporary_name().replace(process.label, elsewhere.label), ".x.part", ".part.png"]
    ended = temporary_name().replace(process.label, replace(process, begun=process.begun - 1).label)
    for name in [*kept, ended]:
        (tmp_path / name).touch()
    remove_leftovers(tmp_path)
    assert hidden(tmp_path) == sorted(kept)
    remove_leftovers(tmp_path / "nowhere")


def test_a_number_of_a_process_that_is_used_again_is_another_process(tmp_path, claims):
    path = tmp_path / "a.png"
    me = claims_module._me("1" * 16)
    foreign(path, 0.0, **{**vars(me), "begun": me.begun - 1})
    assert claims.claim(path)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"host": 1}', "\x00" * 40])
def test_a_damaged_claim_counts_until_it_is_stale(tmp_path, claims, text):
    path = tmp_path / "a.png"
    claim = claims_module._place(path, "")
    claim.write_text(text, encoding="utf-8")
    assert not claims.claim(path)
    os.utime(claim, (time.time() - 90,) * 2)
    assert claims.claim(path)


def test_a_stale_claim_has_one_successor(tmp_path):
    """Whoever finds it: of many, one gets it."""
    path = tmp_path / "a.png"
    foreign(path, age=90.0)
    many = [Claims() for _ in range(8)]
    assert sum(each.claim(path) for each in many) == 1
    for each in many:
        each.close()
    assert not hidden(tmp_path)


def test_who_read_the_chain_before_it_was_released_does_not_own_it(tmp_path, claims, others, monkeypatch):
    """Between reading the stale claim and following it, its successor finishes and releases both."""
    path = tmp_path / "a.png"
    foreign(path, age=90.0)
    assert claims.claim(path)
    real, calls = claims_module._read, []

    def read(claim: Path):
        found = real(claim)
        calls.append(claim)
        if len(calls) == 1:
            claims.release(path)
            assert third.claim(path)
        return found

    with Claims() as third:
        monkeypatch.setattr(claims_module, "_read", read)
        assert not others.claim(path)
        monkeypatch.undo()
        assert third.owns(path)
    assert not hidden(tmp_path)


def test_one_that_was_stopped_for_long_notices(tmp_path, claims, others, monkeypatch):
    path = tmp_path / "a.png"
    assert claims.claim(path)
    monkeypatch.setattr(Claims, "_is_stale", lambda *arguments: True)
    assert others.claim(path)
    assert others.owns(path) and not claims.owns(path)
    claims.release(path)


def test_without_hard_links(tmp_path, claims, others, monkeypatch):
    def link(source, target):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", link)
    assert claims.claim(tmp_path / "a.png")
    assert not others.claim(tmp_path / "a.png")
    claims.release(tmp_path / "a.png")
    assert others.claim(tmp_path / "a.png")


def test_an_answer_that_was_lost(tmp_path, claims, others, monkeypatch):
    """As on NFS: the link is made, but the call fails."""
    real = os.link

    def link(source, target):
        real(source, target)
        raise TimeoutError(110, "Connection timed out")

    monkeypatch.setattr(os, "link", link)
    assert claims.claim(tmp_path / "a.png")
    monkeypatch.undo()
    assert not others.claim(tmp_path / "a.png")


def test_a_folder_that_takes_no_claim_is_named(tmp_path, claims):
    with pytest.raises(RenderError, match="no claim can be created beside it"):
        claims.claim(tmp_path / "missing" / "a.png")


def test_signs_of_life_are_given(tmp_path, claims, monkeypatch):
    monkeypatch.setattr(claims_module, "_TOUCH", 0.05)
    path = tmp_path / "a.png"
    claims.claim(path)
    (claim,) = tmp_path.iterdir()
    os.utime(claim, (1.0, 1.0))
    for _ in range(100):
        if claim.stat().st_mtime > 1.0:
            return
        time.sleep(0.05)
    raise AssertionError("nobody touched the claim")


_WORKER = """
import os, random, sys, time
from clvol.batch.claims import Claims
folder, seed = sys.argv[1], int(sys.argv[2])
chance, left = random.Random(seed), {f"{k:02d}" for k in range(int(sys.argv[3]))}
with Claims() as claims:
    while left:
        for name in sorted(left, key=lambda _: chance.random()):
            path = os.path.join(folder, name)
            if os.path.exists(path):
                left.discard(name)
                continue
            with claims.of(path) as claimed:
                if not claimed or os.path.exists(path):
                    continue
                open(path + f".begun{os.getpid()}", "x").close()
                time.sleep(0.01)
                temporary = os.path.join(folder, f"{os.getpid()}-{name}")
                open(temporary, "w").close()
                os.rename(temporary, path)
                open(path + f".ended{os.getpid()}", "x").close()
        time.sleep(0.002)
"""


def test_processes_that_are_killed_at_random_lose_nothing_and_double_nothing(tmp_path):
    count, chance = 24, random.Random(3)
    begin = lambda seed: subprocess.Popen(  # noqa: E731
        [sys.executable, "-c", _WORKER, str(tmp_path), str(seed), str(count)]
    )
    workers = [begin(seed) for seed in range(3)]
    killed = 0
    while killed < 4:
        time.sleep(chance.uniform(0.05, 0.25))
        victim = chance.randrange(len(workers))
        if workers[victim].poll() is None:
            workers[victim].send_signal(signal.SIGKILL)
            workers[victim].wait()
        killed += 1
        workers[victim] = begin(10 + killed)
    for worker in workers:
        assert worker.wait(60) == 0
    made = {path.name for path in tmp_path.iterdir()}
    for name in (f"{k:02d}" for k in range(count)):
        assert name in made
        assert sum(each.startswith(f"{name}.ended") for each in made) <= 1  # one that is killed after renaming has none
        begun = sum(each.startswith(f"{name}.begun") for each in made)
        assert begun >= 1
    begun = sum(".begun" in each for each in made)
    assert begun <= count + killed  # each death costs at most what was being made
