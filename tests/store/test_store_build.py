"""A store holds what it was built of, is whole or not there, and is gone on with where it was
left."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from helpers import slow_blocks
from helpers.paths import ROOT

from clvol.errors import ClvolError, RenderError, UsageError, VolumeError
from clvol.readers import load_volume
from clvol.store import build
from clvol.store.build import build_store
from clvol.store.codecs import CODECS
from clvol.store.journal import Journal, unfinished
from clvol.store.volume_blocks import VolumeBlocks
from clvol.store.voxel_source import FieldSource, VolumeSource
from clvol.store.zarr_store import open_store
from clvol.volume import Grid, Volume
from clvol.volume.procedural import scene_field

TYPES = ("uint8", "int8", "uint16", "int16", "float32", "float64")
SHAPES = ((1, 17, 33), (33, 1, 1), (40, 35, 66))
NAMES = ("minimum", "maximum", "mean", "quantiles", "deviation", "reach_low", "reach_high", "holes")


def voxels(shape, dtype="uint8", seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    values = (
        60 + 20 * np.sin(np.arange(np.prod(shape)) / 50).reshape(shape) + rng.normal(0, 2, shape)
    )
    values = values.astype(dtype)
    if values.dtype.kind == "f":
        values[rng.random(shape) < 0.1] = np.nan
        values.flat[3] = np.inf
        values[:16, :16, :16] = np.nan
    return values


def joined(source) -> dict[str, np.ndarray]:
    parts = list(source.statistics())
    assert [part.first for part in parts] == np.cumsum([0] + [len(part.holes) for part in parts])[
        :-1
    ].tolist()
    axis = {name: 0 if name in ("reach_low", "reach_high", "holes") else 1 for name in NAMES}
    return {
        name: np.concatenate([getattr(part, name) for part in parts], axis[name]) for name in NAMES
    }


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


class Stop(Exception):
    pass


def stop_after(regions: int):
    def progress(done: int, total: int) -> None:
        if done >= regions:
            raise Stop

    return progress


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", TYPES)
def test_a_store_is_the_volume_at_every_level(tmp_path, dtype, shape):
    data = voxels(shape, dtype)
    direction = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    volume = Volume(data, (0.5, 1, 2), (7, 8, 9), direction, "thing", frame="LPS")
    store = build_store(volume, tmp_path / "s.zarr", shard=32)
    memory = VolumeBlocks(volume)
    assert (store.grid, store.dtype, store.name) == (volume.grid, volume.dtype, "thing")
    assert store.facts.frame == "LPS"
    assert store.value_range == volume.value_range
    assert (store.nan_count, store.inf_count) == (volume.nan_count, volume.inf_count)
    some = np.random.default_rng(1).permutation(store.blocks.count)
    for level in range(5):
        wanted = slow_blocks.block_samples(data, store.blocks, level, some)
        exact = level == 0 or data.dtype.kind != "f"
        for blocks, expected in ((some, wanted), (some[:2], wanted[:2])):
            found = store.read(level, blocks)
            assert found.dtype == data.dtype
            np.testing.assert_allclose(found, expected, rtol=0 if exact else 2e-7)
    np.testing.assert_array_equal(store.volume_level(0), data)
    found, wanted = joined(store), joined(memory)
    for name in NAMES:
        assert found[name].dtype == wanted[name].dtype, name
        np.testing.assert_allclose(found[name], wanted[name], rtol=1.2e-7, err_msg=name)


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("edge", (4, 8, 16, 32))
def test_every_codec_and_edge(tmp_path, codec, edge):
    data = voxels((37, 41, 50), "uint16")
    store = build_store(Volume(data), tmp_path / "s", edge=edge, shard=3 * edge, codec=codec)
    assert store.blocks.edge == edge and store.blocks.levels == edge.bit_length()
    assert [c.name for c in store.layout.codecs] == [codec] * store.blocks.levels
    np.testing.assert_array_equal(store.volume_level(0), data)
    for level in range(1, store.blocks.levels):
        np.testing.assert_array_equal(store.volume_level(level), slow_blocks.reduced(data, level))


def test_any_box(tmp_path):
    data = voxels((40, 50, 60))
    store = build_store(Volume(data), tmp_path / "s", shard=32)
    for z0, z1, y0, y1, x0, x1 in (
        (0, 40, 0, 50, 0, 60),
        (5, 6, 31, 33, 16, 60),
        (39, 40, 49, 50, 59, 60),
    ):
        np.testing.assert_array_equal(store.box(z0, z1, y0, y1, x0, x1), data[z0:z1, y0:y1, x0:x1])


@pytest.mark.parametrize("kind", ("radial", "ellipsoid", "constant"))
def test_a_computed_field_is_stored_as_it_would_be_from_memory(tmp_path, kind):
    size, spacing = (50, 40, 70), (1, 2, 0.5)
    store = build_store(FieldSource(kind, size, spacing), tmp_path / "s", shard=32)
    volume = scene_field(kind, size, spacing)
    assert (store.grid, store.name, store.facts.frame) == (volume.grid, volume.name, volume.frame)
    np.testing.assert_array_equal(store.volume_level(0), volume.data)


def test_several_threads_read_at_a_time(tmp_path):
    data = voxels((70, 50, 60))
    store = build_store(Volume(data), tmp_path / "s", shard=32)
    every = np.arange(store.blocks.count)
    wanted = {level: store.read(level, every) for level in range(5)}
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda k: store.read(k % 5, every), range(40)))
    for k, samples in enumerate(found):
        np.testing.assert_array_equal(samples, wanted[k % 5])


def test_repeated_and_no_blocks(tmp_path):
    store = build_store(Volume(voxels((33, 40, 20))), tmp_path / "s", shard=32)
    twice = store.read(1, np.array([3, 0, 3]))
    np.testing.assert_array_equal(twice[0], twice[2])
    assert store.read(0, np.array([], int)).shape == (0, 16, 16, 16)


# ---- interrupted ---------------------------------------------------------------------------------


@pytest.mark.parametrize("regions", (1, 3, 8))
def test_what_was_interrupted_ends_as_if_it_had_not_been(tmp_path, regions):
    volume = Volume(voxels((40, 50, 60)), name="v")
    build_store(volume, tmp_path / "once", shard=32)
    path = tmp_path / "again"
    with pytest.raises(Stop):
        build_store(volume, path, shard=32, progress=stop_after(regions), workers=1)
    assert not path.exists()
    left = unfinished(path)
    assert left.total == 8 and regions <= left.done <= regions + 2
    with pytest.raises(VolumeError, match="unfinished"):
        open_store(path)
    for unusable in (path, tmp_path / "again.partial"):
        with pytest.raises(VolumeError, match="unfinished") as error:
            load_volume(unusable)
        assert "\n" not in str(error.value)
    seen = []
    build_store(volume, path, shard=32, progress=lambda done, total: seen.append(done))
    assert seen[0] == left.done and seen[-1] == 8 and len(seen) == 9 - left.done
    assert unfinished(path) is None and not (tmp_path / "again.partial").exists()
    assert files(path) == files(tmp_path / "once")


def test_interrupted_before_anything_was_done_leaves_nothing(tmp_path):
    with pytest.raises(Stop):
        build_store(Volume(voxels((20, 20, 20))), tmp_path / "s", progress=stop_after(0))
    assert list(tmp_path.iterdir()) == []


def test_interrupted_at_the_very_end_is_finished_by_the_next_call(tmp_path, monkeypatch):
    """All is written, but the folder has not got its name."""
    volume = Volume(voxels((20, 20, 20)))

    def crash(*_):
        raise Stop

    with monkeypatch.context() as patch:
        patch.setattr(build.os, "rename", crash)
        with pytest.raises(Stop):
            build_store(volume, tmp_path / "s")
    with pytest.raises(VolumeError, match="unfinished"):
        load_volume(tmp_path / "s.partial")
    store = build_store(volume, tmp_path / "s")
    np.testing.assert_array_equal(store.volume_level(0), volume.data)
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_a_region_whose_file_was_cut_off_is_made_again(tmp_path):
    volume = Volume(voxels((40, 50, 60)))
    path = tmp_path / "s"
    with pytest.raises(Stop):
        build_store(volume, path, shard=32, progress=stop_after(4), workers=1)
    cut = sorted((tmp_path / "s.partial" / "0" / "c").rglob("*"))[-1]
    os.truncate(cut, 100)
    cut.with_name("2.__lock").write_text("what a killed write leaves")
    store = build_store(volume, path, shard=32)
    np.testing.assert_array_equal(store.volume_level(0), volume.data)
    assert not list(path.rglob("*.__lock"))


@pytest.mark.parametrize(
    ("other", "settings", "said"),
    [(1, {}, "another volume"), (0, {"codec": "zstd"}, "codec"), (0, {"edge": 8}, "edge")],
)
def test_an_unfinished_store_of_something_else_is_refused(tmp_path, other, settings, said):
    path = tmp_path / "s"
    with pytest.raises(Stop):
        build_store(Volume(voxels((40, 50, 60))), path, shard=32, progress=stop_after(2))
    volume = Volume(voxels((40, 50, 60), seed=other))
    with pytest.raises(UsageError, match=said) as error:
        build_store(volume, path, shard=32, **settings)
    assert "--restart" in str(error.value) and unfinished(path).done
    store = build_store(volume, path, shard=32, restart=True, **settings)
    np.testing.assert_array_equal(store.volume_level(0), volume.data)


def test_a_file_that_changed_is_another_volume(tmp_path):
    file = tmp_path / "v.npy"
    np.save(file, voxels((40, 50, 60)))
    before = VolumeSource(load_volume(file)).identity
    assert before == VolumeSource(load_volume(file)).identity
    np.save(file, voxels((40, 50, 60), seed=1))
    os.utime(file, ns=(1, 1))
    assert before != VolumeSource(load_volume(file)).identity


def test_two_at_a_time_are_refused(tmp_path):
    volume = Volume(voxels((20, 20, 20)))

    def another(done: int, total: int) -> None:
        with pytest.raises(UsageError, match="another process"):
            build_store(volume, tmp_path / "s")

    build_store(volume, tmp_path / "s", progress=another)


# ---- places --------------------------------------------------------------------------------------


def test_a_store_is_replaced_only_when_asked_and_only_by_a_whole_one(tmp_path):
    path = tmp_path / "s"
    old, new = Volume(voxels((40, 50, 60))), Volume(voxels((40, 50, 60), seed=1))
    build_store(old, path, shard=32)
    with pytest.raises(UsageError, match="--overwrite"):
        build_store(new, path, shard=32)
    with pytest.raises(Stop):
        build_store(new, path, shard=32, overwrite=True, progress=stop_after(2))
    np.testing.assert_array_equal(open_store(path).volume_level(0), old.data)
    build_store(new, path, shard=32, overwrite=True)
    np.testing.assert_array_equal(open_store(path).volume_level(0), new.data)
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_a_store_that_appears_meanwhile_is_left_alone(tmp_path):
    path = tmp_path / "s"
    other = build_store(Volume(voxels((9, 9, 9))), tmp_path / "other")

    def appear(done: int, total: int) -> None:
        if done == total and not path.exists():
            shutil.copytree(other.path, path)

    with pytest.raises(UsageError, match="exists already"):
        build_store(Volume(voxels((20, 20, 20))), path, progress=appear)
    assert open_store(path).layout.shape == (9, 9, 9)
    assert unfinished(path).done == 1


@pytest.mark.parametrize("left", [(), ("0/zarr.json",), ("0/zarr.json.__lock", "1/zarr.json", "blocks/holes")])
def test_what_a_building_leaves_that_is_killed_as_it_begins_is_no_hindrance(tmp_path, left):
    """Before it has its journal, or when that is gone again."""
    volume = Volume(voxels((5, 5, 5)))
    (tmp_path / "s.partial").mkdir()
    for name in left:
        (tmp_path / "s.partial" / name).parent.mkdir(exist_ok=True)
        if name == "blocks/holes":
            (tmp_path / "s.partial" / name).mkdir()
        else:
            (tmp_path / "s.partial" / name).write_text("{")
    np.testing.assert_array_equal(build_store(volume, tmp_path / "s").volume_level(0), volume.data)
    assert not (tmp_path / "s.partial").exists()


@pytest.mark.parametrize("name", ["zarr.json", "0/c", "0/zarr.json.txt", "0/c/0", "data/x", "1/0/zarr.json"])
def test_a_folder_that_holds_anything_is_not_taken_for_a_building(tmp_path, name):
    (tmp_path / "s.partial" / name).parent.mkdir(parents=True)
    (tmp_path / "s.partial" / name).write_text("precious")
    with pytest.raises(UsageError, match="something else"):
        build_store(Volume(voxels((5, 5, 5))), tmp_path / "s", restart=True)
    assert files(tmp_path) == {f"s.partial/{name}": b"precious"}


def test_a_folder_in_the_place_of_the_unfinished_store_is_left_alone(tmp_path):
    (tmp_path / "s.partial").mkdir()
    (tmp_path / "s.partial" / "file").write_text("precious")
    for restart in (False, True):
        with pytest.raises(UsageError, match="something else"):
            build_store(Volume(voxels((5, 5, 5))), tmp_path / "s", restart=restart)
    assert files(tmp_path) == {"s.partial/file": b"precious"}


def test_only_a_store_is_ever_overwritten(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").write_text("precious")
    (tmp_path / "file").write_text("precious")
    volume = Volume(voxels((5, 5, 5)))
    for name in ("mine", "file"):
        with pytest.raises(UsageError):
            build_store(volume, tmp_path / name, overwrite=True)
    assert files(tmp_path) == {"mine/file": b"precious", "file": b"precious"}


@pytest.mark.parametrize(
    ("place", "settings"),
    [
        ("no/s", {}),
        ("s.partial", {}),
        ("s", {"edge": 5}),
        ("s", {"shard": 24}),
        ("s", {"codec": "lzma"}),
    ],
)
def test_impossible_wishes_are_refused_before_the_work(tmp_path, place, settings):
    with pytest.raises(UsageError) as error:
        build_store(Volume(voxels((5, 5, 5))), tmp_path / place, **settings)
    assert "\n" not in str(error.value) and list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write to any folder")
def test_a_folder_that_cannot_be_written_to_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(UsageError, match="cannot be written"):
            build_store(Volume(voxels((5, 5, 5))), tmp_path / "s")
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.parametrize("where", ("journal", "array"))
def test_a_full_disk_is_one_line_and_what_is_done_is_kept(tmp_path, monkeypatch, where):
    volume = Volume(voxels((40, 50, 60)))
    if where == "journal":
        real = Journal.note

        def failing(self, index, *rest):
            if index == 5:
                raise OSError(28, "No space left on device")
            real(self, index, *rest)

        monkeypatch.setattr(Journal, "note", failing)
    else:
        real = build._Build._write

        def failing(self, index, level, samples):
            if any((self.journal.path / f"{n}.npz").exists() for n in range(8)):
                text = "RESOURCE_EXHAUSTED: Error writing local file: No space [os_error_code='28']"
                raise ValueError(text)
            return real(self, index, level, samples)

        monkeypatch.setattr(build._Build, "_write", failing)
    with pytest.raises(RenderError, match="No space left on device") as error:
        build_store(volume, tmp_path / "s", shard=32, workers=1)
    assert "s.partial" in str(error.value) and "\n" not in str(error.value)
    assert error.value.exit_status == 4
    monkeypatch.undo()
    assert unfinished(tmp_path / "s").done > 0
    np.testing.assert_array_equal(
        build_store(volume, tmp_path / "s", shard=32).volume_level(0), volume.data
    )


def test_a_source_that_lies_is_an_error(tmp_path):
    class Liar(VolumeSource):
        def box(self, *bounds):
            return super().box(*bounds)[1:]

    with pytest.raises(VolumeError, match="a box of"):
        build_store(Liar(Volume(voxels((20, 20, 20)))), tmp_path / "s")
    assert list(tmp_path.iterdir()) == []


# ---- memory --------------------------------------------------------------------------------------

_GENERATED = """
import resource, sys
import numpy as np
from clvol.store.build import build_store
from clvol.volume import Grid

