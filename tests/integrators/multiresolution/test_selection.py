"""Level selection: within the bytes, near the best possible, and how near is known."""

from __future__ import annotations

import heapq

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol.integrators.multiresolution import selection
from clvol.integrators.multiresolution.selection import exact_levels, level_costs, minimum_bytes, select_levels
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED

COST = np.array([4096, 512, 64, 8, 0])
NO_DROPS = np.zeros(1000, bool)


def random_case(seed: int, most_blocks: int = 14):
    """errors [5, n] that rise with the level, dropped [n], budget."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, most_blocks + 1))
    errors = np.sort(rng.exponential(1, (5, n)) ** rng.uniform(0.3, 3), axis=0)
    errors[0] = 0
    errors[:, rng.random(n) < 0.2] = 0
    return errors.astype(np.float32), rng.random(n) < 0.2, int(rng.integers(0, 4096 * n))


def bytes_of(levels: np.ndarray) -> int:
    return int(COST[levels[levels != DROPPED]].sum())


seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=200, deadline=None)
@given(seeds)
def test_between_the_bound_and_one_upgrade_above_it(seed):
    errors, dropped, budget = random_case(seed)
    got = select_levels(errors, COST, dropped, budget, 0.0)
    best = exact_levels(errors, COST, dropped, budget)
    assert got.bytes == bytes_of(got.levels) <= budget and best.bytes <= budget
    assert (got.levels == DROPPED).tolist() == dropped.tolist()
    slack = 1e-6 * float(errors.sum()) + 1e-12
    assert got.bound <= best.error + slack
    assert best.error <= got.error + slack
    # The relaxed problem holds one block in part: what that one can save is the most that is lost.
    largest = float((errors[-1] - errors[0])[~dropped].max(initial=0.0))
    assert got.error - got.bound <= largest + slack


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_exact_levels_are_the_best_of_all(seed):
    errors, dropped, budget = random_case(seed, most_blocks=4)
    kept = np.flatnonzero(~dropped)
    found = np.inf
    for combination in np.ndindex(*(5,) * len(kept)):
        if COST[list(combination)].sum() <= budget:
            found = min(found, float(errors[list(combination), kept].astype(np.float64).sum()))
    assert exact_levels(errors, COST, dropped, budget).error == pytest.approx(found, abs=1e-9)


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_nothing_that_still_fits_is_left_out(seed):
    errors, dropped, budget = random_case(seed)
    got = select_levels(errors, COST, dropped, budget, 0.0)
    for block in np.flatnonzero(~dropped):
        here = int(got.levels[block])
        for to in range(here):
            if errors[to, block] < errors[here, block]:
                assert COST[to] - COST[here] > budget - got.bytes


def test_of_few_blocks_the_mean_is_within_a_twentieth_of_the_best():
    """The hardest are few blocks whose errors differ by orders of magnitude."""
    ratios = []
    for seed in range(250):
        errors, dropped, budget = random_case(seed, most_blocks=60)
        best = exact_levels(errors, COST, dropped, budget).error
        if best > 0:
            ratios.append(select_levels(errors, COST, dropped, budget, 0.0).error / best)
    assert len(ratios) > 100 and np.mean(ratios) < 1.05 and max(ratios) < 2, (
        np.mean(ratios), max(ratios)
    )  # fmt: skip


def test_exchanges_help_and_stay_within_the_bytes(monkeypatch):
    cases = [random_case(seed, most_blocks=40) for seed in range(80)]
    with_them = [select_levels(*case[:1], COST, *case[1:], 0.0) for case in cases]
    monkeypatch.setattr(selection, "_ROUNDS", 0)
    without = [select_levels(*case[:1], COST, *case[1:], 0.0) for case in cases]
    for case, one, other in zip(cases, with_them, without):
        assert one.bytes == bytes_of(one.levels) <= case[2]
        assert one.error <= other.error * (1 + 1e-6)
    assert sum(one.error for one in with_them) < 0.99 * sum(one.error for one in without)


def by_heap(errors: np.ndarray, dropped: np.ndarray, budget: int) -> np.ndarray:
    """The plain greedy: of all blocks' steepest upgrades the steepest, until one does not fit."""
    levels = np.where(dropped, DROPPED, 4).astype(np.uint8)

    def best(block: int, here: int):
        saved = errors[here, block].astype(float) - errors[:here, block]
        slopes = saved / (COST[:here] - COST[here])
        to = int(slopes.argmax()) if here else 0
        return (-slopes[to], block, to) if here and slopes[to] > 0 else None

    heap = [item for b in np.flatnonzero(~dropped) if (item := best(b, 4))]
    heapq.heapify(heap)
    while heap:
        _, block, to = heapq.heappop(heap)
        more = int(COST[to] - COST[levels[block]])
        if more > budget:
            break
        budget -= more
        levels[block] = to
        if item := best(block, to):
            heapq.heappush(heap, item)
    return levels


