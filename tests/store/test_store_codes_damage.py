"""Damaged, moved and exchanged codes and codebooks are found, named by block, and never decoded."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.stub_trainer import StubTrainer

from clvol.errors import VolumeError
from clvol.readers import load_volume
from clvol.store.arrays import open_array
from clvol.store.build import build_store
from clvol.store.codecs import CODES
from clvol.store.codecs.coded_blocks import CodedBlocks, RateTarget
from clvol.store.packs import capacity, packed, side, unpacked
from clvol.store.zarr_store import open_store
from clvol.volume import Volume

LOSSY = [codec.name for codec in CODES.values() if not codec.lossless]
SHAPE = (40, 70, 150)  # blocks (3, 5, 10), packs of 4^3 in shards of 2^3 packs


def voxels(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (100 + 50 * np.sin(np.arange(np.prod(SHAPE)) / 70).reshape(SHAPE) + rng.normal(0, 9, SHAPE)).astype(np.uint8)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Callable[..., Path]:
    """``made(seed, codec)``: a store."""
    folder, known = tmp_path_factory.mktemp("made"), {}

    def make(seed: int = 1, codec: str = "rvq") -> Path:
        if (seed, codec) not in known:
            target = RateTarget(max_voxel_error=0.04) if codec == "rvq" else None
            path = folder / f"{seed}-{codec}.zarr"
            how = {"codec": codec, "target": target, "trainer": StubTrainer(), "seed": seed}
            known[seed, codec] = Path(build_store(Volume(voxels(seed)), path, **how).path)
        return known[seed, codec]

    return make


@pytest.fixture
def copied(made, tmp_path) -> Callable[..., Path]:
    """``copied(...)``: a copy of ``made(...)`` to damage."""
    return lambda *which: Path(shutil.copytree(made(*which), tmp_path / f"{len(list(tmp_path.iterdir()))}.zarr"))


def flip(path: Path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 4
    path.write_bytes(content)


def refused(call: Callable, *said: str) -> VolumeError:
    with pytest.raises(VolumeError) as error:
        call()
    assert "\n" not in str(error.value) and error.value.expected
    assert all(part in str(error.value) for part in said), error.value
    return error.value


def change(path: Path, edit: Callable[[dict], object]) -> None:
    root = json.loads((path / "zarr.json").read_text())
    edit(root["attributes"]["clvol"])
    (path / "zarr.json").write_text(json.dumps(root))


def everything(path: Path) -> None:
    store = open_store(path)
    list(store.statistics())
    for level in range(store.blocks.levels):
        store.read(level, np.arange(store.blocks.count))
        if store.layout.codecs[level].coded:
            store.read_codes(level, np.arange(store.blocks.count))


@pytest.mark.parametrize("codec", LOSSY)
@pytest.mark.parametrize("level", (0, 1, 2))
def test_a_flipped_bit_in_a_pack_is_reported_by_block_and_spoils_no_other(copied, level, codec):
    path = copied(1, codec)
    shard = path / f"{level}/c/0/0/0"
    index = np.frombuffer(shard.read_bytes()[-(16 * 8 + 4) : -4], "<u8").reshape(2, 2, 2, 2)
    offset, size = index[0, 1, 0].astype(int)
    flip(shard, offset + size // 2)
    store = open_store(path)
    places = store.blocks.places(np.arange(store.blocks.count))
    inside = ((places >= (0, 4, 0)) & (places < (4, 8, 4))).all(axis=1)
    for block in np.flatnonzero(inside)[[0, -1]]:
        for read in (store.read, store.read_codes):
            named = tuple(places[block].tolist())
            error = refused(lambda: read(level, [block]), f"block {named} at level {level}: ")
            assert error.what.endswith(("checksum does not match", "is damaged"))
    refused(lambda: store.read(level, np.arange(store.blocks.count)), "block (0, 4, 0)")
    store.read(level, np.flatnonzero(~inside))
    if level == 0:
        refused(lambda: load_volume(path).data, "block (0, 4, 0) at level 0")


@pytest.mark.parametrize("level", (0, 1, 2))
def test_swapped_and_copied_shards_are_found(copied, made, level):
    path = copied()
    one, other = path / f"{level}/c/0/0/0", path / f"{level}/c/0/0/1"
    between = one.with_name("between")
    one.rename(between), other.rename(one), between.rename(other)
    store = open_store(path)
    refused(lambda: store.read(level, [0]), f"block (0, 0, 0) at level {level}: its data belong to another place")
    refused(lambda: store.read_codes(level, [8]), f"block (0, 0, 8) at level {level}", "another place")
    other.rename(between), one.rename(other), between.rename(one)
    everything(path)
    shutil.copy(made(2) / f"{level}/c/0/0/0", one)
    refused(lambda: everything(path), f"at level {level}", "another place")


def test_a_level_in_the_place_of_another_is_found(copied):
    path = copied()
    shutil.copytree(path / "1/c", path / "0/c", dirs_exist_ok=True)
    refused(lambda: everything(path))


@pytest.mark.parametrize("codec", LOSSY)
def test_damaged_and_exchanged_codebooks_are_found(copied, made, codec):
    path = copied(1, codec)
    file = path / "codebooks/c/0/0/0"
    whole = file.read_bytes()
    for at in range(0, len(whole), len(whole) // 40 or 1):
        flip(file, at)
        refused(lambda: open_store(path), "codebooks")
        file.write_bytes(whole)
    file.write_bytes((made(2, codec) / "codebooks/c/0/0/0").read_bytes())
    refused(lambda: open_store(path), "the codebooks belong to another store")
    file.unlink()
    refused(lambda: open_store(path), "the codebooks: is missing")
    shutil.rmtree(path / "codebooks")
    refused(lambda: open_store(path), "codebooks")
    refused(lambda: load_volume(path), "codebooks")


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda own: own["codes"].update(version=1), "codes of version 1, expected version 2: store the volume again"),
        (lambda own: own["codes"].update(version=3), "codes of version 3, expected version 2"),
        (lambda own: own["codes"].update(codec="vq-9"), "stored by a newer clvol (codec 'vq-9')"),
        (lambda own: own["codecs"][0].update(name="vq-9"), "stored by a newer clvol (codec 'vq-9')"),
        (lambda own: own.update(version=2), "stored by a newer clvol (version 2)"),
        (lambda own: own.pop("codes"), "damaged zarr.json (codes)"),
        (lambda own: own.update(codes=None), "damaged zarr.json"),
        (lambda own: own.update(codes={}), "damaged zarr.json (codes: no version)"),
        (lambda own: own["codes"].update(codec="hvq"), "damaged zarr.json"),
        (lambda own: own["codes"].update(codec="zstd"), "damaged zarr.json"),
        (lambda own: own["codes"].update(codebooks=None), "damaged zarr.json"),
        (lambda own: own["codes"].update(measured={}), "damaged zarr.json"),
        (lambda own: own["codes"].update(target={"speed": 3}), "damaged zarr.json"),
        (lambda own: own["codes"]["codebooks"].update(side=2), "codebooks"),
        (lambda own: own["codes"]["codebooks"]["values"].update(low=7), "codebooks: their parameters are damaged"),
        (lambda own: own["codes"].update(checksum=5), "the codebooks belong to another store"),
        (lambda own: own["codes"]["codebooks"].update(side=2), "codebooks"),
        (lambda own: own["codes"]["codebooks"].update(side="x"), "codebooks"),
        (lambda own: own["codes"]["codebooks"].update(shifts=[77]), "damaged zarr.json (codebooks"),
        (lambda own: own["codes"]["codebooks"].update(shifts=[1, 2]), "codebooks"),
        (lambda own: own["codes"]["codebooks"].pop("shifts"), "damaged zarr.json"),
        (lambda own: own["codes"]["codebooks"]["values"].update(dtype="float32"), "damaged zarr.json"),
        (lambda own: own["codes"]["codebooks"]["values"].update(dtype="O"), "damaged zarr.json"),
        (lambda own: own["codes"]["codebooks"]["values"].update(scale="nan"), "damaged zarr.json"),
        (lambda own: own["codecs"][4].update(name="rvq"), "damaged zarr.json"),
        (lambda own: own["codecs"][3].update(name="rvq"), "damaged zarr.json"),
        (lambda own: own["codecs"][0].update(name="zstd"), "array '0'"),
        (lambda own: own["codecs"][0].update(name="hvq"), "damaged zarr.json"),
    ],
)
def test_metadata_that_do_not_fit_are_refused(copied, edit, said):
    path = copied()
    change(path, edit)
    for use in (open_store, load_volume):
        error = refused(lambda: use(path), said)
        assert error.where == str(path)


@pytest.mark.parametrize("what", ("kind", "sizes", "long", "empty"))
def test_impossible_codes_are_found_though_their_checksums_match(copied, what):
    """As a store without the table of checksums might hold them: of a writer with a fault."""
    path = copied()
    change(path, lambda own: own.pop("checksums"))
    store = open_store(path)
    size = store.layout.capacity(0)
    array = open_array(path / "0")
    pack = array[0, 0, :size].read().result()
    sizes = pack[:256].reshape(4, 64)
    if what == "kind":
        pack[256 + int(sizes[0, 0]) + 256 * int(sizes[1, 0])] = 77
    elif what == "sizes":
        sizes[0, 1] += 1
    elif what == "long":
        sizes[3, 1] = 255
    else:
        sizes[:, 1] = 0
    array[0, 0, :size].write(pack).result()
    store = open_store(path)
    for read in (store.read, store.read_codes):
        refused(lambda: read(0, np.arange(store.blocks.count)), "block (0, 0, 1) at level 0: impossible codes")
    store.read(0, [0])


def test_packs_hold_what_was_packed():
    rng = np.random.default_rng(0)
    for counts, n in (((3, 5, 9), 4), ((1, 1, 1), 4), ((6, 3, 3), 3), ((2, 2, 2), 1)):
        size = rng.integers(1, 60, np.prod(counts))
        start = rng.permutation(np.arange(len(size)) * 60)
        data = rng.integers(0, 256, 60 * len(size), np.uint8)
        room = capacity(n**3, 64)
        packs = packed(CodedBlocks(data, start, size), counts, n, room)
        along = [-(-count // n) for count in counts]
        assert packs.shape == (along[0], along[1], along[2] * room)
        places = np.stack(np.unravel_index(np.arange(len(size)), counts), axis=-1)
        pack = np.ravel_multi_index(tuple((places // n).T), along)
        slot = np.ravel_multi_index(tuple((places % n).T), (n,) * 3)
        found = unpacked(packs.reshape(-1, room), pack, slot, n)
        for k in range(len(size)):
            own = found.data[found.start[k] : found.start[k] + found.size[k]]
            np.testing.assert_array_equal(own, data[start[k] : start[k] + size[k]])


@pytest.mark.parametrize(("blocks", "wanted"), [(8, 4), (16, 4), (6, 3), (2, 2), (5, 1), (1, 1), (9, 3)])
def test_the_side_of_packs_divides_a_shard(blocks, wanted):
    assert side(blocks) == wanted
