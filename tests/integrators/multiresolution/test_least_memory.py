"""What a message says is the least memory is enough, and nothing less is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol.errors import SceneError
from clvol.integrators.multiresolution.sample_allocator import buffer_samples, most_bytes, overhead_bytes
from clvol.store.geometry import BlockGrid

_shapes = st.tuples(*[st.integers(1, 700)] * 3)
_edges = st.sampled_from((4, 8, 16, 32))
_LARGE = 2**34


def _samples(blocks: BlockGrid, memory: int, dtype=np.uint8) -> int:
    return sum(buffer_samples(blocks, np.dtype(dtype), memory, _LARGE))


@settings(max_examples=300, deadline=None)
@given(_shapes, _edges, st.integers(0, 10**5))
def test_the_least_memory_that_is_named_is_enough_and_one_byte_less_is_not(shape, edge, memory):
    blocks = BlockGrid(shape, edge)
    try:
        _samples(blocks, memory)
        return
    except SceneError as error:
        least = int(error.expected.split()[2])
    assert _samples(blocks, least) >= 0
    with pytest.raises(SceneError, match=f"at least {least} bytes"):
        _samples(blocks, least - 1)


@settings(max_examples=300, deadline=None)
@given(_shapes, _edges, st.integers(0, 2**30), st.integers(1, 10**6))
def test_more_memory_is_never_too_little(shape, edge, memory, more):
    blocks = BlockGrid(shape, edge)
    try:
        _samples(blocks, memory)
    except SceneError:
        return
    _samples(blocks, memory + more)


@settings(deadline=None)
@given(_shapes, _edges, st.sampled_from(("uint8", "uint16", "float64")), st.integers(1, 2**34))
def test_what_is_said_to_be_taken_at_most_is_the_budget_or_all_blocks(shape, edge, dtype, memory):
    blocks, dtype = BlockGrid(shape, edge), np.dtype(dtype)
    most = most_bytes(blocks, dtype, memory)
    assert most <= memory
    if most < memory:
        whole = blocks.count * edge**3
        assert _samples(blocks, memory, dtype) == whole
        assert most >= overhead_bytes(blocks, memory) + whole * min(dtype.itemsize, 4)
