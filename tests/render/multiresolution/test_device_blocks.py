"""What is on a device is what the source holds, block by block, whatever was there before."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from clvol.errors import DeviceError, RenderError, SceneError, VolumeError
from clvol.integrators.multiresolution import device_blocks
from clvol.integrators.multiresolution.device_blocks import (
    CODE_DROPPED,
    CODE_ONE,
    DeviceBlocks,
    corner_codes,
    corner_codes_at,
    corners_of,
)
from clvol.integrators.multiresolution.sample_allocator import SPARE_BYTES, overhead_bytes
from clvol.store.source import DROPPED
from clvol.store.volume_blocks import VolumeBlocks
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
    return _budget(source, SPARE_BYTES * 4 + samples * size)


def _budget(source: VolumeBlocks, sample_bytes: int) -> int:
    """The budget that leaves ``sample_bytes`` to samples: the map of empty space grows with it."""
    memory = 0
    while memory != (memory := sample_bytes + overhead_bytes(source.blocks, memory)):
        pass
    return memory


def _held(blocks: DeviceBlocks, source: VolumeBlocks, values: np.ndarray) -> np.ndarray:
    """``values`` of the source as the device should hold them."""
    if source.dtype == np.float64:
        return blocks.value_map(values).astype(np.float32)
    return values


def _check(blocks: DeviceBlocks, source: VolumeBlocks, means: np.ndarray) -> np.ndarray:
    """Index, corners and samples against the source, read in their own way; returns the levels."""
    context = blocks._context
    source = getattr(source, "inner", source)
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


def test_extreme_floats_are_held_as_they_are_and_their_means_scaled(context):
    data = np.random.default_rng(2).uniform(1e29, 1e30, (9, 9, 9)).astype(np.float32)
    source = VolumeBlocks(Volume(data), 4)
    means, levels = _means(source), _levels(source, 4)
    blocks = DeviceBlocks(context, source, _bytes_for(source, levels))
    blocks.load(levels, means)
    _check(blocks, source, means)
    assert blocks.value_map.gain < 1e-20 and blocks.switches["VOXEL_SCALED"] == 1


def test_a_device_without_double_gets_floats(context, monkeypatch):
    monkeypatch.setattr(context, "has_double", False)
    source = VolumeBlocks(_volume("float64"), 8)
    means, levels = _means(source), _levels(source, 5)
    blocks = DeviceBlocks(context, source, _bytes_for(source, levels))
    blocks.load(levels, means)
    _check(blocks, source, means)


def test_samples_of_several_buffers(context):
    source = VolumeBlocks(_volume("uint16", (40, 40, 40)), 8)
    means, levels = _means(source), np.zeros(source.blocks.count, np.uint8)
    levels[::3], levels[::7] = 1, DROPPED
    largest = 26 * 2 * 8**3 + SPARE_BYTES + 5
    blocks = DeviceBlocks(context, source, _bytes_for(source, levels), largest_buffer=largest)
    assert len(blocks.samples) == blocks.switches["SAMPLE_BUFFERS"] == 3
    assert all(array.nbytes <= largest for array in blocks.samples)
    blocks.load(levels, means)
    _check(blocks, source, means)
    blocks.load(levels[::-1], means)
    np.testing.assert_array_equal(_check(blocks, source, means), levels[::-1])
    used = context.read(blocks.index)[:, 1] >> 4
    assert set(used.tolist()) == {0, 1, 2}


def test_four_buffers_hold_no_more_than_they_can(context):
    source = VolumeBlocks(_volume("uint8", (40, 40, 40)), 8)
    largest = 8**3 * 2 + SPARE_BYTES
    blocks = DeviceBlocks(context, source, 2**24, largest_buffer=largest)
    assert len(blocks.samples) == 4 and blocks.sample_bytes == 4 * 2 * 8**3


@pytest.mark.parametrize("dtype", _TYPES)
def test_switches_are_those_of_what_is_held(context, dtype):
    source = VolumeBlocks(_volume(dtype), 8)
    switches = DeviceBlocks(context, source, 2**22).switches
    held = np.dtype("float32") if dtype == "float64" else np.dtype(dtype)
    assert switches == {
        "VOXEL_BITS": 8 * held.itemsize,
        "VOXEL_SIGNED": int(held.kind == "i"),
        "VOXEL_SCALED": 0,
        "VOXEL_PAIRS": 0,
        "VOXEL_HOLES": int(held.kind == "f"),
        "SAMPLE_BUFFERS": 1,
    }


def test_blocks_of_one_sample_and_dropped_ones_take_no_samples(context):
    source = VolumeBlocks(_volume("int16"), 8)
    means = _means(source)
    levels = np.where(np.arange(source.blocks.count) % 2, DROPPED, 3)
    blocks = DeviceBlocks(context, source, _budget(source, SPARE_BYTES))
    blocks.load(levels, means)
    np.testing.assert_array_equal(_check(blocks, source, means), levels)
    assert blocks.used_bytes == blocks.sample_bytes == 0


def test_before_a_load_all_is_dropped(context):
    source = VolumeBlocks(_volume("uint8"), 8)
    blocks = DeviceBlocks(context, source, 2**20)
    assert (_check(blocks, source, np.zeros(source.blocks.count)) == DROPPED).all()
    assert not blocks.commit() and not blocks.pending


def test_no_more_is_allocated_than_full_resolution_needs(context):
    source = VolumeBlocks(_volume("uint8"), 8)
    blocks = DeviceBlocks(context, source, 2**30)
    assert blocks.sample_bytes == source.blocks.count * 8**3
    overhead = overhead_bytes(source.blocks, blocks.memory_bytes)
    assert blocks.device_bytes <= overhead + blocks.sample_bytes + SPARE_BYTES


def test_corners_of_some_slabs_are_those_of_all():
    codes = np.random.default_rng(3).integers(1, 16, (5, 3, 4)).astype(np.uint32)
    whole = corner_codes(codes, 0, 5)
    _check_corners(whole, codes)
    for first in range(5):
        for last in range(first + 1, 6):
            part = corner_codes(codes, first, last)
            np.testing.assert_array_equal(part, whole[first : last + 1])


@pytest.mark.parametrize("shape", ((5, 3, 4), (1, 1, 1), (1, 6, 2)))
def test_corners_of_some_blocks_are_all_that_change_with_them(shape):
    random = np.random.default_rng(4)
    before = random.integers(1, 16, shape).astype(np.uint8)
    after = before.copy()
    changed = np.unique(random.integers(0, before.size, 3))
    after.ravel()[changed] = after.ravel()[changed] % 15 + 1
    whole, expected = corner_codes(before, 0, shape[0]), corner_codes(after, 0, shape[0])
    corners = corners_of(np.argwhere(before != after), shape)
    assert len(corners) < expected.size or before.size <= 3
    whole[tuple(corners.T)] = corner_codes_at(after, corners)
    np.testing.assert_array_equal(whole, expected)


def test_a_few_changes_write_a_few_words_of_the_index(context, monkeypatch):
    spy = _spy("uint8", (70, 70, 70))
    means, levels = _means(spy), _levels(spy, 8)
    blocks = DeviceBlocks(context, spy, 2**20)
    blocks.load(levels, means)
    written, write = [], context.write
    monkeypatch.setattr(
        context, "write", lambda to, values, *at: (written.append(to), write(to, values, *at))
    )
    levels[[0, 300, 728]] = 0, DROPPED, 3
    blocks.load(levels, means)
    assert written and not {id(blocks.index), id(blocks.corners)} & {*map(id, written)}
    np.testing.assert_array_equal(_check(blocks, spy, means), levels)
    many = _levels(spy, 9)
    blocks.load(many, means)
    assert {id(blocks.index), id(blocks.corners)} <= {*map(id, written)}
    np.testing.assert_array_equal(_check(blocks, spy, means), many)


# What cannot be asked for


def test_a_budget_below_the_index_says_what_is_needed(context):
    source = VolumeBlocks(_volume("uint8"), 8)
    needed = _budget(source, SPARE_BYTES)
    with pytest.raises(SceneError, match=f"memory.*at least {needed} bytes"):
        DeviceBlocks(context, source, needed - 1)
    DeviceBlocks(context, source, needed)


def test_a_buffer_too_small_for_a_block_is_refused(context):
    source = VolumeBlocks(_volume("uint16"), 8)
    with pytest.raises(DeviceError, match="largest buffer"):
        DeviceBlocks(context, source, 2**20, largest_buffer=8**3 * 2 + SPARE_BYTES - 1)


def test_levels_that_do_not_fit_are_refused_and_nothing_changes(context):
    source = VolumeBlocks(_volume("uint8"), 8)
    means, levels = _means(source), _levels(source, 6)
    blocks = DeviceBlocks(context, source, _bytes_for(source, levels))
    blocks.load(levels, means)
    with pytest.raises(RenderError, match="at most"):
        blocks.load(np.zeros_like(levels), means)
    unknown = np.full(levels.shape, source.blocks.levels)
    for wrong in (levels[1:], unknown, unknown - 100):
        with pytest.raises(RenderError, match="levels of blocks"):
            blocks.start(wrong, means)
    np.testing.assert_array_equal(_check(blocks, source, means), levels)


# Changes


class _Spy:
    """A source that notes what is read, waits where it is told to, and fails at one block."""

    def __init__(self, source: VolumeBlocks) -> None:
        self.inner = source
        self.asked: list[tuple[int, np.ndarray]] = []
        self.tickets: threading.Semaphore | None = None  # reads that may go on
        self.corrupt: int | None = None

    def __getattr__(self, name: str):
        return getattr(self.inner, name)

    def read(self, level: int, blocks: np.ndarray) -> np.ndarray:
        if self.tickets is not None:
            assert self.tickets.acquire(timeout=20)
        if self.corrupt is not None and self.corrupt in blocks:
            raise VolumeError("some.zarr", f"block {self.corrupt} is corrupt", "its checksum")
        self.asked.append((level, blocks.copy()))
        return self.inner.read(level, blocks)

    def blocks_read(self) -> list[int]:
        return sorted(int(b) for _, blocks in self.asked for b in blocks)


def _spy(dtype: str = "uint8", shape: tuple[int, int, int] = (40, 33, 26)) -> _Spy:
    return _Spy(VolumeBlocks(_volume(dtype, shape), 8))


def _steps(blocks: DeviceBlocks, spy: _Spy):
    """Lets one read after another go on, and commits each; stops when all is there."""
    while blocks.pending:
        spy.tickets.release()
        blocks._loader.wait()
        yield blocks.commit()


def test_a_change_reads_the_changed_blocks_alone(context):
    spy = _spy()
    means, levels = _means(spy), _levels(spy, 7)
    blocks = DeviceBlocks(context, spy, 2**20)
    blocks.load(levels, means)
    spy.asked.clear()
    changed = levels.copy()
    changed[5:9], changed[20], changed[30] = 0, DROPPED, 3
    blocks.start(changed, means)
    assert blocks.wait()
    wanted = [k for k in range(5, 9) if levels[k] != 0]
    assert spy.blocks_read() == wanted
    np.testing.assert_array_equal(_check(blocks, spy, means), changed)
    blocks.start(changed, means)
    assert not blocks.pending and not blocks.wait()


def _shuffled(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Both states fill the same memory to the last sample."""
    random = np.random.default_rng(6)
    old = np.where(random.random(count) < 0.1, DROPPED, random.integers(0, 4, count))
    return old, random.permutation(old)


