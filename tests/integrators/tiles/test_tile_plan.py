"""From what corner rays meet to the number of rays of each tile."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.integrators.tiles.plan import histogram, plan, planned_tau, priorities, qualities


def corners_of(values: list[list[list[float]]]) -> np.ndarray:
    """Statistics of rays that meet blocks of these scales; an empty list: none."""
    corners = np.zeros((len(values), len(values[0]), 4))
    for row, column in np.ndindex(corners.shape[:2]):
        met = np.array(values[row][column])
        if met.size:
            rms = np.sqrt(np.mean(met**2))
            corners[row, column] = met.max(), met.mean(), rms, met.size
    return corners


CORNERS = corners_of([[[1.0, 0.5], [0.25], []], [[0.5], [], []]])


def test_priorities_are_of_the_corners_that_meet_the_volume():
    assert priorities(CORNERS, "max").tolist() == [[1.0, 0.25]]
    mean = (0.75 + 0.25 + 0.5) / 3
    np.testing.assert_allclose(priorities(CORNERS, "average"), [[mean, 0.25]])
    rms = np.sqrt((0.625 + 0.0625 + 0.25) / 3)
    np.testing.assert_allclose(priorities(CORNERS, "rms"), [[rms, 0.25]])


@pytest.mark.parametrize("priority", ["max", "average", "rms"])
def test_priorities_are_ordered_and_in_the_unit_interval(priority):
    rng = np.random.default_rng(1)
    met = [rng.choice([0.0, 0.125, 1.0], rng.integers(0, 9)) for _ in range(63)]
    corners = corners_of([met[9 * row : 9 * row + 9] for row in range(7)])
    values = priorities(corners, priority)
    assert values.shape == (6, 8) and values.min() >= 0 and values.max() <= 1
    average, rms, most = (priorities(corners, name) for name in ("average", "rms", "max"))
    assert (average <= rms + 1e-12).all() and (rms <= most + 1e-12).all()


def test_slots_are_half_open_and_zero_has_its_own():
    counts, slot = histogram(np.array([0.0, 1e-3, 0.0625, 0.063, 0.5, 1.0]), 16)
    assert slot.tolist() == [0, 1, 1, 2, 8, 16]
    assert counts.sum() == 6 and counts[1] == 2


def test_the_highest_slot_in_use_gets_the_highest_quality_and_nothing_the_lowest():
    priority = np.array([[0.0, 0.1, 0.25], [0.25, 0.24, 0.0]])
    quality = qualities(priority, 0.2, 0.8, 16)
    assert quality[0, 0] == quality[1, 2] == 0.2
    assert quality[0, 2] == quality[1, 0] == quality[1, 1] == pytest.approx(0.8)  # one slot
    assert quality[0, 1] == pytest.approx(0.2 + 0.6 * 2 / 4)
    assert (qualities(np.zeros((2, 2)), 0.2, 0.8, 16) == 0.2).all()


def test_more_priority_never_gets_fewer_rays():
    rng = np.random.default_rng(2)
    priority = rng.random(500) ** 2
    tau = planned_tau(qualities(priority, 0.1, 0.9, 16), 37)
    assert (np.diff(tau[np.argsort(priority)]) >= 0).all()
    assert tau.min() >= 1 and tau.max() == round(0.9 * 37)


def test_a_tile_has_at_least_one_ray_and_at_most_all():
    assert planned_tau(np.array([1e-6, 0.1, 0.5, 1.0]), 4).tolist() == [1, 1, 2, 4]


def test_tiles_beside_the_volume_get_the_lowest_quality():
    tau = plan(CORNERS, "max", 0.25, 1.0, 16, 16)
    assert tau.tolist() == [[16, 4 + 3]]  # slots 16 and 4 of 16
    assert plan(corners_of([[[], []], [[], []]]), "rms", 0.25, 1.0, 16, 16).tolist() == [[4]]
