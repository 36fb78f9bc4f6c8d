"""What a store's files hold is read only where it belongs: moved, copied and swapped files are found."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from clvol.errors import VolumeError
from clvol.readers import load_volume
from clvol.store import build
from clvol.store.build import build_store
from clvol.store.codecs import CODECS
from clvol.store.places import ShardFile
from clvol.store.zarr_store import open_store
from clvol.volume import Volume

SHAPE = (40, 70, 60)  # two or three shards an axis


def voxels(seed: int) -> np.ndarray:
    """Every block of another content, and all shards of one size where they are not compressed."""
    return np.random.default_rng(seed).integers(0, 200, SHAPE).astype(np.uint8)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """``made(seed, codec)``: a store."""
    folder, known = tmp_path_factory.mktemp("made"), {}

    def make(seed: int = 1, codec: str = "none") -> Path:
        if (seed, codec) not in known:
            path = folder / f"{seed}-{codec}.zarr"
            known[seed, codec] = build_store(Volume(voxels(seed)), path, shard=32, codec=codec).path
        return known[seed, codec]

    return make


@pytest.fixture
def copied(made, tmp_path):
    """``copied(...)``: a copy of ``made(...)`` to damage."""
    return lambda *which: Path(shutil.copytree(made(*which), tmp_path / f"{len(list(tmp_path.iterdir()))}.zarr"))


def swap(one: Path, other: Path) -> None:
    between = one.with_name("between")
    one.rename(between)
    other.rename(one)
    between.rename(other)


def everything(path: Path) -> None:
    """Reads all that there is, or VolumeError."""
    store = open_store(path)
    list(store.statistics())
    for level in range(store.blocks.levels):
        store.read(level, np.arange(store.blocks.count))


def assert_refused(call, *said: str) -> None:
    with pytest.raises(VolumeError) as error:
        call()
    assert all(part in str(error.value) for part in said), error.value
    assert "\n" not in str(error.value) and error.value.expected


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("level", range(5))
def test_a_shard_in_the_place_of_another_is_found_by_its_blocks(copied, level, codec):
    path = copied(1, codec)
    shutil.copy(path / f"{level}/c/0/0/1", path / f"{level}/c/0/1/0")
    store, counts = open_store(path), (3, 5, 4)
    places = np.stack(np.unravel_index(np.arange(60), counts), axis=-1)
    inside = ((places >= (0, 2, 0)) & (places < (2, 4, 2))).all(axis=1)
    for block in np.flatnonzero(inside):
        assert_refused(lambda: store.read(level, np.array([block])), f"at level {level}", "to another place")
    store.read(level, np.flatnonzero(~inside))  # all others are right
    assert_refused(lambda: store.read(level, np.arange(60)), "to another place")


def test_the_voxels_of_a_moved_shard_are_read_by_nobody(copied):
    path = copied()
    swap(path / "0/c/0/0/0", path / "0/c/0/0/1")
    volume = load_volume(path)
    assert_refused(lambda: volume.data, "block (0, 0, 0) at level 0: its data belong to another place")
    assert_refused(lambda: volume.box(0, 4, 0, 4, 20, 40), "to another place")
    np.testing.assert_array_equal(volume.box(0, 40, 32, 70, 0, 60), voxels(1)[:, 32:])


@pytest.mark.parametrize("file", ("0/c/0/0/0", "2/c/0/1/1", "4/c/1/2/1"))
def test_a_shard_of_another_store_is_found(copied, made, file):
    path = copied(1)
    shutil.copy(made(2) / file, path / file)
    assert_refused(lambda: everything(path), f"at level {file[0]}", "to another place")


def test_a_level_in_the_place_of_another_is_found(copied):
    """Shards of one size: level 3 of blocks of 32 beside level 2 of blocks of 16, say."""
    path = copied()
    for one, other in ((0, 1), (3, 4), (1, 3)):
        swap(path / str(one) / "c", path / str(other) / "c")
        assert_refused(lambda: everything(path))
        swap(path / str(one) / "c", path / str(other) / "c")
    everything(path)


def test_a_chunk_in_the_place_of_another_is_found(copied):
    """Its bytes with their checksum, in a shard that is right in all else."""
    path = copied()
    shard = path / "0/c/0/0/0"
    content = bytearray(shard.read_bytes())
    index = np.frombuffer(bytes(content[-(16 * 8 + 4) : -4]), "<u8").reshape(8, 2).astype(int)
    (a, size), (b, _) = index[1], index[6]
    content[b : b + size] = content[a : a + size]
    shard.write_bytes(content)
    store = open_store(path)
    assert_refused(lambda: store.read(0, np.arange(60)), "block (1, 1, 0) at level 0: its data belong to another place")
    store.read(0, np.setdiff1d(np.arange(60), [np.ravel_multi_index((1, 1, 0), (3, 5, 4))]))


@pytest.mark.parametrize("name", ("minimum", "mean", "quantiles", "deviation", "reach_high", "holes"))
def test_statistics_of_another_place_are_found(copied, made, name):
    path = copied(1, "zstd")
    files = sorted(p for p in (path / f"blocks/{name}/c").rglob("*") if p.is_file())
    other = made(2, "zstd") / files[0].relative_to(path)
    if other.read_bytes() != files[0].read_bytes():  # else nothing is wrong
        shutil.copy(other, files[0])
        assert_refused(lambda: list(open_store(path).statistics()), name, "to another place")


def test_swapped_statistics_are_found(copied):
    path = copied()
    swap(path / "blocks/reach_low/c", path / "blocks/reach_high/c")
    assert_refused(lambda: list(open_store(path).statistics()), "to another place")


@pytest.mark.parametrize("part", ("blocks", "blocks/checksums", "zarr.json"))
def test_a_part_of_another_store_is_found(copied, made, part):
    path, other = copied(1), made(2) / part
    if other.is_dir():
        shutil.rmtree(path / part)
        shutil.copytree(other, path / part)
    else:
        shutil.copy(other, path / part)
    assert_refused(lambda: everything(path))


def test_the_table_is_found_missing_or_damaged(copied):
    path = copied()
    file = next(p for p in (path / "blocks/checksums/c").rglob("*") if p.is_file())
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    assert_refused(lambda: everything(path), "table of checksums")
    file.unlink()
    assert_refused(lambda: everything(path), "table of checksums is missing")
    shutil.rmtree(path / "blocks/checksums")
    assert_refused(lambda: open_store(path), "checksums")


def test_equal_content_is_no_error(tmp_path):
    store = build_store(Volume(np.full((64, 64, 64), 7, np.uint8)), tmp_path / "s", shard=32)
    swap(store.path / "0/c/0/0/0", store.path / "0/c/1/1/1")
    everything(store.path)


def test_a_store_from_before_the_table_is_read_as_it_is(copied):
    """It opens, and says that nothing tells where its shards belong."""
    path = copied()
    root = json.loads((path / "zarr.json").read_text())
    del root["attributes"]["clvol"]["checksums"]
    (path / "zarr.json").write_text(json.dumps(root))
    shutil.rmtree(path / "blocks/checksums")
    everything(path)
    assert not open_store(path).checks_places
    np.testing.assert_array_equal(load_volume(path).data, voxels(1))


@pytest.mark.parametrize("swapped", ("files", "journal"))
def test_building_goes_on_only_with_what_is_in_its_place(tmp_path, monkeypatch, swapped):
    """Shards or notes of regions that somebody swapped in between are made anew."""
    source, path = Volume(voxels(3)), tmp_path / "s"
    made = []
    monkeypatch.setattr(build._Build, "_make_region", _counted(made, build._Build._make_region))

    def stop(done: int, total: int) -> None:
        if done >= 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_store(source, path, shard=32, codec="none", progress=stop, workers=1)
    partial = tmp_path / "s.partial"
    before = len(list((partial / "clvol-journal").glob("*.npz")))
    if swapped == "files":
        swap(partial / "0/c/0/0/0", partial / "0/c/0/1/0")
    else:
        swap(partial / "clvol-journal/0.npz", partial / "clvol-journal/2.npz")
    made.clear()
    store = build_store(source, path, shard=32, codec="none", workers=1)
    assert {0, 2} <= set(made) and len(made) == 12 - before + 2
    everything(store.path)
    np.testing.assert_array_equal(store.volume_level(0), voxels(3))


def _counted(made: list, make):
    def counting(self, index: int) -> None:
        made.append(index)
        make(self, index)

    return counting


@pytest.mark.parametrize("content", (b"", b"abc", bytes(200), b"\xff" * 200, b"\x10" * 132))
def test_a_shard_of_any_bytes_has_checksums(tmp_path, content):
    """Whatever its index says: no error, and nothing beyond the file."""
    path = tmp_path / "shard"
    path.write_bytes(content)
    shard = ShardFile(path, 8, bytearray())
    for chunks in (np.arange(8), np.array([3])):
        assert shard.checksums(chunks).shape == chunks.shape
    shard.close()
