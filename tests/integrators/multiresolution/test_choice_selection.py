"""The choice of level and depth per block: beside every possible choice, and its bound."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clvol.integrators.multiresolution.choice_selection import select_choices


def random_case(seed: int, blocks: int = 6, choices: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Errors and sizes; the more bytes, mostly the less error, but not always."""
    rng = np.random.default_rng(seed)
    sizes = rng.integers(0, 60, (choices, blocks))
    errors = rng.random((choices, blocks)) * 100 / (1 + sizes) + 0.02
    errors[rng.random(errors.shape) < 0.1] = 0.0
    return errors, sizes


def best_error(errors: np.ndarray, sizes: np.ndarray, budget: int) -> float:
    """By trying all."""
    count = errors.shape[1]
    found = np.inf
    for choice in itertools.product(range(len(errors)), repeat=count):
        if sizes[choice, range(count)].sum() <= budget:
            found = min(found, errors[choice, range(count)].sum())
    return found


@pytest.mark.parametrize("seed", range(12))
def test_it_is_within_its_bytes_and_near_the_best(seed):
    errors, sizes = random_case(seed)
    least = int(sizes.min(axis=0).sum())
    for budget in (least, least + 20, least + 80, int(sizes.max(axis=0).sum())):
        found, best = select_choices(errors, sizes, budget, 0.0), best_error(errors, sizes, budget)
        every = range(errors.shape[1])
        assert found.bytes == sizes[found.choice, every].sum() <= budget
        assert found.error == pytest.approx(errors[found.choice, every].sum())
        assert found.bound <= best + 1e-9 and best <= found.error + 1e-9
        largest = errors.max(axis=0).max()  # a greedy choice misses the best by less than one upgrade
        assert found.error <= best + largest


def test_no_bytes_are_spent_on_errors_that_nobody_sees():
    errors = np.array([[0.0, 0.0], [0.005, 5.0], [0.009, 9.0]])
    sizes = np.array([[100, 100], [10, 10], [1, 1]])
    assert select_choices(errors, sizes, 1000).choice.tolist() == [2, 0]


def test_of_choices_of_one_size_the_better_one_is_taken():
    errors, sizes = np.array([[3.0], [1.0], [2.0]]), np.array([[5], [5], [5]])
    assert select_choices(errors, sizes, 5).choice.tolist() == [1]


def test_too_few_bytes_are_an_error():
    with pytest.raises(ValueError, match="a budget of 2 bytes, expected at least 3"):
        select_choices(np.ones((2, 3)), np.array([[9, 9, 9], [1, 1, 1]]), 2)


def test_many_blocks_take_moments():
    rng = np.random.default_rng(1)
    sizes = np.sort(rng.integers(1, 5000, (17, 20000)), axis=0)[::-1]
    errors = np.sort(rng.random((17, 20000)), axis=0) * 100
    found = select_choices(errors, sizes, int(sizes.sum() / 40))
    assert found.error <= 1.001 * found.bound
