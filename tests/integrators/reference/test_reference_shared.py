"""Rays of the reference that devices share have the bits that one device gives them."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, waves

from clvol import Scene, Volume
from clvol.errors import ClvolWarning, DeviceError
from clvol.integrators.reference import program
from clvol.integrators.reference.picture import render_reference


@pytest.fixture(scope="module")
def resolved():
    scene = Scene(
        volume=Volume(waves((19, 17, 23))), transfer_function=SMOOTH, image={"width": 75, "height": 50},
        integration={"method": "reference"},
    )  # fmt: skip
    return scene.resolve()


@pytest.fixture(scope="module")
def expected(resolved, device):
    return render_reference(resolved, device, 1e-7)


def assert_same(found, expected) -> None:
    for own, other in zip(found[:2], expected[:2]):
        np.testing.assert_array_equal(own, other)
    counted = [{name: value for name, value in each[2].items() if name != "seconds"} for each in (found, expected)]
    assert counted[0] == counted[1]


@pytest.mark.parametrize("count", [2, 5])
def test_devices_give_the_picture_of_one(resolved, device, expected, count):
    told = []
    found = render_reference(resolved, [device] * count, 1e-7, progress=lambda *shares: told.append(shares))
    assert_same(found, expected)
    assert told == sorted(told) and told[-1] == (75 * 50, 75 * 50)


def test_pixels_of_a_picture(resolved, device, expected):
    pixels = np.array([[0, 0], [49, 74], [25, 30], [25, 31], [12, 60]])
    rgba, depth, _ = render_reference(resolved, [device] * 3, 1e-7, pixels)
    np.testing.assert_array_equal(rgba, expected[0][tuple(pixels.T)])
    np.testing.assert_array_equal(depth, expected[1][tuple(pixels.T)])


def fail_from(monkeypatch, package: int, failing: int) -> list[int]:
    """``failing`` of the devices fail with their ``package``-th package."""
    real, order, seen, failed, lock = program._RaysOnDevice.work, {}, {}, [], threading.Lock()

    def work(self, items):
        with lock:
            number = order.setdefault(id(self), len(order))
            seen[number] = seen.get(number, -1) + 1
            if number < failing and seen[number] >= package:
                failed.append(number)
                raise DeviceError("device", "failed (OUT_OF_RESOURCES)")
        return real(self, items)

    monkeypatch.setattr(program._RaysOnDevice, "work", work)
    return failed


@pytest.mark.parametrize("package", [0, 1])
def test_a_device_that_fails_is_left_out(resolved, device, expected, monkeypatch, package):
    failed = fail_from(monkeypatch, package, 1)
    with pytest.warns(ClvolWarning, match="left out") if package == 0 else _either():
        found = render_reference(resolved, [device] * 3, 1e-7)
    assert_same(found, expected)
    assert failed in ([0], []) and (failed or package)


def test_all_devices_fail(resolved, device, monkeypatch):
    fail_from(monkeypatch, 0, 2)
    with pytest.raises(DeviceError, match="OUT_OF_RESOURCES"):
        render_reference(resolved, [device] * 2, 1e-7)


def _either():
    import warnings

    return warnings.catch_warnings(record=True)
