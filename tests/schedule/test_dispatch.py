"""Tiles of a picture among devices, in virtual time: all devices end together, and each tile counts once, whatever
fails."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clvol.schedule.dispatch import Dispatcher
from clvol.schedule.virtual import simulate

SIDE = 64  # tiles per row of a picture of 1024^2


def picture(kind: str, side: int = SIDE) -> np.ndarray:
    """float64 [side^2]: costs like those of real scenes, with an average of 1."""
    y, x = (np.mgrid[0:side, 0:side] + 0.5) / side - 0.5
    r = np.hypot(x, y)
    costs = {
        "even": np.ones_like(r),
        "hot core": np.where(r < 0.4, 1 + 20 * np.exp(-((r / 0.12) ** 2)), 0.05),
        "ring": 0.1 + 10 * np.exp(-(((r - 0.3) / 0.08) ** 2)),
        "corner": np.exp(-8 * np.hypot(x - 0.3, y + 0.3)) + 0.02,
    }[kind]
    return (costs / costs.mean()).ravel()


KINDS = ["even", "hot core", "ring", "corner"]


def fleet(devices: int, ratio: float, costs: np.ndarray) -> list[float]:
    """Speeds from 1 to ``ratio``; together they take a second for the picture."""
    speeds = np.geomspace(1, ratio, devices)
    return (speeds / speeds.sum() * costs.sum()).tolist()


def roughly(costs: np.ndarray, error: float, seed: int = 0) -> np.ndarray:
    return costs * np.exp(error * np.random.default_rng(seed).normal(size=len(costs)))


@pytest.mark.parametrize("launch, goal", [(0.002, 0.97), (0.01, 0.93)])
@pytest.mark.parametrize("devices, ratio", [*itertools.product([2, 4, 16, 64], [1, 4, 20])])
def test_devices_end_together_once_costs_are_measured(devices, ratio, launch, goal):
    """As in the tenth frame, with costs that differ by 3 % from the frame before. Many devices have smaller tiles, of
    8^2 pixels: a tile of 16^2 would be a thirtieth of what a slow one of 64 devices does."""
    found = []
    for kind in KINDS:
        costs = picture(kind, SIDE if devices <= 16 else 2 * SIDE)
        speeds, launches = fleet(devices, ratio, costs), [launch] * devices
        dispatcher = Dispatcher(roughly(costs, 0.03), speeds, launches, measured=True)
        found.append(simulate(dispatcher, costs, speeds, launches).efficiency)
    assert min(found) >= goal, dict(zip(KINDS, found))


@pytest.mark.parametrize("launch, goal", [(0.002, 0.95), (0.01, 0.9)])
@pytest.mark.parametrize("devices, ratio", [*itertools.product([2, 4], [1, 4, 20])])
def test_devices_nearly_end_together_in_the_first_frame(devices, ratio, launch, goal):
    """With costs that differ by a third from what is expected, as visible cells let expect of real scenes."""
    for kind in KINDS:
        costs = picture(kind)
        speeds, launches = fleet(devices, ratio, costs), [launch] * devices
        dispatcher = Dispatcher(roughly(costs, 0.33), speeds, launches)
        assert simulate(dispatcher, costs, speeds, launches).efficiency >= goal, kind


def frames_of_unsteady_devices(carried: bool, devices: int = 4, count: int = 125) -> list[float]:
    """Efficiencies of frames on devices whose speed differs by a tenth from package to package."""
    costs, chance = picture("hot core"), np.random.default_rng(1)
    truly, launches = fleet(devices, 1, costs), [0.005] * devices
    speeds, unsteady, found = truly, [0.0] * devices, []
    for _ in range(count):
        known = unsteady if carried else None
        dispatcher = Dispatcher(costs, speeds, launches, measured=True, columns=SIDE, unsteady=known)
        slower = lambda package: float(np.exp(0.1 * chance.normal()))  # noqa: E731
        found.append(simulate(dispatcher, costs, truly, launches, slower).efficiency)
        speeds = [share.speed for share in dispatcher.shares]
        unsteady = [share.unsteady for share in dispatcher.shares]
    return found[5:]


def test_unsteady_devices_get_smaller_packages():
    without, known = frames_of_unsteady_devices(False), frames_of_unsteady_devices(True)
    assert np.mean(known) > np.mean(without) + 0.01
    assert np.quantile(known, 0.1) > np.quantile(without, 0.1) + 0.01


def test_what_tiles_cost_tells_what_their_neighbours_will():
    """A half of the picture that costs four times what was expected, in a first frame."""
    costs = picture("even").reshape(SIDE, SIDE).copy()
    expected = costs.ravel().copy()
    costs[:, : SIDE // 2] *= 4
    costs = costs.ravel()
    off = {}
    for columns in (0, SIDE):
        speeds, launches = fleet(16, 1, costs), [0.002] * 16
        dispatcher = Dispatcher(expected * costs.mean(), speeds, launches, columns=columns)
        done = simulate(dispatcher, costs, speeds, launches)
        assert done.complete and done.efficiency > 0.95
        later = [package for package, *_ in done.spans[32:]]
        off[columns] = np.mean([abs(np.log(costs[package.tiles].sum() / package.cost)) for package in later])
    assert off[SIDE] < 0.5 * off[0]


def test_one_device_gets_everything_at_once():
    costs = picture("hot core")
    done = simulate(Dispatcher(costs, [1e3], [0.01]), costs, [1e3], [0.01])
    assert [len(package.tiles) for package, *_ in done.spans] == [SIDE * SIDE]


def test_the_unit_of_speeds_is_found_out():
    """Ratios of speeds matter, not how fast this scene is."""
    costs = picture("ring")
    speeds, launches = fleet(3, 4, costs), [0.002] * 3
    guessed = [40 * speed for speed in speeds]
    done = simulate(Dispatcher(costs, guessed, launches), costs, speeds, launches)
    assert done.complete and done.efficiency > 0.9


@pytest.mark.parametrize("seed", range(40))
def test_every_tile_counts_once_whatever_fails(seed):
    """Devices fail with a random package, or take a hundred times as long; one of them stays."""
    chance = np.random.default_rng(seed)
    devices = int(chance.integers(2, 7))
    costs = roughly(picture(KINDS[seed % 4]), 0.5, seed)
    speeds, launches = fleet(devices, float(chance.uniform(1, 20)), costs), [0.002] * devices
    failing = set(chance.choice(devices, int(chance.integers(1, devices)), replace=False).tolist())
    moment = {device: int(chance.integers(0, 3)) for device in failing}
    stalls = bool(chance.integers(2))
    seen = dict.fromkeys(range(devices), 0)

    def fault(package):
        number = seen[package.device]
        seen[package.device] += 1
        if package.device in failing and number >= moment[package.device]:
            return 100.0 if stalls else "gone"
        return None

    dispatcher = Dispatcher(costs, speeds, launches, measured=bool(chance.integers(2)))
    done = simulate(dispatcher, costs, speeds, launches, fault)
    assert done.complete
    counted = np.concatenate([package.tiles for package, _, counts in dispatcher.history if counts])
    assert np.array_equal(np.sort(counted), np.arange(len(costs)))


def test_a_frame_costs_the_unfinished_packages_more_if_a_device_is_lost():
    costs = picture("hot core")
    speeds, launches = fleet(4, 1, costs), [0.002] * 4
    without = simulate(Dispatcher(costs, speeds[:3], launches[:3], measured=True), costs, speeds[:3], launches[:3])
    fails = lambda package: "gone" if package.device == 0 else None  # noqa: E731
    done = simulate(Dispatcher(costs, speeds, launches, measured=True), costs, speeds, launches, fails)
    lost = max(end - begin for package, begin, end in done.spans if package.device == 0)
    assert done.complete and done.makespan <= without.makespan + lost


def test_nothing_is_left_to_do_when_all_devices_are_lost():
    costs = picture("even")
    speeds, launches = fleet(3, 2, costs), [0.002] * 3
    dispatcher = Dispatcher(costs, speeds, launches)
    done = simulate(dispatcher, costs, speeds, launches, lambda package: "gone")
    assert not done.complete and dispatcher.all_lost


def test_a_stalled_package_is_issued_again_and_its_late_result_does_not_count():
    costs = picture("even")
    dispatcher = Dispatcher(costs, [1e3, 1e3], [0.001, 0.001], measured=True)
    slow, fast, now = dispatcher.next(0, 0.0), dispatcher.next(1, 0.0), 0.0
    while fast is not None:
        now += dispatcher.expected_seconds(fast)
        assert dispatcher.finished(fast, now, costs[fast.tiles])
        fast = dispatcher.next(1, now)
    assert not dispatcher.complete and dispatcher.next(1, now) is None
    now += dispatcher.ask_again(now) + 1e-6
    again = dispatcher.next(1, now)
    assert again is not None and np.array_equal(again.tiles, slow.tiles)
    assert dispatcher.next(1, now) is None  # not twice
    assert dispatcher.finished(again, now + 1.0) and dispatcher.complete
    assert not dispatcher.finished(slow, now + 2.0)


@pytest.mark.parametrize("speed", [1.0, 10.0, 1e6])
def test_tiles_do_not_wait_for_a_device_that_was_fast_and_stalls(speed):
    """What is left would be done sooner by the fast device, if only it returned."""
    costs = picture("even", 16)
    speeds, launches = [speed * costs.sum(), costs.sum()], [0.001] * 2
    never = lambda package: 1e9 if package.device == 0 else None  # noqa: E731
    done = simulate(Dispatcher(costs, speeds, launches, measured=True), costs, speeds, launches, never)
    assert done.complete and done.makespan < 5.0  # the slow device takes a second, and a stall counts as one after one


def test_the_same_events_give_the_same_packages():
    costs = picture("ring")
    speeds, launches = fleet(5, 7, costs), [0.003] * 5
    runs = [simulate(Dispatcher(costs, speeds, launches), costs, speeds, launches).spans for _ in range(2)]
    for (one, *times), (other, *others) in zip(*runs):
        assert times == others and one.device == other.device and np.array_equal(one.tiles, other.tiles)
