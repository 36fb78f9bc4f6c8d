"""Properties of where blocks lie."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol.errors import DeviceError, SceneError, VolumeError
from clvol.integrators.multiresolution.sample_allocator import (
    SPARE_BYTES,
    Packing,
    buffer_samples,
    map_cells,
    map_shift,
    overhead_bytes,
    sample_dtype,
    staging_bytes,
)
from clvol.store.geometry import BlockGrid


def _check(packing: Packing) -> None:
    """Slots are aligned, inside, and no two overlap; together with the free ones they are all."""
    has = packing.size > 0
    assert (packing.start[~has] == -1).all()
    start, size = packing.start[has], packing.size[has].astype(np.int64)
    assert (start % size == 0).all()
    slots = [*zip(start.tolist(), size.tolist())]
    for free, places in packing._free.items():
        slots += [(place, free) for place in places.tolist()]
    slots.sort()
    ends = [0, *(a + n for a, n in slots)]
    assert [a for a, _ in slots] == ends[:-1] and ends[-1] == packing.capacity
    assert packing.used == size.sum() <= packing.capacity


def _sizes(edge: int) -> list[int]:
    return [0, *(8**k for k in range(1, edge.bit_length()))]


@st.composite
def _changes(draw):
    """An edge, a capacity, and changes of some blocks that always fit."""
    edge = draw(st.sampled_from((4, 8, 16)))
    count = draw(st.integers(1, 40))
    capacity = draw(st.integers(0, 3 * edge**3 + 200))
    change = st.tuples(st.integers(0, count - 1), st.sampled_from(_sizes(edge)))
    steps = draw(st.lists(st.lists(change, max_size=30), max_size=12))
    return edge, count, capacity, steps


@settings(max_examples=150, deadline=None)
@given(_changes())
def test_changes_that_fit_are_always_placed_and_moves_carry_samples_along(changes):
    edge, count, capacity, steps = changes
    packing = Packing(count, edge, capacity)
    memory = np.full(packing.capacity, -1)
    for step in steps:
        wanted = dict(step)
        blocks = np.array(list(wanted), np.int64)
        sizes = np.array([wanted[b] for b in wanted], np.int64)
        others = packing.used - packing.size[blocks].sum()
        fits = np.cumsum(sizes) <= packing.capacity - others
        blocks, sizes = blocks[fits], sizes[fits]
        if packing.used - packing.size[blocks].sum() + sizes.sum() > packing.capacity:
            continue
        before = packing.size.copy()
        for move in packing.place(blocks, sizes):
            assert abs(move.old - move.new) >= move.size
            source = memory[move.old : move.old + move.size]
            memory[move.new : move.new + move.size] = source
        for block, size in zip(blocks, sizes):
            if size:
                memory[packing.start[block] : packing.start[block] + size] = block
        before[blocks] = sizes
        np.testing.assert_array_equal(packing.size, before)
        _check(packing)
        for block in np.flatnonzero(packing.size):
            start = packing.start[block]
            assert (memory[start : start + packing.size[block]] == block).all()


@settings(max_examples=50, deadline=None)
@given(_changes())
def test_everything_merges_again_once_nothing_is_placed(changes):
    edge, count, capacity, steps = changes
    packing, fresh = Packing(count, edge, capacity), Packing(count, edge, capacity)
    for step in steps:
        for block, size in step:
            if packing.used - packing.size[block] + size <= packing.capacity:
                packing.place(np.array([block]), np.array([size]))
    packing.place(np.arange(count), np.zeros(count, int))
    for size, places in fresh._free.items():
        np.testing.assert_array_equal(np.sort(packing._free[size]), places)


def test_what_does_not_fit_is_refused_and_nothing_changes():
    packing = Packing(3, 4, 64 + 8)
    packing.place(np.array([0, 1]), np.array([64, 8]))
    start, size = packing.start.copy(), packing.size.copy()
    with pytest.raises(ValueError, match="80 samples"):
        packing.place(np.array([2]), np.array([8]))
    np.testing.assert_array_equal(packing.start, start)
    np.testing.assert_array_equal(packing.size, size)
    _check(packing)


def test_scattered_free_slots_become_one_by_moving_little():
    """Nine slots of 64 hold seven blocks of 2^3 each, one of them six: a block of 64 fits, but
    nowhere in one piece."""
    packing = Packing(100, 8, 9 * 64)
    packing.place(np.arange(72), np.full(72, 8))
    packing.place(np.arange(0, 72, 8), np.zeros(9, int))
    packing.place(np.array([1]), np.array([0]))
    moves = packing.place(np.array([99]), np.array([64]))
    assert len(moves) == 6
    _check(packing)


def test_an_empty_line_is_filled_without_a_gap_largest_first():
    sizes = np.array([8, 0, 512, 64, 8, 512, 64, 8])
    packing = Packing(len(sizes), 8, 20 * 512)
    assert packing.place(np.arange(len(sizes)), sizes) == []
    order = np.argsort(-sizes, kind="stable")[: np.count_nonzero(sizes)]
    before = np.cumsum(sizes[order]) - sizes[order]
    np.testing.assert_array_equal(packing.start[order], before)


@settings(max_examples=200, deadline=None)
@given(
    st.tuples(*[st.integers(1, 90)] * 3),
    st.sampled_from((4, 8, 16, 32)),
    st.sampled_from(("uint8", "int16", "float32", "float64")),
    st.integers(0, 10**7),
    st.integers(0, 10**6),
)
def test_buffers_stay_within_the_budget_and_hold_whole_blocks(shape, edge, dtype, memory, largest):
    blocks, dtype = BlockGrid(shape, edge), np.dtype(dtype)
    size = sample_dtype(dtype).itemsize
    try:
        samples = buffer_samples(blocks, dtype, memory, largest)
    except SceneError:
        assert memory < overhead_bytes(blocks, memory) + SPARE_BYTES
        return
    except DeviceError:
        assert largest < edge**3 * size + SPARE_BYTES
        return
    assert 1 <= len(samples) <= 4
    needed = sum(n * size + SPARE_BYTES for n in samples)
    assert overhead_bytes(blocks, memory) + needed <= memory
    assert all(n * size + SPARE_BYTES <= largest for n in samples)
    assert all(n == samples[0] and n % edge**3 == 0 for n in samples[:-1])
    left = memory - overhead_bytes(blocks, memory) - SPARE_BYTES * 4
    most = min(left // size, blocks.count * edge**3, 4 * ((largest - SPARE_BYTES) // size))
    # Nothing worth mentioning is left unused: below the budget by a slot, or by what a buffer has
    # beyond whole blocks.
    assert sum(samples) >= most - 4 * edge**3


@pytest.mark.parametrize("left, cell", [(0, 16), (2**15, 16), (2**16, 8), (2**20, 4), (2**40, 4)])
def test_overhead_covers_every_part(left, cell):
    blocks = BlockGrid((100, 60, 50), 16)
    index, corners, cells = 8 * 7 * 4 * 4, 4 * 8 * 5 * 5, 7 * 4 * 4 * (16 // cell) ** 3
    others = index + corners + sum(staging_bytes(blocks))
    memory = others + SPARE_BYTES + left
    assert 1 << map_shift(blocks, memory) == cell
    assert overhead_bytes(blocks, memory) == others + 3 * cells


@settings(deadline=None)
@given(
    st.tuples(*[st.integers(1, 300)] * 3), st.sampled_from((4, 8, 16, 32)), st.integers(0, 10**9)
)
def test_the_map_of_empty_space_is_as_fine_as_a_sixteenth_of_what_is_left_allows(
    shape, edge, memory
):
    blocks = BlockGrid(shape, edge)
    shift = map_shift(blocks, memory)
    assert min(4, edge) <= 1 << shift <= edge
    cells = map_cells(blocks, shift)
    left = memory - (overhead_bytes(blocks, memory) - 3 * cells) - SPARE_BYTES
    assert 48 * cells <= left or 1 << shift == edge
    assert 1 << shift == min(4, edge) or 48 * map_cells(blocks, shift - 1) > left


@settings(deadline=None)
@given(st.tuples(*[st.integers(1, 300)] * 3), st.sampled_from((4, 8, 16, 32)))
def test_staging_holds_a_block_of_the_widest_type(shape, edge):
    samples, payloads = staging_bytes(BlockGrid(shape, edge))
    assert 8 * edge**3 <= samples <= 2**20 and payloads >= 16


def test_more_blocks_along_an_axis_than_kernels_can_name_are_refused():
    with pytest.raises(VolumeError, match="1025 blocks of 4 voxels.*at most 1024"):
        buffer_samples(BlockGrid((4, 4, 4097), 4), np.dtype(np.uint8), 2**30, 2**30)
    assert buffer_samples(BlockGrid((4, 4, 4096), 4), np.dtype(np.uint8), 2**30, 2**30)
