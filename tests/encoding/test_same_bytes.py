"""The same bytes from every device and from the numpy twin (tests/reference/encode_codes.py)."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.encoding import CODECS, TYPES, as_type, blocks_of, by_hand, smooth, trained
from reference.encode_codes import encoded_block

from clvol.encoding.policy import Policy
from clvol.encoding.trainer import CodeTrainer

TARGETS = ({"psnr": 42.0}, {"bits_per_voxel": 2.0}, {"max_voxel_error": 0.004}, {"max_voxel_error": 0.0}, {})


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("target", TARGETS, ids=lambda t: next(iter(t), "none"))
def test_the_twin_makes_the_same_bytes(context, codec, dtype, target):
    voxels = as_type(smooth(), dtype)
    if voxels.dtype.kind == "f":
        voxels[2:5, 7, 9] = np.nan, np.inf, -np.inf
    if "bits_per_voxel" in target and codec != "rvq":  # which blocks with NaN, and codebooks, exceed
        target = {"bits_per_voxel": 12.0}
    training, encoder = trained(context, voxels, codec, **target)
    for edge in (4, 8, 16):
        blocks = blocks_of(voxels, edge)[::7][:6]
        coded = encoder.encode(blocks)
        for k, block in enumerate(blocks):
            mine = bytes(coded.data[coded.start[k] : coded.start[k] + coded.size[k]])
            assert mine == encoded_block(block, training), (edge, k)


POLICIES = (Policy(1), Policy(300), Policy(40000), Policy(1 << 20), Policy(bound=0), Policy(bound=2), Policy(bound=300),
            Policy(900, beam=4), Policy(bound=3, beam=2), Policy(bound=250, beam=4))  # fmt: skip


@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("policy", POLICIES, ids=str)
def test_the_twin_chooses_the_same_of_many_stages(context, dtype, policy):
    voxels = as_type(smooth(), dtype)
    training = by_hand(voxels, policy, 7)
    encoder = CodeTrainer(context).encoder(training)
    for edge in (4, 8, 16):
        blocks = blocks_of(voxels, edge)[::5][:5]
        coded = encoder.encode(blocks)
        for k, block in enumerate(blocks):
            mine = bytes(coded.data[coded.start[k] : coded.start[k] + coded.size[k]])
            assert mine == encoded_block(block, training), (edge, k)


@pytest.mark.parametrize("target", TARGETS[:3], ids=lambda t: next(iter(t)))
def test_weights_are_those_of_the_twin(context, target):
    voxels = as_type(smooth(), np.uint8)
    training, encoder = trained(context, voxels, "rvq", **target)
    blocks = blocks_of(voxels, 16)[:5]
    weights = np.array([1.0, 0.25, 4.0, 0.01, 9.0])
    coded = encoder.encode(blocks, weights)
    for k, block in enumerate(blocks):
        mine = bytes(coded.data[coded.start[k] : coded.start[k] + coded.size[k]])
        assert mine == encoded_block(block, training, float(weights[k])), k


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.every_case
def test_another_device_makes_the_same_training_and_bytes(context, contexts, other_device, codec):
    voxels = as_type(smooth((64, 72, 80)), np.uint16)
    for target in ({"psnr": 48.0}, {"max_voxel_error": 0.01}):
        one, encoder = trained(context, voxels, codec, **target)
        other, again = trained(contexts(other_device), voxels, codec, **target)
        assert one.policy == other.policy
        assert np.array_equal(one.codebooks.entries, other.codebooks.entries)
        assert np.array_equal(one.codebooks.shifts, other.codebooks.shifts)
        blocks = blocks_of(voxels, 16)
        assert np.array_equal(encoder.encode(blocks).data, again.encode(blocks).data)
