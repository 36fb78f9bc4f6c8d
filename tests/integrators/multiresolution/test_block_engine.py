"""Frames while another transfer function's blocks are still being read, and once all are there."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from helpers.block_scenes import SHOWN, block_scene, noise
from reference.multiresolution import BlockField, render_blocks_twin

from clvol import Camera, TransferFunction, Volume
from clvol.integrators.multiresolution import residency
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.store.source import DROPPED
from clvol.store.volume_blocks import VolumeBlocks

SHAPE = (48, 40, 64)
CAMERA = Camera(position=(-55.0, -38.0, -61.0), target=(32.0, 20.0, 24.0), fov_degrees=32.0)
OTHER = TransferFunction(
    [0.0, 150.0, 255.0], [0.0, 0.0, 0.6], [[1.0, 0.3, 0.1], [0.9, 0.9, 0.1], [1.0, 1.0, 1.0]]
)


class Gate:
    """A source of which blocks come one reading at a time, as they are let through."""

    def __init__(self, inner: VolumeBlocks) -> None:
        self._inner, self._open = inner, threading.Semaphore(0)
        self.is_open = True

    def __getattr__(self, name: str):
        return getattr(self._inner, name)

    def let_through(self, count: int) -> None:
        self._open.release(count)

    def read(self, level, blocks):
        if not self.is_open:
            assert self._open.acquire(timeout=300)
        return self._inner.read(level, blocks)


@pytest.fixture
def gated(monkeypatch):
    """``gated(volume)``: its source, which engines made afterwards read."""

    def make(volume: Volume) -> Gate:
        gate = Gate(VolumeBlocks(volume))
        monkeypatch.setattr(residency, "block_source", lambda volume: gate)
        return gate

    return make


def two_halves() -> Volume:
    """Noise in one half, few high voxels in the other: those are what OTHER shows, and only where
    blocks are fine: coarse ones, which SHOWN leaves them, are empty space."""
    data = noise(SHAPE).data // 2
    rare = np.random.default_rng(2).random(SHAPE) < 0.04
    data[:, :, 32:] = np.where(rare, 255, 0)[:, :, 32:]
    return Volume(data)


def tight_scene(volume, function=SHOWN):
    """A budget that holds about a quarter of the volume at full resolution."""
    settings = {"memory": "100 KiB", "stepping": "limited"}
    return block_scene(volume, function, camera=CAMERA, settings=settings, step=0.83)


def frame(engine):
    return engine.render(engine.resolved.camera, 24, 20)


def test_frames_after_another_function_end_in_the_picture_of_a_fresh_engine(context, gated):
    volume = two_halves()
    gate = gated(volume)
    engine = MultiresolutionEngine(context, tight_scene(volume))
    before = frame(engine)
    start = engine.residency.blocks.levels
    gate.is_open = False
    engine.set_transfer_function(OTHER, wait=False)
    resolved = replace(tight_scene(volume), transfer_function=OTHER)
    stages = []
    while not stages or engine.residency.blocks.pending:
        data = frame(engine)
        levels = engine.residency.blocks.levels
        stages.append(levels)
        assert np.isfinite(data.rgba).all() and len(stages) < 2000
        assert data.notes["blocks"]["pending"] == engine.residency.blocks.pending
        assert data.notes["blocks"]["levels"] == [np.count_nonzero(levels == k) for k in range(5)]
        if len(stages) == 1:  # nothing has been read yet
            kept = (levels == start) | (levels == DROPPED) | (levels == 4)
            assert kept.all() and data.notes["blocks"]["pending"] > 0
        gate.let_through(1)
    assert len(stages) > 2 and not np.array_equal(stages[0], stages[-1])
    gate.is_open = True
    last = frame(engine)
    fresh = MultiresolutionEngine(context, replace(resolved))
    expected = frame(fresh)
    np.testing.assert_array_equal(engine.residency.blocks.levels, fresh.residency.blocks.levels)
    np.testing.assert_array_equal(last.rgba, expected.rgba)
    np.testing.assert_array_equal(last.depth, expected.depth)
    assert last.samples == expected.samples
    assert not np.array_equal(last.rgba, before.rgba)


def test_a_frame_in_between_is_right_for_what_is_resident(context, gated):
    volume = two_halves()
    gate = gated(volume)
    engine = MultiresolutionEngine(context, tight_scene(volume))
    frame(engine)
    gate.is_open = False
    engine.set_transfer_function(OTHER, wait=False)
    data = frame(engine)
    assert data.notes["blocks"]["pending"] > 0
    blocks = engine.residency.blocks
    field = BlockField.of(VolumeBlocks(volume), blocks.levels)
    # With no leaps a ray's steps begin at its entry; of full steps leaps change nothing.
    resolved = replace(tight_scene(volume), transfer_function=OTHER)
    full = replace(
        resolved, multiresolution=resolved.multiresolution.model_copy(update={"stepping": "full"})
    )
    limited, twin = render_blocks_twin(resolved, field), render_blocks_twin(full, field)
    wrong = np.abs(limited.rgba - twin.rgba).max(axis=-1)
    assert np.abs(data.rgba - twin.rgba).mean() <= 2 * wrong.mean() + 1e-4
    engine.caster.skip = False
    engine.caster.switches = {**engine.caster.switches, "SKIP_EMPTY": 0}
    walked = frame(engine)
    np.testing.assert_array_equal(blocks.levels, field.levels)
    sure = limited.margin > 2e-4
    assert sure.mean() > 0.8
    assert np.abs(walked.rgba - limited.rgba)[sure].max() < 2e-5
    gate.let_through(1000)
    gate.is_open = True
    frame(engine)


def test_waiting_is_all_at_once(context):
    volume = two_halves()
    engine = MultiresolutionEngine(context, tight_scene(volume))
    first = frame(engine)
    engine.set_transfer_function(OTHER)
    assert engine.residency.blocks.pending == 0
    other = frame(engine)
    fresh = MultiresolutionEngine(context, tight_scene(volume, OTHER))
    np.testing.assert_array_equal(other.rgba, frame(fresh).rgba)
    engine.set_transfer_function(SHOWN)
    np.testing.assert_array_equal(frame(engine).rgba, first.rgba)
