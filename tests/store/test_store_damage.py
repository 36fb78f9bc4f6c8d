"""What is damaged on the disk is found, named by block, and never read as samples."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from clvol.errors import VolumeError
from clvol.readers import load_volume
from clvol.store.build import build_store
from clvol.store.zarr_store import is_store, open_store
from clvol.volume import Volume

DATA = np.random.default_rng(2).integers(0, 60000, (40, 50, 60)).astype(np.uint16)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    return Path(
        build_store(Volume(DATA), tmp_path_factory.mktemp("made") / "s.zarr", shard=32).path
    )


@pytest.fixture
def store(made, tmp_path) -> Path:
    """A copy to damage."""
    return Path(shutil.copytree(made, tmp_path / "s.zarr"))


def flip(path: Path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 4
    path.write_bytes(content)


def flip_in_chunk(shard: Path, chunk: tuple[int, int, int], per_axis: int = 2) -> None:
    """One bit in the middle of a chunk, found by the index at the shard's end."""
    content = shard.read_bytes()
    index = np.frombuffer(content[-(16 * per_axis**3 + 4) : -4], "<u8").reshape(
        per_axis, per_axis, per_axis, 2
    )
    offset, size = index[chunk]
    flip(shard, int(offset + size // 2))


def refused(call: Callable) -> VolumeError:
    with pytest.raises(VolumeError) as error:
        call()
    assert "\n" not in str(error.value) and error.value.expected
    return error.value


def test_a_flipped_bit_is_reported_by_block_and_spoils_no_other(store):
    flip_in_chunk(store / "0/c/0/0/0", (0, 1, 1))
    blocks = open_store(store)
    bad = int(np.ravel_multi_index((0, 1, 1), blocks.blocks.counts))
    for wanted in ([bad], np.arange(blocks.blocks.count)):  # alone, and in boxes
        error = refused(lambda: blocks.read(0, np.asarray(wanted)))
        assert error.where == str(store)
        assert error.what == "block (0, 1, 1) at level 0: checksum does not match"
    others = np.setdiff1d(np.arange(blocks.blocks.count), [bad])
    assert np.isfinite(blocks.read(0, others).astype(float)).all()
    np.testing.assert_array_equal(blocks.read(0, np.array([0]))[0], DATA[:16, :16, :16])
    assert "block (0, 1, 1)" in refused(lambda: load_volume(store).data).what
    blocks.read(1, np.array([bad]))


def test_a_flipped_bit_anywhere_in_a_coarser_level_is_found(store):
    """Whatever byte of the file it is: samples or index."""
    shard = store / "3/c/0/0/0"
    whole = shard.read_bytes()
    blocks = open_store(store)
    some = np.flatnonzero((blocks.blocks.places(np.arange(blocks.blocks.count)) < 2).all(axis=1))
    for at in range(0, len(whole), 37):
        flip(shard, at)
        error = refused(lambda: blocks.read(3, some))
        assert error.what.startswith("block (0, 0, 0) at level 3: ")
        shard.write_bytes(whole)
    blocks.read(3, some)


@pytest.mark.parametrize("level", range(5))
def test_a_missing_file_is_reported_by_block(store, level):
    (store / str(level) / "c/1/0/1").unlink()
    blocks = open_store(store)
    error = refused(lambda: blocks.read(level, np.arange(blocks.blocks.count)))
    assert error.what == f"block (2, 0, 2) at level {level}: is missing"


@pytest.mark.parametrize("kept", (0, 3, 500, -1))
def test_a_cut_off_file_is_found(store, kept):
    shard = store / "0/c/1/1/1"
    shard.write_bytes(shard.read_bytes()[:kept])
    blocks = open_store(store)
    error = refused(lambda: blocks.read(0, np.arange(blocks.blocks.count)))
    assert error.what.startswith("block (2, 2, 2) at level 0: ")


def test_damaged_and_missing_statistics_are_found(store):
    file = next(p for p in (store / "blocks/quantiles/c").rglob("*") if p.is_file())
    flip(file, 60)
    assert "quantiles" in refused(lambda: list(open_store(store).statistics())).what
    file.unlink()
    assert "is missing" in refused(lambda: list(open_store(store).statistics())).what


def change(store: Path, **own) -> None:
    root = json.loads((store / "zarr.json").read_text())
    root["attributes"]["clvol"].update(own)
    (store / "zarr.json").write_text(json.dumps(root))


@pytest.mark.parametrize(
    ("own", "said"),
    [
        ({"version": 2}, "stored by a newer clvol (version 2)"),
        ({"checksums": {"table": [], "statistics": {}}}, "damaged zarr.json"),
        ({"checksums": None}, "damaged zarr.json"),
        ({"version": "x"}, "version 'x'"),
        ({"codecs": [{"name": "vector-9"}] * 5}, "stored by a newer clvol (codec 'vector-9')"),
        ({"edge": 5}, "damaged zarr.json"),
        ({"edge": 8}, "damaged zarr.json"),
        ({"shard": 64}, "array '0'"),
        ({"shape": [40, 50, 61]}, "array '0' is 40 x 50 x 60"),
        ({"dtype": "int16"}, "array '0'"),
        ({"dtype": "complex64"}, "damaged zarr.json"),
        ({"value_range": [3]}, "damaged zarr.json"),
        ({"spacing": [0, 1, 1]}, "spacing"),
        ({"codecs": 3}, "damaged zarr.json"),
    ],
)
def test_metadata_that_do_not_fit_are_refused(store, own, said):
    change(store, **own)
    assert is_store(store)
    for use in (open_store, load_volume):
        error = refused(lambda: use(store))
        assert error.where == str(store) and said in error.what


@pytest.mark.parametrize("missing", ("zarr.json", "0", "4", "0/zarr.json"))
def test_missing_parts_are_refused(store, missing):
    path = store / missing
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    refused(lambda: open_store(store))


@pytest.mark.parametrize("text", ("", "{", "[]", "{}", "null", '{"attributes": 3}', "[" * 5000))
@pytest.mark.parametrize("name", ("zarr.json", "0/zarr.json"))
def test_damaged_metadata_are_refused(store, name, text):
    (store / name).write_text(text)
    refused(lambda: open_store(store))
    refused(lambda: load_volume(store))


def test_no_folder_and_no_store(tmp_path):
    assert "no such folder" in refused(lambda: open_store(tmp_path / "s")).what
    assert "no zarr.json" in refused(lambda: open_store(tmp_path)).what
    (tmp_path / "s.zarr").mkdir()
    refused(lambda: load_volume(tmp_path / "s.zarr"))
