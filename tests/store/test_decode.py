"""The numpy decoder of coded blocks beside a plain one that follows the text of the layout; damaged codes are found."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from reference.plain_codes import Coded, SubBlock, read, write
from reference.random_codes import CODECS, DTYPES, packed, random_codebooks, random_codes

from clvol.errors import VolumeError
from clvol.store.codecs.coded_blocks import WHOLE, CodedBlocks
from clvol.store.codecs.decode import decode_blocks
from clvol.store.codecs.layout import check_codes, parse_coded, prefix_sizes

COUNTS = {1: 6, 2: 6, 4: 40, 8: 24, 16: 6, 32: 2}


def same_bits(a, b) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


@pytest.mark.parametrize("s", COUNTS)
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("codec", CODECS)
def test_voxels_are_those_of_the_plain_reader(codec, dtype, s):
    blocks, codebooks = random_codes(s, codec, s, dtype, COUNTS[s])
    coded = packed(blocks)
    assert len(check_codes(coded, s, codebooks)) == 0
    plain = np.stack([read(block, s, codebooks) for block in blocks])
    assert same_bits(decode_blocks(coded, s, codebooks), plain)


@pytest.mark.parametrize("s", (4, 8, 16))
@pytest.mark.parametrize("codec", CODECS)
def test_a_limit_of_stages_needs_a_prefix_of_the_bytes_alone(codec, s):
    blocks, codebooks = random_codes(5, codec, s, "int16", COUNTS[s])
    sizes = prefix_sizes(packed(blocks), s, codebooks)
    assert sizes.shape == (len(blocks), codebooks.stages + 2)
    assert (sizes[:, -1] == [len(block) for block in blocks]).all()
    for limit in range(codebooks.stages + 2):
        cut = [block[: sizes[k, limit]] for k, block in enumerate(blocks)]
        plain = np.stack([read(block, s, codebooks, limit) for block in blocks])
        assert same_bits(decode_blocks(packed(cut), s, codebooks, limit), plain)
        assert same_bits(decode_blocks(packed(blocks), s, codebooks, limit), plain)
        short = [block[:-1] for block in cut]
        assert list(check_codes(packed(short), s, codebooks, limit)) == list(range(len(blocks)))


def test_every_length_but_its_own_is_impossible():
    for codec in CODECS:
        blocks, codebooks = random_codes(9, codec, 8, "float32", 30)
        shorter = [block[:-1] for block in blocks]
        assert list(check_codes(packed(shorter), 8, codebooks)) == list(range(30))
        longer = [block + b"\0" for block in blocks]
        assert list(check_codes(packed(longer), 8, codebooks)) == list(range(30))


def test_impossible_bytes_are_named_by_block():
    rng = np.random.default_rng(3)
    codebooks = random_codebooks(rng, "rvq", "uint8", stages=5)
    good = write(Coded([[SubBlock(1, [2, 3])] * 8]), 8, codebooks)
    escaped = write(Coded([[SubBlock(1, [2], 3, [1] * 64)] + [SubBlock(0)] * 7]), 8, codebooks)

    def changed(block: bytes, at: int, byte: int) -> bytes:
        return block[:at] + bytes([byte]) + block[at + 1 :]

    head = 1 + 1 + 8 + 4
    blocks = [
        good,
        changed(good, 0, 4),  # an unknown kind
        changed(good, 0, 3),  # a kind of other codecs
        changed(good, 1, 3),  # a flag beyond the last octant
        changed(good, 10, 0x2E),  # 14 stages
        changed(good, 10, 0x26),  # more stages than codebooks
        changed(good, 10, 0x2F),  # an escape that is not there
        escaped,
        changed(escaped, head, 0x36),  # more stages than codebooks
        changed(escaped, head, 0x32),  # a stage that is not there
        changed(escaped, head, 0x91),  # nine bits
        changed(escaped, head, 0xFF),  # raw samples that are not there
        b"",
    ]
    assert list(check_codes(packed(blocks), 8, codebooks)) == [1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12]
    with pytest.raises(VolumeError, match="11 blocks .block 1, 2, 3, 4, 5."):
        decode_blocks(packed(blocks), 8, codebooks)


def test_places_beyond_the_data_are_impossible():
    blocks, codebooks = random_codes(1, "rvq", 8, "uint8", 4)
    coded = packed(blocks)
    start = coded.start.copy()
    start[:3] = -1, len(coded.data), 2**62
    assert list(check_codes(CodedBlocks(coded.data, start, coded.size), 8, codebooks)) == [0, 1, 2]
    size = coded.size.copy()
    size[1:3] = 2**63 - 1, -5
    assert list(check_codes(CodedBlocks(coded.data, coded.start, size), 8, codebooks)) == [1, 2]


@pytest.mark.parametrize("codec", CODECS)
def test_damaged_blocks_are_found_or_decode_to_something(codec):
    rng = np.random.default_rng(7)
    blocks, codebooks = random_codes(7, codec, 8, "uint16", 200)
    for k, block in enumerate(blocks):
        changed = bytearray(block)
        for at in rng.integers(0, min(len(block), 40), 2):
            changed[at] = rng.integers(256)
        blocks[k] = bytes(changed)
    coded = packed(blocks)
    damaged = check_codes(coded, 8, codebooks)
    sound = np.setdiff1d(np.arange(len(blocks)), damaged)
    assert len(sound) and len(damaged)
    kept = CodedBlocks(coded.data, coded.start[sound], coded.size[sound])
    plain = np.stack([read(blocks[k], 8, codebooks) for k in sound])
    assert same_bits(decode_blocks(kept, 8, codebooks), plain)


@pytest.mark.parametrize("s", (4, 8, 16))
def test_checking_finds_what_parsing_finds(s):
    rng = np.random.default_rng(s)
    blocks, codebooks = random_codes(s, "rvq", s, "uint8", 300, stages=7)
    blocks = [block for block in blocks if block[0] == 2]
    for k, block in enumerate(blocks):
        changed = bytearray(block)
        for at in rng.integers(1, min(len(block), 30), int(rng.integers(3))):
            changed[at] = rng.integers(256)
        blocks[k] = bytes(changed)
    coded = packed(blocks)
    for limit in (0, 3, WHOLE):
        good = parse_coded(coded.data, coded.start, coded.size, s, codebooks, limit).good
        assert good.any() and not good.all()
        assert check_codes(coded, s, codebooks, limit).tolist() == np.flatnonzero(~good).tolist()


@pytest.mark.parametrize("change", [
    {"codec": "later"}, {"side": 2}, {"entries": np.zeros((3, 256, 8), np.int8)}, {"residual_step": 0},
    {"shifts": np.array([1, 2, 10])}, {"entries": np.zeros((3, 255, 64), np.int8)}, {"shifts": np.zeros(13, int)},
])  # fmt: skip
def test_impossible_codebooks_are_refused(change):
    blocks, codebooks = random_codes(2, "rvq", 4, "int8", 3, stages=3)
    assert codebooks.fault() is None
    with pytest.raises(VolumeError, match="codebooks"):
        decode_blocks(packed(blocks), 4, dataclasses.replace(codebooks, **change))


def test_a_volume_without_stages_consists_of_means():
    rng = np.random.default_rng(1)
    codebooks = random_codebooks(rng, "rvq", "uint8", stages=0, whole=True)
    assert codebooks.fault() is None
    coded = packed([write(Coded([7] * 8), 16, codebooks), write(Coded([200] * 8), 16, codebooks)])
    assert (decode_blocks(coded, 16, codebooks, WHOLE) == np.array([7, 200])[:, None, None, None]).all()


def test_no_blocks_are_no_voxels():
    _, codebooks = random_codes(1, "rvq", 8, "uint8", 1)
    none = CodedBlocks(np.zeros(0, np.uint8), np.zeros(0, np.int64), np.zeros(0, np.int64))
    assert decode_blocks(none, 8, codebooks).shape == (0, 8, 8, 8)
