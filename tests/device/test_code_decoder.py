"""Blocks of codes decoded by kernels: the voxels of the numpy decoder, bit for bit, in blocks and in volumes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference.plain_codes import Coded, SubBlock, write
from reference.random_codes import CODECS, DTYPES, LOSSY, packed, random_codes

from clvol.device import code_decoder
from clvol.device.code_decoder import CodeDecoder, HeldCodes, code_map, is_narrow, parts_of, switches
from clvol.errors import RenderError, VolumeError
from clvol.opencl.struct_check import REPORT_ARGUMENTS, check_structs, layout_of, reported_structs
from clvol.opencl.structs import CODE_MAP, CODED_BLOCK
from clvol.store.codecs.coded_blocks import WHOLE, Codebooks
from clvol.store.codecs.decode import decode_blocks
from clvol.store.codecs.labels import label_codebooks
from clvol.store.codecs.layout import check_codes, prefix_sizes
from clvol.store.codecs.working_values import LARGEST, WorkingValues

COUNTS = {1: 8, 2: 8, 4: 150, 8: 60, 16: 12, 32: 4}


def untouched(context, dtype, shape):
    """An array of a pattern that no decoder writes by chance, to see what was written."""
    count = int(np.prod(shape)) * np.dtype(dtype).itemsize
    pattern = (np.arange(count) * 37 % 251).astype(np.uint8).view(dtype).reshape(shape)
    return context.upload(pattern, writable=True), pattern.copy()


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("codec", CODECS)
def test_blocks_are_those_of_numpy(each_device, contexts, codec, dtype):
    context = contexts(each_device)
    for s, count in COUNTS.items():
        blocks, codebooks = random_codes(s + 100, codec, s, dtype, count)
        decoder = CodeDecoder(context, codebooks)
        coded = packed(blocks)
        held = decoder.hold(coded, s)
        rng = np.random.default_rng(s)
        some = rng.permutation(count)[: count - 1]
        places = (rng.permutation(count + 3)[: len(some)] * s**3 + 5).astype(np.int64)  # of no alignment
        for stages in (WHOLE, 0, 1, codebooks.stages):
            voxels, before = untouched(context, dtype, ((count + 3) * s**3 + 10,))
            decoder.into_blocks(held, some, voxels, places, stages)
            decoder.check_fault()
            expected = before
            decoded = decode_blocks(coded, s, codebooks, stages)
            for block, place in zip(some, places):
                expected[place : place + s**3] = decoded[block].ravel()
            assert context.read(voxels).tobytes() == expected.tobytes(), (s, stages)


@pytest.mark.parametrize("codec", LOSSY)
def test_each_block_may_have_a_limit_of_its_own(device, contexts, codec):
    context = contexts(device)
    blocks, codebooks = random_codes(3, codec, 8, "int8", 60)
    decoder = CodeDecoder(context, codebooks)
    limits = np.random.default_rng(0).integers(0, codebooks.stages + 2, len(blocks))
    sizes = prefix_sizes(packed(blocks), 8, codebooks)
    cut = packed([block[: sizes[k, limits[k]]] for k, block in enumerate(blocks)])
    expected = np.stack([decode_blocks(packed([block]), 8, codebooks, int(limits[k]))[0]
                         for k, block in enumerate(blocks)])  # fmt: skip
    for coded in (cut, packed(blocks)):
        voxels, _ = untouched(context, "int8", (len(blocks) * 512,))
        held = decoder.hold(coded, 8, limits)
        decoder.into_blocks(held, np.arange(len(blocks)), voxels, np.arange(len(blocks)) * 512, limits)
        assert context.read(voxels).tobytes() == expected.tobytes()
        volume, _ = untouched(context, "int8", (8, 8, len(blocks) * 8))
        corners = np.arange(len(blocks))[:, None] * (0, 0, 8)
        decoder.decode_volume(coded, 8, volume, corners, limits, staging_bytes=2000)
        assert (context.read(volume).reshape(8, 8, -1, 8).transpose(2, 0, 1, 3) == expected).all()
    with pytest.raises(VolumeError, match="impossible bytes of block"):
        decoder.hold(cut, 8)


@pytest.mark.parametrize("dtype", ("uint8", "int16", "float32"))
@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("s", (4, 8, 16))
def test_volumes_are_those_of_numpy_and_what_is_beyond_them_is_cut(device, contexts, codec, dtype, s):
    context = contexts(device)
    shape = (2 * s - 1, s + 3, 3 * s - s // 2 - 1)
    counts = [-(-n // s) for n in shape]
    count = int(np.prod(counts))
    blocks, codebooks = random_codes(s, codec, s, dtype, count)
    coded = packed(blocks)
    corners = np.stack(np.unravel_index(np.arange(count), counts), axis=-1) * s
    whole = decode_blocks(coded, s, codebooks).reshape(*counts, s, s, s).transpose(0, 3, 1, 4, 2, 5)
    expected = whole.reshape([n * s for n in counts])[tuple(slice(n) for n in shape)]
    decoder = CodeDecoder(context, codebooks)
    for staging in (1, int(coded.size.max()) * 2, 2**20):
        voxels, _ = untouched(context, dtype, shape)
        seen: list = []
        decoder.decode_volume(coded, s, voxels, corners, staging_bytes=staging,
                              progress=lambda done, total: seen.append((done, total)))  # fmt: skip
        assert context.read(voxels).tobytes() == np.ascontiguousarray(expected).tobytes()
        parts = len(list(parts_of(coded.size, max(staging, int(coded.size.max())))))
        assert len(seen) == parts and seen[-1] == (count, count) and (parts > 1 or staging > 1)
    held = decoder.hold(coded, s)
    slab, _ = untouched(context, dtype, (s - 1, *shape[1:]))  # the last slices alone
    own = np.flatnonzero(corners[:, 0] >= s)
    decoder.into_volume(held, own, slab, corners[own], first_slice=s)
    assert context.read(slab).tobytes() == np.ascontiguousarray(expected[s:]).tobytes()


@pytest.mark.parametrize("codec", CODECS)
def test_offsets_of_codes_and_voxels_may_exceed_what_32_bits_hold(device, contexts, codec):
    context = contexts(device)
    blocks, codebooks = random_codes(1, codec, 8, "uint16", 20)
    decoder = CodeDecoder(context, codebooks)
    coded = packed(blocks)
    held = decoder.hold(coded, 8)
    voxels, _ = untouched(context, "uint16", (20 * 512,))
    far_codes, far_voxels = 2**31 + 7, 5 * 2**32 + 11
    places = np.arange(20) * 512 + far_voxels
    extent = np.full((20, 4), 8, np.int32)
    decoder._decode(held.codes, held.start + far_codes, places, extent, voxels, WHOLE,
                    first_code=far_codes, first_voxel=far_voxels)  # fmt: skip
    assert context.read(voxels).tobytes() == decode_blocks(coded, 8, codebooks).tobytes()


@pytest.mark.parametrize(
    ("codec", "dtype"), [("rvq", "uint8"), ("rvq", "int16"), ("rvq", "float32"), ("hvq", "uint16")]
)
def test_sums_of_codes_that_16_bits_hold(each_device, contexts, codec, dtype):
    """Shifts as trained codebooks have them: without the zero bits that all working values end with."""
    context = contexts(each_device)
    for s, least in ((4, 3), (8, 5), (16, 6), (16, 9)):
        blocks, codebooks = random_codes(s + least, codec, s, dtype, COUNTS[s])
        shifts = least + np.minimum(np.arange(codebooks.stages)[::-1] // 5, 9 - least)
        codebooks = replace(codebooks, shifts=shifts.astype(np.int32))
        assert is_narrow(codebooks) and code_map(codebooks)["unit"] == min(least, 7)
        decoder, coded = CodeDecoder(context, codebooks), packed(blocks)
        for stages in (WHOLE, 2):
            voxels, _ = untouched(context, dtype, (len(blocks) * s**3,))
            numbers = np.arange(len(blocks))
            decoder.into_blocks(decoder.hold(coded, s), numbers, voxels, numbers * s**3, stages)
            assert context.read(voxels).tobytes() == decode_blocks(coded, s, codebooks, stages).tobytes(), (s, stages)


@pytest.mark.parametrize("high", [True, False])
def test_the_largest_sums_that_16_bits_hold(device, contexts, high):
    context = contexts(device)
    for more in (0, 1):
        values = WorkingValues(np.dtype("uint16"), 0, LARGEST)
        entries = np.zeros((5, 256, 64), np.int8)
        # In multiples of 8, means are up to 8191: with 64 * (3 * 127 + 3) more 32767; and 64 * 4 * 128 are 32768.
        entries[:, 7] = np.array([127, 127, 127, 3, more] if high else [-128, -128, -128, -128, -more])[:, None]
        shifts = np.array([9, 9, 9, 9, 3], np.int32)
        codebooks = Codebooks("rvq", 4, entries, shifts, values, 1)
        assert is_narrow(codebooks) == (more == 0)
        block = packed([write(Coded([[SubBlock(255 if high else 0, [7] * 5)]]), 4, codebooks)])
        voxels, _ = untouched(context, "uint16", (64,))
        decoder = CodeDecoder(context, codebooks)
        decoder.into_blocks(decoder.hold(block, 4), np.array([0]), voxels, np.array([0]))
        assert (context.read(voxels) == (LARGEST if high else 0)).all()
        assert context.read(voxels).tobytes() == decode_blocks(block, 4, codebooks).tobytes()


@pytest.mark.parametrize(
    ("codec", "dtype"), [("rvq", "uint8"), ("rvq", "uint16"), ("rvq", "float32"), ("vq", "int16"), ("labels", "int8")]
)
def test_large_arrays_are_written_by_whole_cache_lines(each_device, contexts, monkeypatch, codec, dtype):
    monkeypatch.setattr(code_decoder, "_STREAMED_BYTES", (0, 0))
    context = contexts(each_device)
    for shape in ((17, 33, 128), (31, 16, 113), (16, 20, 16)):  # rows of whole lines, odd ones, and a single block
        counts = [-(-n // 16) for n in shape]
        count = int(np.prod(counts))
        blocks, codebooks = random_codes(9, codec, 16, dtype, count)
        coded = packed(blocks)
        decoded = decode_blocks(coded, 16, codebooks)
        decoder = CodeDecoder(context, codebooks)
        held = decoder.hold(coded, 16)
        for first in (0, 3):  # aligned, and not
            voxels, expected = untouched(context, dtype, (first + count * 4096 + 9,))
            decoder.into_blocks(held, np.arange(count), voxels, first + np.arange(count) * 4096)
            expected[first : first + count * 4096] = decoded.ravel()
            assert context.read(voxels).tobytes() == expected.tobytes()
        corners = np.stack(np.unravel_index(np.arange(count), counts), axis=-1) * 16
        whole = decoded.reshape(*counts, 16, 16, 16).transpose(0, 3, 1, 4, 2, 5).reshape([16 * n for n in counts])
        whole = np.ascontiguousarray(whole[tuple(slice(n) for n in shape)])
        for order in (np.arange(count), np.random.default_rng(1).permutation(count)):
            voxels, _ = untouched(context, dtype, shape)
            decoder.into_volume(held, order, voxels, corners[order])
            decoder.check_fault()
            assert context.read(voxels).tobytes() == whole.tobytes()


def test_a_block_of_unknown_kind_is_filled_and_reported(each_device, contexts):
    context = contexts(each_device)
    for codec in CODECS:
        blocks, codebooks = random_codes(1, codec, 8, "uint8", 5)
        decoder = CodeDecoder(context, codebooks, "a.store")
        held = decoder.hold(packed(blocks), 8)
        codes = context.read(held.codes)
        codes[held.start[3]] = 77
        voxels, before = untouched(context, "uint8", (5 * 512,))
        damaged = HeldCodes(context.upload(codes), held.start, 8)
        decoder.into_blocks(damaged, np.arange(5), voxels, np.arange(5) * 512)
        with pytest.raises(RenderError, match="a.store: block 3 of a launch is of an unknown kind"):
            decoder.check_fault()
        found = context.read(voxels)[3 * 512 : 4 * 512]
        assert (found == codebooks.values.low).all()
        decoder.into_blocks(held, np.arange(5), voxels, np.arange(5) * 512)
        decoder.check_fault()
        assert context.read(voxels).tobytes() == decode_blocks(packed(blocks), 8, codebooks).tobytes()


def test_impossible_codes_never_reach_a_device(device, contexts):
    context = contexts(device)
    blocks, codebooks = random_codes(1, "rvq", 8, "uint8", 6)
    blocks[4] = b"\x4d" + blocks[4][1:]
    coded = packed(blocks)
    decoder = CodeDecoder(context, codebooks, "a.store")
    with pytest.raises(VolumeError, match="a.store: impossible bytes of block 4"):
        decoder.hold(coded, 8)
    voxels, before = untouched(context, "uint8", (8, 8, 48))
    corners = np.arange(6)[:, None] * (0, 0, 8)
    with pytest.raises(VolumeError, match="a.store: impossible bytes of block 4"):
        decoder.decode_volume(coded, 8, voxels, corners, staging_bytes=1)
    assert (context.read(voxels)[:, :, 32:] == before[:, :, 32:]).all()
    with pytest.raises(RenderError, match="labels of float64"):
        CodeDecoder(context, label_codebooks(np.dtype(np.float64)))
    codebooks.shifts[0] = 10
    with pytest.raises(VolumeError, match="impossible codebooks"):
        CodeDecoder(context, codebooks)


@pytest.mark.parametrize("codec", CODECS)
def test_damaged_codes_that_are_possible_decode_as_in_numpy(device, contexts, codec):
    context, rng = contexts(device), np.random.default_rng(11)
    blocks, codebooks = random_codes(11, codec, 16, "int16", 80)
    changed = [bytearray(block) for block in blocks]
    for block in changed:
        for at in rng.integers(1, min(len(block), 200), 3):
            block[at] = rng.integers(256)
    damaged = check_codes(packed(changed), 16, codebooks)
    coded = packed([block for k, block in enumerate(changed) if k not in damaged])
    assert 10 < len(coded) and (len(damaged) or codec not in ("rvq", "labels"))
    decoder = CodeDecoder(context, codebooks)
    voxels, _ = untouched(context, "int16", (len(coded) * 4096,))
    decoder.into_blocks(decoder.hold(coded, 16), np.arange(len(coded)), voxels, np.arange(len(coded)) * 4096)
    assert context.read(voxels).tobytes() == decode_blocks(coded, 16, codebooks).tobytes()


def test_what_does_not_fit_is_refused(device, contexts):
    context = contexts(device)
    blocks, codebooks = random_codes(1, "rvq", 8, "uint8", 2)
    decoder = CodeDecoder(context, codebooks)
    held = decoder.hold(packed(blocks), 8)
    with pytest.raises(RenderError, match="1023 voxels, expected at least 1024"):
        decoder.into_blocks(held, np.arange(2), context.empty(np.uint8, (1023,)), np.array([0, 512]))
    with pytest.raises(RenderError, match="decoded into uint16, expected uint8"):
        decoder.into_blocks(held, np.arange(2), context.empty(np.uint16, (1024,)), np.array([0, 512]))
    volume = context.empty(np.uint8, (8, 8, 8))
    for corner in ((0, 0, 8), (-1, 0, 0)):
        with pytest.raises(RenderError, match="outside the volume"):
            decoder.into_volume(held, np.array([0]), volume, np.array([corner]))
    decoder.into_blocks(held, np.zeros(0, np.int64), volume, np.zeros(0, np.int64))
    decoder.hold(packed([]), 8)
    with pytest.raises(RenderError, match="to the place -1, expected 0 or more"):
        decoder.into_blocks(held, np.arange(2), context.empty(np.uint8, (1024,)), np.array([-1, 512]))
    with pytest.raises(RenderError, match="blocks of 12 samples per axis, expected one of 1, 2, 4"):
        decoder.hold(packed(blocks), 12)


def test_groups_of_work_items_decode_the_same(device, contexts, monkeypatch):
    context = contexts(device)
    blocks, codebooks = random_codes(8, "rvq", 8, "uint16", 45)
    expected = decode_blocks(packed(blocks), 8, codebooks)
    monkeypatch.setattr(context, "is_cpu", False)
    decoder = CodeDecoder(context, codebooks)
    voxels, _ = untouched(context, "uint16", (45 * 512,))
    decoder.into_blocks(decoder.hold(packed(blocks), 8), np.arange(45), voxels, np.arange(45) * 512)
    assert context.read(voxels).tobytes() == expected.tobytes()


def test_every_field_is_where_the_compiler_has_it(each_device, contexts):
    context = contexts(each_device)
    expected = {"CodedBlock": CODED_BLOCK, "CodeMap": CODE_MAP}
    for dtype in DTYPES:
        _, codebooks = random_codes(1, "rvq", 8, dtype, 1)
        kernel = context.kernel("decode_codes.cl", "struct_fields", REPORT_ARGUMENTS, switches(codebooks, 1))
        check_structs(context, kernel, expected)
        assert reported_structs(context, kernel) == {name: layout_of(own) for name, own in expected.items()}


def test_parts_hold_what_fits_and_one_block_at_least():
    sizes = np.array([3, 4, 9, 1, 1, 1, 8])
    assert [list(part) for part in parts_of(sizes, 8)] == [[0, 1], [2], [3, 4, 5], [6]]
    assert list(parts_of(sizes[:0], 8)) == []
