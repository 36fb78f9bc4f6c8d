"""Pictures of an animation are written in order, one at a time, and what fails is reported."""

from __future__ import annotations

import threading

import pytest

from clvol.batch.write_behind import WriteBehind


def test_the_caller_goes_on_while_one_piece_is_done():
    begun, may_end, done = threading.Event(), threading.Event(), []

    def work() -> None:
        begun.set()
        assert may_end.wait(30)
        done.append("first")

    with WriteBehind() as behind:
        behind.add(work)
        assert begun.wait(30) and not done  # this thread is here while it runs
        may_end.set()
        behind.add(lambda: done.append("second"))
        assert done[0] == "first"
    assert done == ["first", "second"]


def test_what_fails_is_raised_by_the_next_call_or_at_the_end():
    def fail() -> None:
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="disk is full"), WriteBehind() as behind:
        behind.add(fail)
        behind.add(lambda: pytest.fail("it must not be done"))
    with pytest.raises(OSError, match="disk is full"), WriteBehind() as behind:
        behind.add(fail)


def test_a_block_that_ends_early_ends_when_all_is_done():
    may_end, done = threading.Event(), []

    def work() -> None:
        assert may_end.wait(30)
        done.append(1)

    with pytest.raises(KeyboardInterrupt), WriteBehind() as behind:
        behind.add(work)
        threading.Timer(0.05, may_end.set).start()
        raise KeyboardInterrupt
    assert done == [1]