def _scattered(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Of eight blocks of 4^3 in the place of one of 8^3 a single one stays, and as many of the
    others grow as there is memory for: it is nowhere in one piece."""
    old = np.ones(count, int)
    new = np.where(np.arange(count) % 8, 3, 1)
    grows = np.flatnonzero(new == 3)[: (count * 64 - 64 * np.count_nonzero(new == 1)) // 512]
    new[grows] = 0
    return old, new


@pytest.mark.parametrize("buffers", (1, 3))
@pytest.mark.parametrize("states", (_shuffled, _scattered))
def test_every_frame_of_a_change_in_full_memory_is_a_mixture_of_old_and_new(
    context, states, buffers, monkeypatch
):
    spy = _spy("uint16")
    means = _means(spy)
    old, new = states(spy.blocks.count)
    memory = _bytes_for(spy, old)
    largest = None if buffers == 1 else -(-(memory - overhead_bytes(spy.blocks, memory)) // 2048) * 1024
    blocks = DeviceBlocks(context, spy, memory, largest_buffer=largest)
    assert (len(blocks.samples) > 1) == (buffers > 1)
    blocks.load(old, means)
    allocated = blocks.device_bytes
    copies, copy = [], context.copy
    monkeypatch.setattr(context, "copy", lambda *given: (copies.append(given), copy(*given)))
    spy.tickets = threading.Semaphore(0)
    blocks.start(new, means)
    one = spy.blocks.levels - 1
    frames = 0
    for _ in _steps(blocks, spy):
        found = _check(blocks, spy, means)
        valid = (found == old) | (found == new) | ((old == DROPPED) & (found == one))
        assert valid.all()
        assert blocks.used_bytes <= blocks.sample_bytes
        assert blocks.device_bytes == allocated <= memory
        frames += 1
    assert frames > 1
    assert copies or states is not _scattered
    np.testing.assert_array_equal(blocks.levels, new)
    assert blocks.used_bytes == sum(2 * 8 ** (3 - int(k)) for k in new if k < 3)


def test_what_shrinks_comes_first_and_then_the_largest_error(context, monkeypatch):
    spy = _spy()
    means, count = _means(spy), spy.blocks.count
    window = 4  # blocks
    monkeypatch.setattr(device_blocks, "_WINDOW_BYTES", window * 8**3)
    odd = np.arange(count) % 2 == 1
    old, new = np.where(odd, 0, 2), np.where(odd, 2, 0)
    priority = np.random.default_rng(5).permutation(count).astype(float)
    blocks = DeviceBlocks(context, spy, 2**20)
    blocks.load(old, means)
    spy.asked.clear()
    blocks.start(new, means, priority)
    blocks.wait()
    levels_read = [level for level, _ in spy.asked]
    assert levels_read == sorted(levels_read, reverse=True)
    grown = [b for level, part in spy.asked if level == 0 for b in part.tolist()]
    expected = np.flatnonzero(~odd)[np.argsort(-priority[~odd])]
    for at in range(0, len(expected), window):
        assert set(grown[at : at + window]) == set(expected[at : at + window].tolist())


def test_a_new_goal_replaces_the_old_one_and_keeps_what_has_come(context):
    spy = _spy()
    means, count = _means(spy), spy.blocks.count
    blocks = DeviceBlocks(context, spy, 2**20)
    blocks.load(np.full(count, 2), means)
    spy.asked.clear()
    spy.tickets = threading.Semaphore(0)
    blocks.start(np.zeros(count), means)
    steps = _steps(blocks, spy)
    next(steps), next(steps)
    kept = np.flatnonzero(blocks.levels == 0)
    assert 0 < len(kept) < count
    spy.asked.clear()
    goal = np.where(np.arange(count) < count // 2, 0, 1)
    blocks.start(goal, means)
    for _ in range(2 * count):
        spy.tickets.release()
    blocks.wait()
    np.testing.assert_array_equal(_check(blocks, spy, means), goal)
    again = [b for level, part in spy.asked[1:] for b in part.tolist() if level == 0]
    assert not set(kept[kept < count // 2].tolist()) & set(again)


def test_a_change_gives_what_a_fresh_load_does(context):
    spy = _spy("float32")
    means, first, second = _means(spy), _levels(spy, 21), _levels(spy, 22)
    memory = max(_bytes_for(spy, first), _bytes_for(spy, second))
    changed, fresh = (DeviceBlocks(context, spy, memory) for _ in range(2))
    changed.load(first, means)
    changed.start(second, means)
    changed.wait()
    fresh.load(second, means)
    for blocks in (changed, fresh):
        np.testing.assert_array_equal(_check(blocks, spy, means), second)
    np.testing.assert_array_equal(context.read(changed.corners), context.read(fresh.corners))


def test_a_block_that_appears_shows_its_mean_until_it_is_read(context):
    spy = _spy()
    means, count = _means(spy), spy.blocks.count
    blocks = DeviceBlocks(context, spy, 2**20)
    spy.tickets = threading.Semaphore(0)
    blocks.start(np.zeros(count), means)
    assert blocks.commit() and not blocks.commit()
    assert (_check(blocks, spy, means) == spy.blocks.levels - 1).all()
    spy.tickets.release(1000)
    blocks.close()
    assert not blocks.pending


@pytest.mark.parametrize("seed", range(3))
def test_goals_that_replace_each_other_at_any_moment_end_in_the_last(context, seed):
    """Asked anew before, while and after a goal is reached; memory is no more than needed."""
    random = np.random.default_rng(seed)
    spy = _spy("int8")
    means, goals = _means(spy), [_levels(spy, 100 * seed + k) for k in range(12)]
    blocks = DeviceBlocks(context, spy, max(_bytes_for(spy, goal) for goal in goals))
    for goal in goals:
        blocks.start(goal, means, random.random(len(goal)))
        for _ in range(random.integers(1, 4)):
            time.sleep(random.choice([0.0, 0.001]))
            blocks.commit()
            assert blocks.used_bytes <= blocks.sample_bytes
        _check(blocks, spy, means)
    blocks.wait()
    np.testing.assert_array_equal(_check(blocks, spy, means), goals[-1])
    blocks.close()


# Errors and threads


def _threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "clvol-blocks"]


@pytest.fixture
def no_threads_left():
    before = set(_threads())
    yield
    for thread in set(_threads()) - before:
        thread.join(5.0)
        assert not thread.is_alive()


@pytest.mark.parametrize("asked", ("load", "start"))
def test_a_corrupt_block_is_named_and_what_is_there_stays(context, asked, no_threads_left):
    spy = _spy()
    means, count = _means(spy), spy.blocks.count
    levels = np.full(count, 2)
    blocks = DeviceBlocks(context, spy, 2**20)
    blocks.load(levels, means)
    spy.corrupt = 17
    with pytest.raises(VolumeError, match="block 17 is corrupt"):
        if asked == "load":
            blocks.load(np.zeros(count), means)
        else:
            blocks.start(np.zeros(count), means)
            blocks.wait()
    assert not blocks.pending
    found = _check(blocks, spy, means)
    assert found[17] == 2 and np.isin(found, (0, 2)).all()
    spy.corrupt = None
    blocks.load(np.zeros(count), means)
    assert (_check(blocks, spy, means) == 0).all()


def test_an_error_surfaces_at_a_commit_after_what_came_before_it(context, no_threads_left):
    spy = _spy()
    means, count = _means(spy), spy.blocks.count
    blocks = DeviceBlocks(context, spy, 2**20)
    spy.corrupt = count - 1
    blocks.start(np.zeros(count), means)
    with pytest.raises(VolumeError, match=f"block {count - 1} is corrupt"):
        while blocks.pending:
            blocks._loader.wait()
            blocks.commit()
    assert np.count_nonzero(_check(blocks, spy, means) == 0) > count // 2
    assert blocks.commit() and not blocks.commit()


def test_close_ends_a_thread_that_waits_to_be_heard(context, no_threads_left):
    spy = _spy()
    blocks = DeviceBlocks(context, spy, 2**20)
    blocks.start(np.zeros(spy.blocks.count), _means(spy))
    blocks.close()
    assert not _threads() or not any(thread.is_alive() for thread in _threads())


def test_dropping_the_blocks_ends_the_thread(context, no_threads_left):
    spy = _spy()
    blocks = DeviceBlocks(context, spy, 2**20)
    blocks.start(np.zeros(spy.blocks.count), _means(spy))
    del blocks
