"""Volumes as codes: all ways of encoding them in parts and of decoding them agree."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.coarse_codes import CoarseTrainer
from helpers.small_scenes import waves

from clvol import Volume
from clvol.encoding import coded_volume
from clvol.encoding.coded_volume import (
    DecodedVolume,
    UndecodedVolume,
    decode_on_host,
    encoded_volume,
    measured_codes,
)
from clvol.integrators.decoding import decode_on
from clvol.scene import Compression

RVQ = Compression(codec="rvq")
SHAPE = (53, 34, 40)


def voxels(dtype=np.float32) -> np.ndarray:
    array = waves(SHAPE, dtype, -90, 120)
    if np.dtype(dtype).kind == "f":
        array[3, 4, 5:9], array[50, 33, 39] = np.nan, -np.inf
    return array


def coded(array: np.ndarray, progress=None):
    return encoded_volume(Volume(array, name="waves"), RVQ, CoarseTrainer(), progress)


@pytest.mark.parametrize("dtype", [np.int8, np.float32])
def test_parts_and_places_of_decoding_agree(dtype, context, monkeypatch):
    array = voxels(dtype)
    whole = coded(array)
    expected = decode_on_host(whole.coded, whole.blocks, whole.codebooks)
    assert expected.shape == SHAPE and expected.dtype == dtype
    monkeypatch.setattr(coded_volume, "_PIECE", 1)  # one layer of blocks at a time
    parts = coded(array)
    for name in ("data", "start", "size"):
        np.testing.assert_array_equal(getattr(parts.coded, name), getattr(whole.coded, name))
    small = SimpleNamespace(device=SimpleNamespace(max_mem_alloc_size=100))  # a device that cannot hold the voxels
    for decode in (decode_on(context), decode_on(small), decode_on_host):
        layers = dict(parts.layers(decode))
        assert list(layers) == [0, 16, 32, 48]
        np.testing.assert_array_equal(np.concatenate(list(layers.values())), expected)
        np.testing.assert_array_equal(decode(parts.coded, parts.blocks, parts.codebooks), expected)
    np.testing.assert_array_equal(UndecodedVolume(whole).data, expected)


@pytest.mark.parametrize("dtype", [np.int8, np.float32])
def test_what_is_known_of_voxels_that_are_not_decoded(dtype, monkeypatch):
    array = voxels(dtype)
    original, codes = Volume(array), coded(array)
    monkeypatch.setattr(coded_volume, "_CACHED", 1000)
    known = measured_codes(codes, original, codes.layers(decode_on_host))
    decoded = DecodedVolume(decode_on_host(codes.coded, codes.blocks, codes.codebooks), known)
    same = measured_codes(codes, original, decoded.layers())
    assert known.measured == same.measured
    volume = UndecodedVolume(known)
    for name in ("shape", "dtype", "value_range", "nan_count", "inf_count", "name", "nbytes"):
        assert getattr(volume, name) == getattr(decoded, name), name
    assert "data" not in vars(volume) and volume.name == "waves"


def test_numbers_of_blocks(monkeypatch):
    codes = coded(voxels())
    some = codes.read_codes(0, np.array([7, 2, 30]))
    for k, block in enumerate((7, 2, 30)):
        start, size = codes.coded.start[block], codes.coded.size[block]
        assert (some.start[k], some.size[k]) == (start, size)
    with pytest.raises(ValueError, match="no codes of level 1"):
        codes.read_codes(1, np.array([0]))


def test_progress_ends_with_all_voxels():
    told: list[tuple[int, int]] = []
    coded(voxels(), lambda done, total: told.append((done, total)))
    assert told[-1] == (np.prod(SHAPE),) * 2 and told == sorted(told)


def test_bytes_and_bits():
    codes = coded(voxels())
    assert codes.nbytes == len(codes.coded.data) + codes.codebooks.nbytes + 4 * len(codes.coded)
    assert codes.bits_per_voxel == pytest.approx(8 * codes.nbytes / np.prod(SHAPE))
