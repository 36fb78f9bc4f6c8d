"""A store of codes that was interrupted in any phase, by any means, ends as the same bytes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import ROOT
from helpers.stub_trainer import StubTrainer

from clvol.errors import RenderError, UsageError, VolumeError
from clvol.store import build, coding
from clvol.store.build import build_store
from clvol.store.codecs.coded_blocks import RateTarget
from clvol.store.journal import Journal, unfinished
from clvol.store.zarr_store import StoredBlocks, open_store
from clvol.volume import Volume

TARGET = RateTarget(max_voxel_error=0.02)
PHASES = ["measuring", "training", "encoding", "describing"]


def voxels(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    values = 60 + 20 * np.sin(np.arange(40 * 50 * 60) / 50).reshape(40, 50, 60) + rng.normal(0, 2, (40, 50, 60))
    return values.astype(np.uint8)


def coded(path: Path, **settings) -> StoredBlocks:
    settings = {"trainer": StubTrainer(), "target": TARGET, "codec": "rvq", "shard": 32} | settings
    return build_store(Volume(voxels(), name="v"), path, **settings)


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


class Stop(Exception):
    pass


@pytest.fixture(scope="module")
def once(tmp_path_factory) -> dict[str, bytes]:
    """The files of the store that was not interrupted."""
    return files(Path(coded(tmp_path_factory.mktemp("once") / "s").path))


@pytest.mark.parametrize("workers", (1, 2, 5))
def test_any_number_of_workers_gives_the_same_bytes(tmp_path, once, workers):
    assert files(Path(coded(tmp_path / "s", workers=workers).path)) == once


def test_another_seed_and_another_target_give_other_bytes(tmp_path, once):
    for k, other in enumerate(({"seed": 1}, {"target": RateTarget(max_voxel_error=0.05)})):
        assert files(Path(coded(tmp_path / str(k), **other).path)) != once


def test_progress_only_grows_and_phases_follow_each_other(tmp_path):
    seen, phases = [], []
    coded(tmp_path / "s", progress=lambda done, total: seen.append((done, total)), on_phase=phases.append)
    done, totals = zip(*seen)
    assert phases == PHASES
    assert list(done) == sorted(done) and len(set(totals)) == 1 and done[0] == 0 and done[-1] == totals[0]


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("steps", (0, 3))
def test_what_was_interrupted_in_any_phase_is_resumed(tmp_path, once, phase, steps):
    left = None

    def begin(name: str) -> None:
        nonlocal left
        if name == phase:
            left = steps

    def stop(done: int, total: int) -> None:
        nonlocal left
        if left is not None:
            left -= 1
            if left < 0:
                raise Stop

    path = tmp_path / "s"
    if phase != "describing" or not steps:
        with pytest.raises(Stop):
            coded(path, progress=stop, on_phase=begin, workers=1)
        assert not path.exists()
    trainer = StubTrainer()
    coded(path, trainer=trainer)
    assert files(path) == once
    assert trainer.calls == (0 if phase in ("encoding", "describing") and not (phase == "describing" and steps) else 1)
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_regions_that_are_done_are_not_encoded_again(tmp_path, once, monkeypatch):
    begun = []

    def stop(done: int, total: int) -> None:
        if begun and begun[-1] == "encoding" and len(list((tmp_path / "s.partial/clvol-journal").glob("[0-9]*"))) >= 3:
            raise Stop

    with pytest.raises(Stop):
        coded(tmp_path / "s", progress=stop, on_phase=begun.append, workers=1)
    left = unfinished(tmp_path / "s")
    assert left.total == 8 and 3 <= left.done <= 5
    with pytest.raises(VolumeError, match="unfinished"):
        open_store(tmp_path / "s")
    made, real = [], coding.Coding.make

    def counting(self, box, where):
        made.append(where)
        return real(self, box, where)

    monkeypatch.setattr(coding.Coding, "make", counting)
    coded(tmp_path / "s")
    assert len(made) == 8 - left.done and files(tmp_path / "s") == once


@pytest.mark.parametrize("content", (None, b"", b"PK\x03\x04 cut"))
def test_a_lost_training_is_made_again(tmp_path, once, content):
    """It is the same again, so that regions encoded before stay right."""
    count = []

    def stop(index, *rest):
        count.append(index)
        if len(count) == 3:
            raise Stop

    with pytest.MonkeyPatch.context() as patch:
        real = Journal.note
        patch.setattr(Journal, "note", lambda self, *rest: (real(self, *rest), stop(*rest)))
        with pytest.raises(Stop):
            coded(tmp_path / "s", workers=1)
    training = tmp_path / "s.partial/clvol-journal/training.npz"
    training.unlink() if content is None else training.write_bytes(content)
    trainer = StubTrainer()
    coded(tmp_path / "s", trainer=trainer)
    assert trainer.calls == 1 and files(tmp_path / "s") == once


@pytest.mark.parametrize(
    ("other", "said"),
    [({"target": RateTarget(psnr=10)}, "target"), ({"seed": 5}, "seed"), ({"codec": "hvq", "target": None}, "codec")],
)
def test_another_target_seed_or_codec_is_refused(tmp_path, other, said):
    def stop(done: int, total: int) -> None:
        if done > 100:
            raise Stop

    with pytest.raises(Stop):
        coded(tmp_path / "s", progress=stop)
    with pytest.raises(UsageError, match=said) as error:
        coded(tmp_path / "s", **other)
    assert "--restart" in str(error.value)
    store = coded(tmp_path / "s", restart=True, **other)
    assert store.codes.codec == other.get("codec", "rvq")


@pytest.mark.parametrize("what", ("range", "training", "note", "write", "statistics", "codebooks"))
def test_a_full_disk_is_one_line_and_the_same_call_resumes(tmp_path, once, monkeypatch, what):
    def full(*rest, **more):
        raise OSError(28, "No space left on device")

    def full_once(target: object, name: str, when=lambda *rest: True) -> None:
        real = getattr(target, name)
        calls = []

        def failing(*rest, **more):
            calls.append(rest)
            return full() if when(*rest) and len(calls) > 2 * (name in ("note", "_write")) else real(*rest, **more)

        monkeypatch.setattr(target, name, failing)

    if what in ("range", "training"):
        full_once(Journal, "keep", lambda self, name: name == what)
    elif what in ("note", "write"):
        full_once(*((Journal, "note") if what == "note" else (build._Build, "_write")))
    elif what == "statistics":
        full_once(build._Build, "_write_statistics", lambda self, name: name == "holes")
    else:
        full_once(build, "write_codebooks")
    with pytest.raises(RenderError, match="No space left on device") as error:
        coded(tmp_path / "s", workers=1)
    assert "\n" not in str(error.value) and error.value.exit_status == 4
    assert (what == "range") == (not (tmp_path / "s.partial").exists())
    monkeypatch.undo()
    coded(tmp_path / "s")
    assert files(tmp_path / "s") == once


def test_an_existing_store_is_replaced_only_by_a_whole_one(tmp_path, once):
    before = build_store(Volume(voxels(1)), tmp_path / "s", shard=32)
    with pytest.raises(UsageError, match="--overwrite"):
        coded(tmp_path / "s")
    data = before.volume_level(0)

    def stop(done: int, total: int) -> None:
        if done > 100:
            raise Stop

    with pytest.raises(Stop):
        coded(tmp_path / "s", overwrite=True, progress=stop)
    np.testing.assert_array_equal(open_store(tmp_path / "s").volume_level(0), data)
    coded(tmp_path / "s", overwrite=True)
    assert files(tmp_path / "s") == once
    build_store(Volume(voxels(1)), tmp_path / "s", shard=32, overwrite=True)
    assert not (tmp_path / "s" / "codebooks").exists()


def noise() -> Volume:
    return Volume(np.random.default_rng(3).integers(0, 256, (40, 50, 60), np.uint8), name="n")


@pytest.mark.parametrize("where", ("keep", "note", "forget_regions", "write_codebooks"))
def test_giving_up_codes_is_resumed_too(tmp_path, monkeypatch, where):
    """Interrupted as the build turns to voxels that are stored as they are, and while they are."""
    how = {"codec": "rvq", "target": RateTarget(max_voxel_error=1e-6), "shard": 32, "workers": 1}
    phases = []
    build_store(noise(), tmp_path / "once", trainer=StubTrainer(), on_phase=phases.append, **how)
    assert phases == [*PHASES[:3], "encoding", "describing"]
    target = build if where == "write_codebooks" else Journal
    real, calls = getattr(target, where), []

    def stopped(*rest, **more):
        calls.append(rest)
        if len(calls) == {"keep": 3, "note": 11, "forget_regions": 1, "write_codebooks": 2}[where]:
            if where == "forget_regions":
                (tmp_path / "s.partial/clvol-journal/2.npz").unlink()  # as if killed within
            raise Stop
        return real(*rest, **more)

    with monkeypatch.context() as patch:
        patch.setattr(target, where, stopped)
        with pytest.raises(Stop):
            build_store(noise(), tmp_path / "s", trainer=StubTrainer(), **how)
    build_store(noise(), tmp_path / "s", trainer=StubTrainer(), **how)
    assert files(tmp_path / "s") == files(tmp_path / "once")


_BUILD = """
import sys, time
sys.path[:0] = [sys.argv[2]]
import numpy as np
from helpers.stub_trainer import StubTrainer
from clvol.store.build import build_store
from clvol.store.codecs.coded_blocks import RateTarget
from clvol.volume import Volume
phase = [""]
def slow(done, total):
    print(phase[0], flush=True)
    time.sleep(0.02)
