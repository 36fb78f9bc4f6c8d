"""Pictures to an error and to a time: what is claimed is measured, and holds."""

from __future__ import annotations

import time

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, rms, waves

from clvol import Camera, Scene, TransferFunction, Volume
from clvol.accuracy import error_target, measurement, picture_search
from clvol.accuracy.error_target import render_to_error
from clvol.accuracy.measurement import Measurement
from clvol.accuracy.time_target import render_in_time
from clvol.accuracy.trials import Trials
from clvol.errors import RenderError, SceneError, UsageError
from clvol.integrators.reference.picture import render_reference
from clvol.scene import ImageSettings, Integration

PEAKS = TransferFunction(
    [0, 95, 100, 105, 175, 180, 185, 255],
    [0, 0, 0.7, 0, 0, 0.9, 0, 0],
    [[1, 0, 0]] * 4 + [[0, 1, 0]] * 4,
)


def scene_of(function=SMOOTH, array=None, size=160, **integration) -> Scene:
    noise = np.random.default_rng(2).uniform(-6, 6, (24, 25, 26)).astype(np.float32)
    array = np.clip(waves((24, 25, 26)) + noise, 0, 255) if array is None else array
    return Scene(
        volume=Volume(array), transfer_function=function, camera=Camera(),
        image=ImageSettings(width=size, height=size), integration=Integration(**integration),
    )  # fmt: skip


def true_error(frame, scene, device) -> float:
    return rms(frame.rgba, render_reference(scene.resolve(), device, tolerance=1e-8)[0])


@pytest.fixture(params=["smooth", "peaks"])
def function(request):
    return SMOOTH if request.param == "smooth" else PEAKS


@pytest.mark.parametrize("limit", [1e-2, 1e-3])
def test_the_error_holds_and_the_claim_holds(device, function, limit):
    scene = scene_of(function)
    frame = render_to_error(scene, limit, devices=[device])
    found = frame.stats["accuracy"]
    true = true_error(frame, scene, device)
    assert true <= limit
    assert found["rmse"] <= found["bound"] <= limit and found["max_error"] == limit
    assert true == pytest.approx(found["rmse"], rel=0.1)
    if true > found["bound"]:  # as one draw of pixels in twenty may: others must not
        assert found["confidence"] == 0.95
        held = []
        for seed in range(1, 5):
            other = render_to_error(scene, limit, devices=[device], seed=seed)
            held.append(true_error(other, scene, device) <= other.stats["accuracy"]["bound"])
        assert sum(held) >= 3
    assert 0 < found["pixels"] <= found["of_pixels"] == 160 * 160
    assert found["confidence"] in (0.95, 1.0)
    assert (found["how"] == "exact integral at all pixels") == (found["pixels"] == found["of_pixels"])
    # Whichever was fastest just now, but not the exact integral.
    assert found["settings"]["integration.method"] in ("raycast", "multiresolution", "pyramid")


@pytest.mark.slow
def test_the_words_name_the_pixels_that_an_error_rests_on(device, monkeypatch):
    """Those that settings were chosen by count as well, once each: nothing says that they do not."""
    monkeypatch.setattr(picture_search, "_PILOT_PIXELS", 400)
    monkeypatch.setattr(measurement, "_DRAWN_PIXELS", 64)
    found = render_to_error(scene_of(size=60), 1e-2, devices=[device]).stats["accuracy"]
    assert found["pixels"] < found["of_pixels"]
    chosen_by = "the pixels that settings were chosen by"
    assert found["how"] == f"exact integral at {chosen_by}, and at others, drawn where errors are expected"


@pytest.mark.slow
def test_less_error_costs_more(device):
    scene = scene_of()
    samples = [
        render_to_error(scene, limit, devices=[device]).stats["samples"] for limit in (1e-1, 1e-4)
    ]
    assert samples[1] > 3 * samples[0]


@pytest.mark.slow
def test_the_frame_says_how_to_make_it_again(device):
    from clvol import Renderer

    scene = scene_of()
    frame = render_to_error(scene, 3e-3, devices=[device])
    chosen = frame.stats["accuracy"]["settings"]
    tables = {"integration": {}, "image": {}}
    for key, value in chosen.items():
        table, name = key.split(".")
        tables[table][name] = value
    again = scene.model_copy(
        update={name: getattr(scene, name).model_copy(update=keys) for name, keys in tables.items()}
    )
    with Renderer(again, [device]) as renderer:
        assert np.array_equal(renderer.render().rgba, frame.rgba)
    assert f"step = {chosen['integration.step']!r}" in frame.scene_source


def test_what_no_setting_reaches_is_integrated_exactly(device):
    scene = scene_of(size=24)
    frame = render_to_error(scene, 1e-7, devices=[device])
    assert frame.stats["method"] == "reference"
    assert frame.stats["accuracy"]["bound"] <= 1e-7
    assert true_error(frame, scene, device) <= 1e-7


