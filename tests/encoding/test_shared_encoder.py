"""Blocks that devices share have the bytes that one device gives them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.encoding import as_type, blocks_of, smooth

from clvol.encoding import shared
from clvol.encoding.shared import SharedTrainer
from clvol.encoding.trainer import CodeTrainer
from clvol.errors import ClvolWarning, RenderError
from clvol.opencl.context import DeviceContext
from clvol.store.codecs.coded_blocks import RateTarget
from clvol.store.voxel_source import VolumeSource
from clvol.volume import Volume

NAMES = ["a", "b", "c"]


@pytest.fixture
def trainers(device):
    contexts = [DeviceContext(device) for _ in NAMES]
    yield [CodeTrainer(context) for context in contexts]
    for context in contexts:
        context.release()


@pytest.fixture(scope="module")
def voxels():
    return as_type(smooth(), np.uint8)


def train(trainer, voxels, codec):
    source = VolumeSource(Volume(voxels), {})
    low, high = float(voxels.min()), float(voxels.max())
    return trainer.train(source, (low, high), codec, RateTarget(psnr=42.0) if codec == "rvq" else RateTarget())


def assert_same(found, expected) -> None:
    for name in ("data", "start", "size"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("codec", ["rvq", "vq-mean"])
@pytest.mark.parametrize("edge", [4, 8, 16])
def test_devices_give_the_bytes_of_one(trainers, voxels, monkeypatch, codec, edge):
    monkeypatch.setattr(shared, "_LEAST", 1 << 12)
    training = train(trainers[0], voxels, codec)
    blocks = blocks_of(voxels, edge)
    together = SharedTrainer(trainers, NAMES)
    encoder = together.encoder(training)
    for part in (blocks, blocks[:1], blocks[:0]):
        assert_same(encoder.encode(part), trainers[0].encoder(training).encode(part))
    together.close()


def failing(monkeypatch, encoder) -> None:
    def encode(samples):
        raise RenderError("device", "failed (OUT_OF_RESOURCES)")

    monkeypatch.setattr(encoder, "encode", encode)


def test_a_device_that_fails_is_left_out(trainers, voxels, monkeypatch):
    monkeypatch.setattr(shared, "_LEAST", 1 << 12)
    training, blocks = train(trainers[0], voxels, "rvq"), blocks_of(voxels, 8)
    together = SharedTrainer(trainers, NAMES)
    encoder = together.encoder(training)
    failing(monkeypatch, encoder._encoders[1])
    with pytest.warns(ClvolWarning, match="device b: failed and is left out"):
        found = encoder.encode(blocks)
    assert_same(found, trainers[0].encoder(training).encode(blocks))
    for other in encoder._encoders:
        failing(monkeypatch, other)
    with pytest.raises(RenderError, match="OUT_OF_RESOURCES"):
        encoder.encode(blocks)
    together.close()


def test_another_device_trains_if_the_first_fails(trainers, voxels, monkeypatch):
    expected = train(trainers[0], voxels, "rvq")

    def broken(*arguments):
        raise RenderError("device", "failed (OUT_OF_RESOURCES)")

    monkeypatch.setattr(trainers[0], "train", broken)
    together = SharedTrainer(trainers, NAMES)
    with pytest.warns(ClvolWarning, match="device a: failed.*b and c did its work"):
        found = train(together, voxels, "rvq")
    np.testing.assert_array_equal(found.codebooks.entries, expected.codebooks.entries)
    assert found.policy == expected.policy
