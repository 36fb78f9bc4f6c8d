"""The thread that reads blocks: what it brings, in which order, and how it ends."""

from __future__ import annotations

import threading

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol.errors import VolumeError
from clvol.integrators.multiresolution.loader import (
    CONSTANT,
    RAW,
    Loader,
    Request,
    requests,
    staged_piece,
)


class _Source:
    """Samples that are the block's number; notes how many threads read at once."""

    def __init__(self) -> None:
        self.bad: int | None = None
        self.gate = threading.Event()
        self.gate.set()
        self.inside = self.most_inside = self.reads = 0

    def read(self, level: int, blocks: np.ndarray) -> np.ndarray:
        self.inside += 1
        self.most_inside = max(self.most_inside, self.inside)
        self.reads += 1
        assert self.gate.wait(20)
        self.inside -= 1
        if self.bad is not None and self.bad in blocks:
            raise VolumeError("store", f"block {self.bad}", "another")
        side = 4 >> level
        numbers = np.arange(side**3).reshape(side, side, side) + 1000 * blocks[:, None, None, None]
        return numbers.astype(np.float32)


def _drain(loader: Loader) -> tuple[list, Exception | None]:
    found = []
    while True:
        pieces, error = loader.take()
        found += pieces
        if error is not None or (loader._thread is None and not pieces):
            return found, error
        loader.wait()


def _requests(count: int) -> list[Request]:
    return [Request(k % 2, np.array([2 * k, 2 * k + 1])) for k in range(count)]


def test_pieces_come_in_order_and_whole():
    loader, wanted = Loader(_Source()), _requests(30)
    loader.ask(wanted)
    pieces, error = _drain(loader)
    assert error is None
    assert [p.level for p in pieces] == [r.level for r in wanted]
    for piece, request in zip(pieces, wanted):
        np.testing.assert_array_equal(piece.blocks, request.blocks)
        np.testing.assert_array_equal(piece.staged[piece.first], 1000.0 * request.blocks)


def test_the_thread_reads_no_further_than_a_few_pieces_ahead():
    source = _Source()
    loader = Loader(source)
    loader.ask(_requests(100))
    while source.reads < 9:  # eight that are ready and one that waits to be
        loader.wait()
    assert source.reads <= 10
    loader.close()
    assert source.reads <= 10


def test_what_is_asked_for_next_replaces_what_was_asked_for_and_one_thread_reads():
    source = _Source()
    loader = Loader(source)
    source.gate.clear()
    loader.ask(_requests(5))
    loader.ask([Request(0, np.array([77]))])
    source.gate.set()
    pieces, error = _drain(loader)
    assert error is None and [p.blocks.tolist() for p in pieces] == [[77]]
    assert source.most_inside == 1


def test_an_error_comes_after_what_was_read_before_it_and_ends_the_rest():
    source = _Source()
    source.bad = 6
    loader = Loader(source)
    loader.ask(_requests(20))
    pieces, error = _drain(loader)
    assert [p.blocks[0] for p in pieces] == [0, 2, 4]
    assert isinstance(error, VolumeError) and "block 6" in str(error)
    assert loader.take() == ([], None) and source.reads == 4


def test_close_waits_for_the_read_in_hand_alone():
    source = _Source()
    loader = Loader(source)
    source.gate.clear()
    loader.ask(_requests(50))
    thread = loader._thread
    threading.Timer(0.05, source.gate.set).start()
    loader.close()
    assert not thread.is_alive() and source.reads <= 1


_BLOCKS = st.tuples(st.integers(0, 500), st.integers(0, 3))  # number and level


@settings(deadline=None)
@given(
    st.lists(_BLOCKS, unique_by=lambda b: b[0], max_size=80),
    st.integers(1, 3000),
    st.integers(1, 9),
    st.integers(1, 5000),
)
def test_requests_have_every_block_once_and_keep_their_bounds(wanted, most, count, window):
    blocks = np.array([b for b, _ in wanted], np.int64)
    levels = np.array([k for _, k in wanted], np.int64)
    found = requests(blocks, levels, 16, max(most, 16**3), count, window)
    goal = dict(wanted)
    got = [(int(b), r.level) for r in found for b in r.blocks]
    assert sorted(got) == sorted(wanted)
    for request in found:
        side = 16 >> request.level
        assert 0 < len(request.blocks) <= count
        assert len(request.blocks) * side**3 <= max(most, 16**3)
        assert (np.diff(request.blocks) > 0).all()
    # A block comes no later than all that were asked for before it, and a window's worth more.
    sizes = {b: (16 >> k) ** 3 for b, k in goal.items()}
    before = {b: sum(sizes[c] for c, _ in wanted[:i]) for i, (b, _) in enumerate(wanted)}
    passed = 0
    for block, _ in got:
        assert abs(passed - before[block]) < window + 16**3
        passed += sizes[block]


def test_a_block_of_one_value_is_staged_as_one_sample():
    samples = np.arange(4 * 8, dtype=np.int16).reshape(4, 2, 2, 2)
    samples[1] = 7
    samples[3, 0, 0, 0] = samples[3, 1, 1, 1]  # first and last alike, those between not
    piece = staged_piece(Request(0, np.arange(4)), samples)
    assert piece.codec.tolist() == [RAW, CONSTANT, RAW, RAW]
    assert len(piece.staged) == 3 * 8 + 1
    for k, (first, codec) in enumerate(zip(piece.first, piece.codec)):
        values = piece.staged[first : first + (1 if codec == CONSTANT else 8)]
        np.testing.assert_array_equal(np.broadcast_to(values, 8), samples[k].ravel())


def test_a_block_of_holes_alone_keeps_them():
    samples = np.full((2, 2, 2, 2), np.nan, np.float32)
    piece = staged_piece(Request(0, np.arange(2)), samples)
    assert piece.codec.tolist() == [RAW, RAW] and np.isnan(piece.staged).all()