build_store(
    Volume(np.load(sys.argv[3]), name="v"), sys.argv[1], codec="rvq", target=RateTarget(max_voxel_error=0.02), shard=32,
    trainer=StubTrainer(), progress=slow, on_phase=lambda name: phase.__setitem__(0, name), workers=2,
)
"""


def test_killed_again_and_again_it_ends_as_the_same_bytes(tmp_path, once):
    """kill -9 some steps into each phase, each time going on with what is there."""
    np.save(tmp_path / "v.npy", voxels())
    command = [sys.executable, "-c", _BUILD, str(tmp_path / "s"), str(ROOT / "tests"), str(tmp_path / "v.npy")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    killed = []
    for phase, steps in (("measuring", 3), ("training", 9), ("encoding", 3), ("encoding", 5), ("describing", 1)):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        seen = 0
        for line in process.stdout:
            seen += line.strip() == phase
            if seen == steps:
                process.send_signal(signal.SIGKILL)
                killed.append(phase)
                break
        process.stdout.close()
        process.wait(timeout=300)
        assert not (tmp_path / "s").exists() or phase == "describing"
        time.sleep(0.05)
    assert killed == ["measuring", "training", "encoding", "encoding", "describing"]
    if not (tmp_path / "s").exists():
        subprocess.run(command, check=True, env=environment, timeout=300, stdout=subprocess.DEVNULL)
    assert files(tmp_path / "s") == once