class Generated:
    shape, dtype, identity = (512, 512, 1024), np.dtype(np.uint8), {}
    name, frame = "generated", "index"
    grid = Grid(shape)

    def box(self, z0, z1, y0, y1, x0, x1):
        z, y, x = (np.arange(a, b).astype(np.uint8) for a, b in ((z0, z1), (y0, y1), (x0, x1)))
        return z[:, None, None] ^ y[:, None] ^ x

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

import tensorstore
before = peak()
store = build_store(Generated(), sys.argv[1], workers=2)
for part in store.statistics():
    pass
print(peak() - before)
"""


def test_building_takes_less_memory_than_the_volume(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", _GENERATED, str(tmp_path / "s")], capture_output=True, text=True,
        timeout=300, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 512 * 512 * 1024 * 0.75


def test_all_errors_are_clvols_and_the_journal_is_json(tmp_path):
    with pytest.raises(Stop):
        build_store(Volume(voxels((40, 50, 60))), tmp_path / "s", shard=32, progress=stop_after(2))
    plan = json.loads((tmp_path / "s.partial" / "clvol-journal" / "build.json").read_text())
    assert plan["regions"] == 8
    (tmp_path / "s.partial" / "clvol-journal" / "build.json").write_text("{")
    try:
        build_store(Volume(voxels((40, 50, 60))), tmp_path / "s", shard=32)  # begins anew
    except ClvolError as error:
        pytest.fail(str(error))
    assert Grid((40, 50, 60)) == open_store(tmp_path / "s").grid