def test_is_the_greedy_by_error_per_byte_with_what_is_left_filled(monkeypatch):
    monkeypatch.setattr(selection, "_ROUNDS", 0)
    for seed in range(60):
        errors, dropped, budget = random_case(seed, most_blocks=300)
        plain = by_heap(errors, dropped, budget)
        got = select_levels(errors, COST, dropped, budget, 0.0)
        kept = ~dropped
        assert (got.levels[kept] <= plain[kept]).all()
        assert got.bytes - bytes_of(plain) < 4096
        assert (got.levels != plain).sum() <= 64


def test_pieces_do_not_matter(monkeypatch):
    errors, dropped, budget = random_case(5, most_blocks=2000)
    whole = select_levels(errors, COST, dropped, budget)
    monkeypatch.setattr(selection, "_PIECE", 17)
    pieces = select_levels(errors, COST, dropped, budget)
    np.testing.assert_array_equal(whole.levels, pieces.levels)
    assert whole.bound == pytest.approx(pieces.bound) and whole.bytes == pieces.bytes


def test_equal_blocks_are_upgraded_in_order():
    errors = np.repeat(np.array([[0], [1], [2], [3], [4]], np.float32), 10, axis=1)
    got = select_levels(errors, COST, np.zeros(10, bool), 3 * 8 + 2)
    assert got.levels.tolist() == [3] * 3 + [4] * 7


def test_enough_memory_gives_the_coarsest_levels_without_error():
    errors = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [5, 0, 0], [9, 0, 1]], np.float32)
    got = select_levels(errors, COST, np.zeros(3, bool), 10**9)
    assert got.levels.tolist() == [2, 4, 3] and got.bytes == 64 + 8
    assert got.error == got.bound == 0


def test_errors_that_nobody_sees_cost_nothing():
    errors = np.linspace(0, selection.NEGLIGIBLE, 5, dtype=np.float32)[:, None]
    got = select_levels(errors, COST, np.zeros(1, bool), 10**9)
    assert got.levels.tolist() == [4] and got.bytes == 0 and got.error == 0


def test_no_memory_leaves_one_sample_a_block():
    errors, dropped, _ = random_case(3)
    got = select_levels(errors, COST, dropped, 0)
    assert got.bytes == 0 and set(got.levels.tolist()) <= {4, DROPPED}
    assert minimum_bytes(COST, dropped) == 0


def test_all_dropped_and_none_at_all():
    assert select_levels(np.ones((5, 3), np.float32), COST, np.ones(3, bool), 100).bytes == 0
    assert select_levels(np.ones((5, 0), np.float32), COST, np.ones(0, bool), 100).levels.size == 0


def test_the_bound_falls_with_memory():
    errors, dropped, _ = random_case(11, most_blocks=500)
    bounds = [select_levels(errors, COST, dropped, b).bound for b in range(0, 2**19, 9973)]
    assert (np.diff(bounds) <= 1e-5).all() and bounds[0] > bounds[-1]


def test_levels_off_the_hull_are_used_only_to_fill_up():
    # Level 3 saves little for its bytes: the hull goes from 4 to 2 at once.
    errors = np.array([[0.0], [0.0], [0.0], [9.5], [10.0]], np.float32)
    none = np.zeros(1, bool)
    assert select_levels(errors, COST, none, 64).levels.tolist() == [2]
    assert select_levels(errors, COST, none, 63).levels.tolist() == [3]


def test_too_small_a_budget_and_costs_that_rise_are_refused():
    errors = np.ones((2, 3), np.float32)
    with pytest.raises(ValueError, match="at least 6"):
        select_levels(errors, np.array([5, 2]), np.zeros(3, bool), 5)
    with pytest.raises(ValueError, match="at least 6"):
        exact_levels(errors, np.array([5, 2]), np.zeros(3, bool), 5)
    with pytest.raises(ValueError, match="fall with the level"):
        select_levels(errors, np.array([2, 2]), np.zeros(3, bool), 5)


@pytest.mark.parametrize(
    ("dtype", "edge", "cost"),
    [("u1", 16, [4096, 512, 64, 8, 0]), ("f4", 8, [2048, 256, 32, 0]),
     ("f8", 4, [256, 32, 0]), ("i2", 4, [128, 16, 0])],
)  # fmt: skip
def test_costs_are_the_samples_that_the_device_holds(dtype, edge, cost):
    grid = BlockGrid((20, 20, 20), edge)
    assert level_costs(grid, np.dtype(dtype)).tolist() == cost
