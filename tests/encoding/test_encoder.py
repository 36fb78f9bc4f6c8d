"""Encoders: what they promise of every voxel, whatever the volume (clvol/encoding)."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from helpers.encoding import CODECS, TYPES, as_type, blocks_of, range_of, smooth, trained

from clvol.encoding import trainer as trainer_module
from clvol.encoding.trainer import CodeTrainer
from clvol.errors import UsageError
from clvol.store.codecs.coded_blocks import CONSTANT, RAW, RateTarget
from clvol.store.codecs.decode import decode_blocks
from clvol.store.codecs.working_values import working_values
from clvol.store.voxel_source import FieldSource, VolumeSource
from clvol.volume.volume import Volume


def round_trip(context, voxels: np.ndarray, codec: str, edge: int = 16, **target: float):
    """Blocks, decoded blocks, the codes and the training."""
    training, encoder = trained(context, voxels, codec, **target)
    blocks = blocks_of(voxels, edge)
    coded = encoder.encode(blocks)
    assert training.codebooks.fault() is None
    return blocks, decode_blocks(coded, edge, training.codebooks), coded, training


def largest_error(blocks: np.ndarray, decoded: np.ndarray) -> float:
    finite = np.isfinite(blocks)
    return float(np.abs(decoded[finite].astype(np.float64) - blocks[finite]).max())


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("share", (0.0, 0.004, 0.03))
def test_no_voxel_is_further_off_than_the_bound(context, codec, dtype, share):
    voxels = as_type(smooth(), dtype)
    blocks, decoded, _, _ = round_trip(context, voxels, codec, max_voxel_error=share)
    low, high = range_of(voxels)
    assert decoded.dtype == dtype
    assert largest_error(blocks, decoded) <= share * (high - low)


@pytest.mark.parametrize("codec", CODECS)
def test_a_psnr_is_reached(context, codec):
    voxels = as_type(smooth(), np.uint8)
    blocks, decoded, _, _ = round_trip(context, voxels, codec, psnr=45.0)
    own = blocks_of(np.ones(voxels.shape, np.uint8), 16, mode="constant") == 1  # padding does not count
    error = np.mean((decoded[own].astype(float) - blocks[own]) ** 2)
    reached = 10 * math.log10(int(np.ptp(voxels)) ** 2 / error)
    assert 45.0 <= reached
    if codec == "rvq":  # of the others, whole blocks become raw
        assert reached < 45.6


@pytest.mark.parametrize("edge", (1, 2, 4, 8, 16, 32))
@pytest.mark.parametrize("codec", CODECS)
def test_blocks_of_every_size(context, codec, edge):
    voxels = as_type(smooth(), np.int16)
    blocks, decoded, _, _ = round_trip(context, voxels, codec, edge, max_voxel_error=0.02)
    assert largest_error(blocks, decoded) <= 0.02 * 65535


@pytest.mark.parametrize("codec", CODECS)
def test_what_is_not_finite_stays_what_it_was(context, codec):
    voxels = as_type(smooth(), np.float32)
    voxels[3:5, 6:20, 7] = np.nan
    voxels[20, 20, 20] = np.inf
    voxels[:16, :16, 16:32] = np.nan
    blocks, decoded, coded, _ = round_trip(context, voxels, codec, max_voxel_error=0.02)
    odd = ~np.isfinite(blocks)
    assert np.array_equal(decoded[odd].view(np.uint32), blocks[odd].view(np.uint32))
    assert largest_error(blocks, decoded) <= 0.02 * np.subtract(*range_of(voxels)[::-1])
    assert coded.data[coded.start[1]] == CONSTANT


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("dtype", (np.uint8, np.uint16))
def test_noise_is_never_much_larger_than_raw(context, codec, dtype):
    voxels = np.random.default_rng(1).integers(0, np.iinfo(dtype).max + 1, (48, 48, 48)).astype(dtype)
    blocks, decoded, coded, _ = round_trip(context, voxels, codec, max_voxel_error=0.0)
    assert np.array_equal(blocks, decoded)
    assert len(coded.data) <= 1.01 * blocks.nbytes
    if dtype == np.uint16 or codec != "rvq":  # of 8 bits, few sub-blocks repeat themselves in the codebooks
        assert (coded.data[coded.start] == RAW).all()


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("voxels", (
    np.full((9, 17, 4), 7, np.uint8),
    np.full((5, 5, 5), -1e30, np.float32),
    np.full((3, 1, 6), np.nan, np.float32),
    np.array([[[0.0, 1e30]]], np.float32),
    np.arange(7, dtype=np.int16).reshape(1, 7, 1),
), ids=lambda v: f"{v.dtype}-{v.shape}")  # fmt: skip
def test_small_and_constant_volumes(context, codec, voxels):
    blocks, decoded, _, _ = round_trip(context, voxels, codec, max_voxel_error=0.0)
    assert np.array_equal(blocks, decoded, equal_nan=True)


@pytest.mark.parametrize("codec", CODECS)
def test_the_grouping_of_blocks_does_not_matter(context, codec):
    voxels = as_type(smooth(), np.uint16)
    training, encoder = trained(context, voxels, codec, psnr=50.0)
    blocks = blocks_of(voxels, 16)
    whole = encoder.encode(blocks)
    for first, last in ((0, 5), (5, 6), (6, len(blocks))):
        part = encoder.encode(blocks[first:last])
        begin, end = whole.start[first], whole.start[last - 1] + whole.size[last - 1]
        assert np.array_equal(part.data, whole.data[begin:end])


@pytest.mark.parametrize("span", (0, 1, 99, 254, 255, 4095, 32768, 53217, 65534, 65535))
def test_integers_survive_as_working_values(span):
    values = working_values(np.dtype(np.uint16), (65535.0 - span, 65535.0))
    voxels = np.arange(65535 - span, 65536).astype(np.uint16)
    assert np.array_equal(values.decoded(values.encoded(voxels)), voxels)


@pytest.mark.parametrize("codec", CODECS)
def test_bits_per_voxel_are_kept_codebooks_and_index_included(context, codec):
    voxels = as_type(smooth((64, 64, 70)), np.uint8)
    blocks, _, coded, training = round_trip(context, voxels, codec, bits_per_voxel=1.2)
    bits = 8 * (len(coded.data) + 4 * len(coded) + training.codebooks.nbytes) / voxels.size
    assert bits <= 1.2
    if codec == "rvq":
        assert bits > 1.1


@pytest.mark.parametrize("codec", ("rvq", "vq"))
def test_a_rate_that_cannot_be_had_says_what_can(context, codec):
    """The least that is named can be had: then all blocks are constant."""
    voxels = as_type(smooth(), np.uint8)
    with pytest.raises(UsageError, match="bits_per_voxel: got 0.001, less than .* at least [0-9.]+ for this") as told:
        trained(context, voxels, codec, bits_per_voxel=0.001)
    least = float(re.search(r"at least ([0-9.]+)", str(told.value))[1])
    _, _, coded, training = round_trip(context, voxels, codec, bits_per_voxel=least)
    assert (coded.data[coded.start] == CONSTANT).all()
    assert 8 * (len(coded.data) + 4 * len(coded) + training.codebooks.nbytes) / voxels.size <= least
    if codec == "rvq":
        assert training.codebooks.stages == 0 and least < 0.04


@pytest.mark.parametrize("dtype", (np.uint8, np.int16, np.float32))
@pytest.mark.parametrize("codec", ("rvq", "vq"))
def test_a_psnr_beyond_what_codes_reach_is_reached(context, codec, dtype):
    voxels = as_type(smooth((40, 33, 36)), dtype)
    span = np.ptp(voxels.astype(np.float64))
    own = blocks_of(np.ones(voxels.shape, np.uint8), 16, mode="constant") == 1  # padding does not count
    for psnr in (95.0, 101.0, 140.0, 200.0):
        blocks, decoded, coded, _ = round_trip(context, voxels, codec, psnr=psnr)
        squares = np.mean((decoded[own].astype(np.float64) - blocks[own]) ** 2)
        assert squares <= span**2 * 10 ** (-psnr / 10)
        assert len(coded.data) <= 1.01 * blocks.nbytes


@pytest.mark.parametrize("codec", CODECS)
def test_fewer_vectors_than_codes_are_exact(context, codec):
    tiles = np.random.default_rng(2).integers(0, 256, (9, 4, 4, 4)).astype(np.uint8)
    if codec in ("vq", "vq-mean"):
        tiles = tiles[:, :2, :2, :2].repeat(2, 1).repeat(2, 2).repeat(2, 3)
        tiles[:, ::2] //= 2
    places = np.random.default_rng(3).integers(0, 9, (16, 16, 16))
    voxels = tiles[places].transpose(0, 3, 1, 4, 2, 5).reshape(64, 64, 64)
    blocks, decoded, coded, training = round_trip(context, voxels, codec, psnr=90.0)
    assert np.array_equal(blocks, decoded)
    if codec == "hvq":  # means of 2^3 samples are rounded, and what they leave with them
        return
    assert 1 <= training.policy["distinct_vectors"] <= 255
    assert len(coded.data) < 0.26 * blocks.nbytes


def test_the_seed_and_the_volume_decide(context):
    voxels = as_type(smooth((96, 96, 96)), np.uint8)
    one, _ = trained(context, voxels, "rvq", psnr=46.0)
    again, _ = trained(context, voxels, "rvq", psnr=46.0)
    assert one.policy == again.policy
    assert np.array_equal(one.codebooks.entries, again.codebooks.entries)


def test_what_is_larger_than_memory_is_drawn_from_everywhere(context, monkeypatch):
    monkeypatch.setattr(trainer_module, "MOST_VOXELS", 1 << 17)
    field = FieldSource("marschner-lobb", (160, 96, 128))
    read = []
    box = field.box
    monkeypatch.setattr(field, "box", lambda *corners: read.append(corners) or box(*corners))
    training = CodeTrainer(context).train(field, (0, 255), "rvq", RateTarget(psnr=40.0))
    assert max(np.prod(np.subtract(corners[1::2], corners[::2])) for corners in read) <= 32**3
    assert len(set(read)) <= 5
    voxels = field.box(0, 128, 0, 96, 0, 160)
    blocks = blocks_of(voxels, 16)
    decoded = decode_blocks(CodeTrainer(context).encoder(training).encode(blocks), 16, training.codebooks)
    error = np.mean((decoded.astype(float) - blocks) ** 2)
    assert 10 * math.log10(255**2 / error) > 37


def test_more_voxels_than_32_bits_count(context, monkeypatch):
    """2^33 voxels, of which a few regions are read, beyond the first 2^32, too."""
    monkeypatch.setattr(trainer_module, "MOST_VOXELS", 1 << 18)
    field = FieldSource("marschner-lobb", (4096, 2048, 1024))
    read = []
    box = field.box
    monkeypatch.setattr(field, "box", lambda *corners: read.append(corners) or box(*corners))
    training = CodeTrainer(context).train(field, (0, 255), "rvq", RateTarget(bits_per_voxel=0.5))
    first = [z * 4096 * 2048 + y * 4096 + x for z, _, y, _, x, _ in read]
    assert max(first) > 2**32 and min(first) < 2**31 and len(set(read)) <= 10
    assert training.codebooks.stages > 0
    voxels = box(1000, 1024, 2000, 2048, 4064, 4096)
    blocks = blocks_of(voxels, 16)
    decoded = decode_blocks(CodeTrainer(context).encoder(training).encode(blocks), 16, training.codebooks)
    assert np.abs(decoded.astype(float) - blocks).max() <= 255


def test_progress_rises_to_its_end(context):
    seen = []
    voxels = as_type(smooth((64, 64, 64)), np.uint8)
    trainer = CodeTrainer(context)
    trainer.train(VolumeSource(Volume(voxels)), range_of(voxels), "rvq", RateTarget(psnr=40.0),
                  progress=lambda done, total: seen.append((done, total)))  # fmt: skip
    assert seen == sorted(seen) and seen[-1][0] == seen[-1][1]


def test_voxels_beyond_the_range_stay_what_they_were(context):
    voxels = as_type(smooth(), np.int16)
    training = CodeTrainer(context).train(VolumeSource(Volume(voxels)), (-9000, 12000), "rvq", RateTarget(psnr=50.0))
    blocks = blocks_of(voxels, 16)
    decoded = decode_blocks(CodeTrainer(context).encoder(training).encode(blocks), 16, training.codebooks)
    beyond = (blocks < -9000) | (blocks > 12000)
    assert np.array_equal(decoded[beyond], blocks[beyond])
