"""clvol store, and stores as arguments of other commands."""

from __future__ import annotations

import json

import numpy as np
import pytest

from clvol.store.journal import Journal
from clvol.store.zarr_store import open_store
from clvol.volume.procedural import scene_field


@pytest.fixture
def volume(folder):
    """A volume of eight regions at shard 32."""
    data = np.random.default_rng(0).integers(0, 99, (40, 50, 60)).astype(np.uint8)
    np.save(folder / "v.npy", data)
    return data


def test_a_store_is_built_and_named_on_stdout(run, folder, volume):
    outcome = run("store", "v.npy", "-o", "v.zarr", "--shard", 32, "--edge", 8, "--codec", "zstd")
    assert (outcome.status, outcome.out, outcome.err) == (0, "v.zarr\n", "")
    store = open_store(folder / "v.zarr")
    assert (store.name, store.blocks.edge, store.layout.shard) == ("v", 8, 32)
    assert store.layout.codecs[0].name == "zstd"
    np.testing.assert_array_equal(store.volume_level(0), volume)


def test_raw_files_and_scenes_are_stored(run, folder, volume):
    volume.tofile(folder / "v.raw")
    how = (
        "--set",
        "volume.dims=[60,50,40]",
        "--set",
        'volume.dtype="uint8"',
        "--set",
        "volume.spacing=[1,2,3]",
    )
    assert run("store", "v.raw", "-o", "a", *how).status == 0
    store = open_store(folder / "a")
    assert store.grid.spacing == (1, 2, 3)
    np.testing.assert_array_equal(store.volume_level(0), volume)
    assert run("store", "scene.toml", "-o", "b").status == 0
    assert open_store(folder / "b").layout.shape == (4, 4, 4)


def test_a_computed_field_needs_no_memory_for_its_voxels(run, folder):
    """The cap is for what must be in memory."""
    (folder / "f.toml").write_text(
        'version = 1\n[volume]\nfield = "radial"\nsize = [100, 50, 60]\n'
    )
    assert run("store", "f.toml", "-o", "f", "--memory-cap", "1 KiB").status == 0
    stored = open_store(folder / "f").volume_level(0)
    np.testing.assert_array_equal(stored, scene_field("radial", (100, 50, 60)).data)


def test_info_tells_what_a_store_is(run, folder, volume):
    run("store", "v.npy", "-o", "v.zarr")
    facts = json.loads(run("info", "v.zarr", "--json").out)
    assert facts["store"]["levels"] == 5 and facts["store"]["edge"] == 16
    assert facts["store"]["blocks_zyx"] == [3, 4, 4] and facts["store"]["lossless"]
    size = sum(file.stat().st_size for file in (folder / "v.zarr").rglob("*") if file.is_file())
    assert facts["store"]["bytes_on_disk"] == size
    assert facts["value_range"] == [0, 98]
    said = run("info", "v.zarr").out
    assert "blocks" in said and "blosc-lz4" in said


def interrupted(monkeypatch, error: BaseException) -> None:
    """The next store fails at its sixth region."""
    real = Journal.note

    def note(self, index, *rest):
        if index == 5:
            raise error
        real(self, index, *rest)

    monkeypatch.setattr(Journal, "note", note)


def test_what_is_interrupted_is_gone_on_with_and_says_so(run, refused, folder, volume, monkeypatch):
    arguments = ("store", "v.npy", "-o", "v.zarr", "--shard", 32)
    with monkeypatch.context() as patch:
        interrupted(patch, KeyboardInterrupt())
        assert refused(130, *arguments) == "interrupted"
    assert "unfinished" in refused(2, "info", "v.zarr.partial")
    assert "unfinished" in refused(2, "info", "v.zarr")
    (folder / "s.toml").write_text('version = 1\n[volume]\nfile = "v.zarr"\n')
    assert "unfinished" in refused(2, "info", "s.toml")
    assert "--restart" in refused(2, *arguments, "--codec", "none")
    outcome = run(*arguments)
    assert outcome.status == 0 and outcome.out == "v.zarr\n"
    assert "of 8 regions are done" in outcome.err and outcome.err.count("\n") == 1
    np.testing.assert_array_equal(open_store(folder / "v.zarr").volume_level(0), volume)


def test_a_full_disk_is_one_line_and_status_4(run, refused, folder, volume, monkeypatch):
    arguments = ("store", "v.npy", "-o", "v.zarr", "--shard", 32)
    with monkeypatch.context() as patch:
        interrupted(patch, OSError(28, "No space left on device"))
        line = refused(4, *arguments)
    assert line.startswith("v.zarr: the store cannot be written: No space left on device")
    assert run(*arguments, "--quiet").err == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["v.npy", "-o", "no/v"], "no/v: no: no such folder"),
        (["v.npy", "-o", "cube.npy"], "cube.npy: got a file"),
        (["v.npy", "-o", "x", "--edge", 7], "--edge: got 7, expected one of 4"),
        (["v.npy", "-o", "x", "--shard", 40], "--shard: got 40"),
        (["v.npy", "-o", "x", "--codec", "jpeg"], "--codec: got 'jpeg', expected one of blosc-lz4"),
        (["none.npy", "-o", "x"], "none.npy"),
        (["v.npy", "-o", "x", "--memory-cap", "1 KiB"], "v.npy: the volume needs"),
        (["v.npy"], "clvol store: no -o STORE"),
    ],
)
def test_impossible_wishes_are_one_line_and_leave_nothing(
    refused, folder, volume, nothing_left, arguments, said
):
    assert said in refused(2, "store", *arguments)


def test_a_store_is_not_read_and_overwritten_at_once(run, refused, folder, volume):
    run("store", "v.npy", "-o", "v.zarr")
    assert "exists already" in refused(2, "store", "v.npy", "-o", "v.zarr")
    assert "is also an input" in refused(2, "store", "v.zarr", "-o", "v.zarr", "--overwrite")
    assert run("store", "v.npy", "-o", "v.zarr", "--overwrite", "--codec", "none").status == 0
    assert open_store(folder / "v.zarr").layout.codecs[0].name == "none"


def test_a_read_only_disk_is_one_line_and_leaves_nothing(
    refused, folder, volume, nothing_left, monkeypatch
):
    import os

    def read_only(path, *_, **__):
        raise OSError(30, "Read-only file system", os.fspath(path))

    monkeypatch.setattr(os, "mkdir", read_only)
    line = refused(4, "store", "v.npy", "-o", "v.zarr")
    assert line.startswith("v.zarr: ") and "Read-only file system" in line
