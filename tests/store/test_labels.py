"""The lossless codec "labels": the same voxels for any input, small where there are regions, never larger than raw."""

from __future__ import annotations

import numpy as np
import pytest
from reference.plain_codes import read
from reference.random_codes import DTYPES

from clvol.store.codecs.coded_blocks import CONSTANT, RAW, REGIONS, RUNS
from clvol.store.codecs.decode import decode_blocks
from clvol.store.codecs.labels import encode_labels, label_codebooks
from clvol.store.codecs.layout import check_codes


def regions(rng, k, s, dtype, most):
    """Blocks of regions: the nearest of a few random places says which label a voxel has."""
    grid = np.stack(np.meshgrid(*[np.arange(s)] * 3, indexing="ij"), -1).reshape(-1, 3)
    blocks = np.empty((k, s**3), dtype)
    info = np.iinfo(dtype) if np.dtype(dtype).kind in "iu" else np.iinfo(np.int16)
    for block in blocks:
        count = int(rng.integers(1, most + 1))
        places = rng.uniform(-s / 2, 1.5 * s, (count, 3))
        labels = rng.integers(info.min, info.max + 1, count)
        block[:] = labels[((grid[:, None] - places) ** 2).sum(-1).argmin(1)]
    return blocks.reshape(k, s, s, s)


def hard_blocks(rng, s, dtype):
    """Noise of 2, 3, 4, 5, 16, 17, 256, 257 labels and of all; slabs along each axis; one voxel that differs; NaN."""
    kind = np.dtype(dtype)
    blocks = []
    for count in (2, 3, 4, 5, 16, 17, 256, 257, 65536):
        noise = rng.integers(0, min(count, 1 << 8 * min(kind.itemsize, 2)), (s, s, s))
        blocks.append(noise.astype(f"u{kind.itemsize}").view(kind))
    for axis in range(3):
        slabs = np.broadcast_to(np.arange(s).reshape([-1 if a == axis else 1 for a in range(3)]), (s, s, s))
        blocks.append(slabs.astype(kind))
    lonely = np.zeros((s, s, s), kind)
    lonely[s // 2, s - 1, 0] = 7
    blocks += [lonely, np.full((s, s, s), 5, kind)]
    if kind.kind == "f":
        odd = rng.choice(np.array([np.nan, -np.nan, np.inf, -np.inf, 0.0, -0.0, 1e30], kind), (s, s, s))
        blocks += [odd, np.full((s, s, s), np.nan, kind)]
    return np.stack(blocks)


@pytest.mark.parametrize("s", (1, 2, 4, 8, 16, 32))
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_block_comes_back_bit_for_bit(dtype, s):
    rng = np.random.default_rng(s)
    codebooks = label_codebooks(np.dtype(dtype))
    blocks = np.concatenate([hard_blocks(rng, s, dtype), regions(rng, 12, s, dtype, 9)])
    coded = encode_labels(blocks)
    assert len(check_codes(coded, s, codebooks)) == 0
    decoded = decode_blocks(coded, s, codebooks)
    assert decoded.dtype == blocks.dtype and decoded.tobytes() == blocks.tobytes()
    for k, block in enumerate(blocks if s < 32 else blocks[:4]):
        data = coded.data[coded.start[k] : coded.start[k] + coded.size[k]].tobytes()
        assert read(data, s, codebooks).tobytes() == block.tobytes()
    assert (coded.size <= 1 + s**3 * np.dtype(dtype).itemsize).all()


def test_each_kind_is_used_where_it_is_smallest():
    rng = np.random.default_rng(0)
    slabs = np.broadcast_to(np.arange(16, dtype=np.uint16)[:, None, None], (16, 16, 16))
    ball = (np.square(np.indices((16, 16, 16)) - 4).sum(0) < 60).astype(np.uint16) * 1000
    noise = rng.integers(0, 65536, (16, 16, 16)).astype(np.uint16)
    coded = encode_labels(np.stack([np.full_like(noise, 9), slabs, ball, noise]))
    assert coded.data[coded.start].tolist() == [CONSTANT, RUNS, REGIONS, RAW]
    assert coded.size.tolist()[0] == 3 and coded.size[1] == 2 + 32 + 2 + 48 and coded.size[3] == 1 + 8192
    assert coded.size[2] < 300


def test_a_mask_takes_little_more_than_a_bit_per_voxel_of_its_surface():
    rng = np.random.default_rng(1)
    mask = rng.integers(0, 2, (5, 16, 16, 16)).astype(np.uint8)  # ten bytes at most for 64 voxels
    assert (encode_labels(mask).size <= 512 + 128 + 1 + 3 + 1 + 16 + 16).all()
    ball = (np.square(np.indices((32, 32, 32)) - 15.5).sum(0) < 200).astype(np.uint8)  # a surface of 2500 voxels
    assert encode_labels(ball[None]).size < 1200


def test_bytes_do_not_depend_on_what_is_encoded_together():
    rng = np.random.default_rng(2)
    blocks = np.concatenate([hard_blocks(rng, 8, "uint16"), regions(rng, 20, 8, "uint16", 6)])
    together = encode_labels(blocks)
    for k, block in enumerate(blocks):
        alone = encode_labels(block[None])
        own = together.data[together.start[k] : together.start[k] + together.size[k]]
        assert own.tobytes() == alone.data.tobytes()


def test_no_blocks_are_no_bytes():
    coded = encode_labels(np.zeros((0, 8, 8, 8), np.uint8))
    assert len(coded) == 0 and len(coded.data) == 0


@pytest.mark.parametrize("dtype", ("uint8", "float32"))
def test_damaged_blocks_are_found_or_decode_to_something(dtype):
    rng = np.random.default_rng(7)
    codebooks = label_codebooks(np.dtype(dtype))
    coded = encode_labels(np.concatenate([regions(rng, 150, 8, dtype, 7), hard_blocks(rng, 8, dtype)]))
    data = coded.data.copy()
    for start, size in zip(coded.start, coded.size):
        for at in rng.integers(0, min(size, 60), 2):
            data[start + at] = rng.integers(256)
    damaged = check_codes(type(coded)(data, coded.start, coded.size), 8, codebooks)
    sound = np.setdiff1d(np.arange(len(coded)), damaged)
    assert len(sound) and len(damaged)
    kept = type(coded)(data, coded.start[sound], coded.size[sound])
    plain = [read(data[a : a + n].tobytes(), 8, codebooks) for a, n in zip(kept.start, kept.size)]
    assert decode_blocks(kept, 8, codebooks).tobytes() == np.stack(plain).tobytes()
    shorter = type(coded)(coded.data, coded.start, coded.size - 1)
    assert len(check_codes(shorter, 8, codebooks)) == len(coded)
