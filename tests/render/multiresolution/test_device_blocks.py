"""What is on a device is what the source holds, block by block, whatever was there before."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from clvol.errors import DeviceError, RenderError, SceneError, VolumeError
from clvol.render.multiresolution.device_blocks import CODE_DROPPED, CODE_ONE, DeviceBlocks, corner_codes
from clvol.render.multiresolution.packing import SPARE_BYTES, overhead_bytes
from clvol.store.source import DROPPED, VolumeBlocks
from clvol.volume import Volume

_TYPES = ("uint8", "int8", "uint16", "int16", "float32", "float64")
_SHAPE = (19, 34, 27)


def _volume(dtype: str, shape: tuple[int, int, int] = _SHAPE, seed: int = 1) -> Volume:
    """Noise over the type's whole range, with a constant corner and, in floats, holes."""
    random = np.random.default_rng(seed)
    if dtype.startswith("float"):
        data = (1e3 + random.normal(size=shape)).astype(dtype)
        data[random.random(shape) < 0.02] = np.nan
        data[-4:, -5:, -6:] = np.nan
    else:
        limits = np.iinfo(dtype)
        data = random.integers(limits.min, limits.max + 1, shape).astype(dtype)
    data[:8, :16, :16] = 3
    return Volume(data)


def _means(source: VolumeBlocks) -> np.ndarray:
    return np.concatenate([part.mean[-1] for part in source.statistics()])


def _levels(source: VolumeBlocks, seed: int, dropped: float = 0.2) -> np.ndarray:
    random = np.random.default_rng(seed)
    levels = random.integers(0, source.blocks.levels, source.blocks.count).astype(np.uint8)
    return np.where(random.random(levels.shape) < dropped, DROPPED, levels).astype(np.uint8)


def _bytes_for(source: VolumeBlocks, levels: np.ndarray) -> int:
    """A budget in which exactly these levels fit."""
    edge = source.blocks.edge
    samples = sum((edge >> int(k)) ** 3 for k in levels if k != DROPPED and edge >> int(k) > 1)
    size = min(source.dtype.itemsize, 4)
    return overhead_bytes(source.blocks) + SPARE_BYTES * 4 + samples * size


def _held(blocks: DeviceBlocks, source: VolumeBlocks, values: np.ndarray) -> np.ndarray:
    """``values`` of the source as the device should hold them."""
    if source.dtype == np.float64:
        return blocks.value_map(values).astype(np.float32)
    return values


def _check(blocks: DeviceBlocks, source: VolumeBlocks, means: np.ndarray) -> np.ndarray:
    """Index, corners and samples against the source, by a reading of their own; returns the levels found."""
    context = blocks._context
    index, corners = context.read(blocks.index), context.read(blocks.corners)
    samples = [context.read(array) for array in blocks.samples]
    owned = [np.zeros(len(array), bool) for array in samples]
    codes = index[:, 1] & 15
    found = np.full(len(index), DROPPED, np.uint8)
    ones = blocks.value_map(means).astype(np.float32)
    for k, (word, code) in enumerate(zip(index[:, 0], codes)):
        if code in (CODE_ONE, CODE_DROPPED):
            np.testing.assert_array_equal(word.view(np.float32), ones[k])
            found[k] = source.blocks.levels - 1 if code == CODE_ONE else DROPPED
            continue
        side = 1 << (code - 1)
        found[k] = source.blocks.levels - code
        buffer = index[k, 1] >> 4 & 3
        assert word % side**3 == 0
        place = slice(word, word + side**3)
        assert word + side**3 <= len(samples[buffer]) - SPARE_BYTES // samples[buffer].itemsize
        assert not owned[buffer][place].any()
        owned[buffer][place] = True
        expected = _held(blocks, source, source.read(int(found[k]), np.array([k]))[0])
        np.testing.assert_array_equal(samples[buffer][place].reshape((side,) * 3), expected)
    _check_corners(corners, codes.reshape(source.blocks.counts))
    np.testing.assert_array_equal(found, blocks.levels)
    assert (index[:, 1] >> 6 == 0).all()
    return found


def _check_corners(corners: np.ndarray, codes: np.ndarray) -> None:
    assert corners.shape == tuple(n + 1 for n in codes.shape)
    for place in np.ndindex(corners.shape):
        for j in range(8):
            delta = (j >> 2, j >> 1 & 1, j & 1)
            block = tuple(
                min(max(p - 1 + d, 0), n - 1) for p, d, n in zip(place, delta, codes.shape)
            )
            assert int(corners[place]) >> 4 * j & 15 == codes[block]


@pytest.mark.parametrize("edge", (4, 8, 16))
@pytest.mark.parametrize("dtype", _TYPES)
def test_a_load_holds_what_the_source_has(context, dtype, edge):
    source = VolumeBlocks(_volume(dtype, (9, 14, 11) if edge == 4 else _SHAPE), edge)
    means, levels = _means(source), _levels(source, 3)
    blocks = DeviceBlocks(context, source, _bytes_for(source, levels))
    blocks.load(levels, means)
    np.testing.assert_array_equal(_check(blocks, source, means), levels)
    blocks.close()
