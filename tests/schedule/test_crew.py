"""Devices that share the items of a job: losses, and devices that do not return."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from clvol.errors import ClvolWarning, DeviceError
from clvol.schedule import dispatch
from clvol.schedule.crew import Team

ITEMS = 40


class Hand:
    """Squares the numbers of its items. ``happens(count of its packages so far)`` is called before each package."""

    def __init__(self, happens=lambda count: time.sleep(0.002)) -> None:
        self._happens, self.packages = happens, 0

    def begin(self) -> None:
        pass

    def work(self, items: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.packages += 1
        self._happens(self.packages - 1)
        return np.ones(len(items)), items**2


@pytest.fixture
def team():
    made = Team(["first", "second"], speed=1e5, launch=1e-4)
    yield made
    made.close()


def squares(team: Team, *hands: Hand) -> np.ndarray:
    found = np.full(ITEMS, -1)

    def take(items: np.ndarray, result: np.ndarray) -> None:
        assert (found[items] == -1).all()  # each item once
        found[items] = result

    team.run(hands, np.ones(ITEMS), take)
    return found


EXPECTED = np.arange(ITEMS) ** 2


def test_all_items_are_done_once(team):
    assert np.array_equal(squares(team, Hand(), Hand()), EXPECTED)


def test_a_device_that_does_not_return_is_not_waited_for(team, monkeypatch):
    goes_on, began = threading.Event(), threading.Event()

    def hangs(count: int) -> None:
        began.set()
        goes_on.wait(30.0)

    slow = Hand(hangs)
    with monkeypatch.context() as patch:
        patch.setattr(dispatch, "_PATIENCE", 0.2)
        start = time.perf_counter()
        assert np.array_equal(squares(team, Hand(lambda count: began.wait(5.0)), slow), EXPECTED)
        assert time.perf_counter() - start < 10.0
    assert not team.lost
    assert np.array_equal(squares(team, Hand(), slow), EXPECTED)  # without it
    assert slow.packages == 1
    goes_on.set()
    for _ in range(100):
        if not team._crew.is_busy(1):
            break
        time.sleep(0.05)
    rejoined = Hand()
    other = Hand(lambda count: time.sleep(0.05))
    assert np.array_equal(squares(team, other, rejoined), EXPECTED)
    assert rejoined.packages


def test_one_that_is_busy_is_waited_for_where_no_other_is_left(team, monkeypatch):
    goes_on, began = threading.Event(), threading.Event()

    def hangs(count: int) -> None:
        began.set()
        goes_on.wait(30.0)

    with monkeypatch.context() as patch:
        patch.setattr(dispatch, "_PATIENCE", 0.2)
        squares(team, Hand(lambda count: began.wait(5.0)), Hand(hangs))
    team.lost[0] = "gone"
    team._told.add(0)
    threading.Timer(0.3, goes_on.set).start()
    assert np.array_equal(squares(team, Hand(), Hand()), EXPECTED)


def test_a_device_that_fails_late_is_left_out(team, monkeypatch):
    """After the job that others have ended; and if it was the last one, its error is raised."""
    goes_on, began = threading.Event(), threading.Event()

    def fails(count: int) -> None:
        began.set()
        goes_on.wait(30.0)
        raise DeviceError("device", "failed")

    with monkeypatch.context() as patch:
        patch.setattr(dispatch, "_PATIENCE", 0.2)
        assert np.array_equal(squares(team, Hand(lambda count: began.wait(5.0)), Hand(fails)), EXPECTED)
    goes_on.set()
    for _ in range(100):
        if team.lost:
            break
        time.sleep(0.05)
    with pytest.warns(ClvolWarning, match="second: failed and is left out"):
        assert np.array_equal(squares(team, Hand(), Hand()), EXPECTED)
    team.lost[0] = "gone"
    with pytest.raises(DeviceError, match="failed"):
        squares(team, Hand(), Hand())


def test_the_last_device_s_error_is_raised(team):
    def fails(count: int) -> None:
        raise DeviceError("device", "failed")

    with pytest.raises(DeviceError, match="failed"):
        squares(team, Hand(fails), Hand(fails))


def test_what_is_no_failure_of_a_device_is_raised_at_once(team):
    def wrong(count: int) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        squares(team, Hand(wrong), Hand())


def test_threads_of_a_closed_team_end(team):
    squares(team, Hand(), Hand())
    before = [t for t in threading.enumerate() if t.name.startswith("clvol-device")]
    assert len(before) >= 2
    team.close()
    for _ in range(100):
        if not any(t.is_alive() for t in before):
            return
        time.sleep(0.02)
    assert not any(t.is_alive() for t in before)
