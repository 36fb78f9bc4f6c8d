"""The simulation of many workers: right where it can be reckoned."""

from __future__ import annotations

import pytest

from bench.workers import TASKS_PER_WORKER, weak_scaling

NOTHING = {"serial": 0.0, "byte": 0.0}


def test_without_overhead_nothing_is_lost():
    assert weak_scaling(100, cost=1.0, bytes=0.0, **NOTHING) == pytest.approx(1.0)


def test_it_bends_where_the_client_has_no_time_left():
    """Above cost / serial workers, the client alone decides: each task takes its time, whoever renders."""
    found = {n: weak_scaling(n, cost=1.0, bytes=0.0, serial=0.01, byte=0.0) for n in (1, 20, 100, 1000)}
    assert found[1] > 0.98 and found[20] > 0.95 and 0.5 < found[100] < 1.0
    assert found[1000] == pytest.approx(1.0 / (1000 * 0.01), rel=0.1)


def test_answers_that_carry_pixels_bend_earlier():
    frames, bricks = (weak_scaling(200, 1.0, size, serial=1e-3, byte=1e-9) for size in (0.0, 16e6))
    assert frames > 0.9 and bricks < 0.3


def test_one_worker_waits_for_its_first_task_and_its_last_answer_alone():
    found = weak_scaling(1, cost=1.0, bytes=0.0, serial=0.2, byte=0.0)
    assert found == pytest.approx(TASKS_PER_WORKER / (TASKS_PER_WORKER + 0.2))
