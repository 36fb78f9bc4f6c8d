"""Searches of settings on several devices, which share every picture, and the rays that they are measured by."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, rms, waves

from clvol import Camera, Scene, Volume
from clvol.accuracy import picture_search, tradeoff
from clvol.accuracy.error_target import render_to_error
from clvol.accuracy.settings import scene_tunables
from clvol.accuracy.time_target import render_in_time
from clvol.accuracy.tradeoff import measure_tradeoff
from clvol.errors import ClvolWarning, RenderError
from clvol.integrators.raycast.picture import PictureParts
from clvol.integrators.reference.picture import render_reference
from clvol.opencl.context import DeviceContext
from clvol.render import engines


@pytest.fixture
def two(device, monkeypatch):
    """Searches run on two contexts of one device."""
    monkeypatch.setattr(engines, "open_contexts", lambda _: [DeviceContext(device) for _ in range(2)])


@pytest.fixture(scope="module")
def scene():
    noise = np.random.default_rng(2).uniform(-6, 6, (24, 25, 26)).astype(np.float32)
    return Scene(
        volume=Volume(np.clip(waves((24, 25, 26)) + noise, 0, 255)), transfer_function=SMOOTH, camera=Camera(),
        image={"width": 160, "height": 160},
    )  # fmt: skip


@pytest.fixture
def few_tunables(monkeypatch):
    for module in (tradeoff, picture_search):
        monkeypatch.setattr(module, "scene_tunables", only_two)


def only_two(resolved, area=False):
    keys = "integration.step", "integration.classification"
    return {key: tunable for key, tunable in scene_tunables(resolved, area).items() if key in keys}


def test_the_error_holds(device, two, few_tunables, scene):
    frame = render_to_error(scene, 3e-3)
    exact = render_reference(scene.resolve(), device, tolerance=1e-8)[0]
    found = frame.stats["accuracy"]
    assert rms(frame.rgba, exact) <= 3e-3 and found["bound"] <= 3e-3
    assert len(frame.stats["devices"]) == 2


def test_an_error_that_no_settings_reach(device, two, few_tunables, scene):
    frame = render_to_error(scene, 1e-8)
    exact = render_reference(scene.resolve(), device, tolerance=1e-9)[0]
    assert frame.stats["method"] == "reference" and len(frame.stats["devices"]) == 2
    np.testing.assert_array_equal(frame.rgba, exact.astype(np.float32))


def test_the_time_holds(two, few_tunables, scene):
    frame = render_in_time(scene, 5.0)
    assert frame.stats["seconds"]["render"] <= 5.0 and len(frame.stats["devices"]) == 2


def test_errors_of_a_tradeoff_are_those_of_one_device(device, two, few_tunables, scene, monkeypatch):
    both, _ = measure_tradeoff(scene, frames=1, settings=6)
    monkeypatch.undo()
    monkeypatch.setattr(tradeoff, "scene_tunables", only_two)
    one, _ = measure_tradeoff(scene, devices=[device], frames=1, settings=6)
    assert len(both["machine"]["devices"]) == 2 and len(one["machine"]["devices"]) == 1
    errors = [{point["label"]: point["rmse"] for point in result["points"]} for result in (both, one)]
    same = set(errors[0]) & set(errors[1])
    assert len(same) >= 4  # which settings are tried next depends on times
    assert all(errors[0][name] == errors[1][name] for name in same)


def test_a_device_that_fails_is_left_out(device, two, few_tunables, scene, monkeypatch):
    real, first = PictureParts.render, []

    def render(self, stage, tiles):
        first[:] = first or [id(self._context)]
        if first == [id(self._context)]:
            raise RenderError("device", "failed (OUT_OF_RESOURCES)")
        return real(self, stage, tiles)

    monkeypatch.setattr(PictureParts, "render", render)
    with pytest.warns(ClvolWarning, match="left out"):
        frame = render_to_error(scene, 1e-2)
    exact = render_reference(scene.resolve(), device, tolerance=1e-8)[0]
    assert rms(frame.rgba, exact) <= 1e-2 and len(frame.stats["devices"]) == 1