@pytest.mark.slow
def test_a_scene_that_asks_for_the_exact_integral_is_rendered_quickly_to_an_error(device):
    scene = scene_of(method="reference")
    frame = render_to_error(scene, 1e-2, devices=[device])
    assert frame.stats["method"] == "raycast"
    assert true_error(frame, scene, device) <= 1e-2


@pytest.mark.slow
def test_a_bound_that_fails_is_never_claimed(device, monkeypatch):
    """A pilot that is far too hopeful: its errors are told ten times too small."""
    real = Trials.run

    def hopeful(self, settings, keep=False):
        trial = real(self, settings, keep)
        trial.rmse /= 10
        return trial

    monkeypatch.setattr(Trials, "run", hopeful)
    scene = scene_of()
    frame = render_to_error(scene, 1e-3, devices=[device])
    assert frame.stats["accuracy"]["attempts"] > 1
    assert true_error(frame, scene, device) <= 1e-3


def test_giving_up_is_said_and_not_passed_over(device, monkeypatch):
    monkeypatch.setattr(error_target, "_ATTEMPTS", 1)
    real = Trials.run

    def blind(self, settings, keep=False):
        trial = real(self, settings, keep)
        trial.rmse = 0.0
        return trial

    monkeypatch.setattr(Trials, "run", blind)
    with pytest.raises(RenderError, match="max_error: the error could not be brought below 0.0001"):
        render_to_error(scene_of(), 1e-4, devices=[device])


@pytest.mark.slow
def test_pixels_of_the_pilot_are_not_drawn_again(device, monkeypatch):
    drawn = []
    real = Measurement._errors

    def watched(self, rgba, at):
        drawn.append(np.stack(np.divmod(at, self._size[0]), axis=1))
        return real(self, rgba, at)

    monkeypatch.setattr(Measurement, "_errors", watched)
    monkeypatch.setattr(picture_search, "_PILOT_PIXELS", 1000)
    scene = scene_of()
    lattices = []
    make = picture_search._pilot_lattice

    def lattice(*arguments):
        lattices.append(make(*arguments))
        return lattices[0]

    monkeypatch.setattr(picture_search, "_pilot_lattice", lattice)
    render_to_error(scene, 1e-2, devices=[device])
    pilot = {tuple(p) for p in lattices[0].pixels(160, 160)}
    measured = {tuple(p) for pixels in drawn for p in pixels}
    assert len(measured) > 500 and not pilot & measured


@pytest.mark.slow
def test_a_time_is_held_and_more_of_it_buys_less_error(device):
    scene = scene_of()
    seconds = (0.004, 0.04)
    frames = [render_in_time(scene, s, devices=[device]) for s in seconds]
    for frame, budget in zip(frames, seconds):
        assert frame.stats["seconds"]["render"] <= budget
        assert frame.stats["accuracy"]["time_budget"] == budget
    found = [frame.stats["accuracy"]["bound"] for frame in frames]
    assert found[1] < 0.5 * found[0]
    for frame, bound in zip(frames, found):
        assert true_error(frame, scene, device) <= bound


@pytest.mark.slow
def test_a_time_that_nothing_holds_is_refused_with_what_would(device):
    with pytest.raises(UsageError, match="time_budget: got 1e-07 s, expected at least .* s on this device"):
        render_in_time(scene_of(), 1e-7, devices=[device])


@pytest.mark.parametrize("wrong", [0.0, -1.0, 2.0, np.nan, np.inf, 1e-11])
def test_impossible_errors_are_refused_before_any_work(wrong):
    start = time.perf_counter()
    with pytest.raises(UsageError, match="max_error: got"):
        render_to_error(scene_of(), wrong, devices=["no such device"])
    assert time.perf_counter() - start < 1.0


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf])
def test_impossible_times_are_refused_before_any_work(wrong):
    with pytest.raises(UsageError, match="time_budget: got"):
        render_in_time(scene_of(), wrong, devices=["no such device"])


def test_what_cannot_be_rendered_is_refused_as_ever():
    with pytest.raises(SceneError, match="integration.filter: got 'nearest' with"):
        render_to_error(scene_of(method="pyramid", filter="nearest"), 1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 2, 5])
def test_tiny_pictures_are_measured_whole(device, size):
    scene = scene_of(size=size)
    frame = render_to_error(scene, 1e-3, devices=[device])
    found = frame.stats["accuracy"]
    assert found["pixels"] == size * size and found["confidence"] == 1.0
    assert found["bound"] == found["rmse"] <= 1e-3
    assert found["how"] == "exact integral at all pixels"
    assert true_error(frame, scene, device) == pytest.approx(found["rmse"], rel=1e-2, abs=2e-6)


def test_a_blank_picture_has_no_error(device):
    clear = TransferFunction([0.0, 255.0], [0.0, 0.0], [[1, 1, 1]] * 2)
    frame = render_to_error(scene_of(clear), 1e-5, devices=[device])
    assert not frame.rgba.any() and frame.stats["accuracy"]["bound"] == 0.0
